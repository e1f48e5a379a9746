"""The ring's twin is SUMO step for step without noise."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mbtl.zoo.cmdps.traffic import ring
from mbtl.zoo.cmdps.traffic.twins import RingProblem

ACTIONS = {"acceleration": ring.RingAcc, "speed": ring.RingVel}


def snapshot(env):
    """Gaps [m] and speeds [m/s] of all cars in SUMO."""
    vehicle = env.simulation.api.vehicle
    cars = [f"car{i}" for i in range(ring.CARS)]
    half = ring.CIRCUMFERENCE / 2
    place = np.array([
        vehicle.getLanePosition(car) + (half if vehicle.getRoadID(car) == "south" else 0.0)
        for car in cars
    ])  # fmt: skip
    gap = (np.roll(place, -1) - place) % ring.CIRCUMFERENCE - 5.0
    return gap, np.array([vehicle.getSpeed(car) for car in cars])


def same_state(twin, params, env):
    """The twin's state that SUMO is in at the first decision."""
    gap, speed = snapshot(env)
    vehicle = env.simulation.api.vehicle
    factors = np.array([vehicle.getSpeedFactor(f"car{i}") for i in range(ring.CARS)])
    state = twin.start(jnp.zeros(1, jnp.uint32), params)
    speeds = jnp.asarray(speed, jnp.float32)[:, None]
    return state._replace(
        gap=jnp.asarray(gap, jnp.float32)[:, None],
        speed=speeds,
        driven=speeds,
        desired=jnp.asarray(13.89 * factors, jnp.float32)[:, None],
        seen=jnp.stack([speeds[0], speeds[1], jnp.float32(gap[:1] + 5.0)]),
    )


@pytest.mark.parametrize("actions", ["acceleration", pytest.param("speed", marks=pytest.mark.long)])
def test_without_noise_every_decision_ends_as_in_sumo(actions, opened):
    env = opened(ACTIONS[actions]({"hold": 2.0}, noise=0.0, visibility="hidden"))
    twin, (params,) = RingProblem(actions, noise=0.0)([{"hold": 2.0}])
    step = jax.jit(twin.step)
    rng = np.random.default_rng(0)
    first, _ = env.reset(seed=3)
    state = same_state(twin, params, env)
    np.testing.assert_allclose(twin.observe(state, params).obs[0, 0], first, atol=1e-6)
    for _ in range(20):
        # large gaps are left out: SUMO sees no leader across the seam of its two edges then
        action = rng.uniform(-1, 1) if actions == "acceleration" else rng.integers(3, 6)
        seen, reward, ended, *_ = env.step(np.float32([action]) if "acc" in actions else action)
        moved = step(state, jnp.asarray([[action]]), params)
        state = moved.state
        assert not ended
        assert float(moved.reward[0, 0]) == pytest.approx(reward, abs=0.05)
        np.testing.assert_allclose(twin.observe(state, params).obs[0, 0], seen, atol=0.01)
        np.testing.assert_allclose(state.gap[:, 0], snapshot(env)[0], atol=0.05)
