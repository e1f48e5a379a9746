"""The ramp's twin is SUMO step for step without noise."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mbtl.zoo.cmdps.traffic import ramp
from mbtl.zoo.cmdps.traffic.twins import RampProblem
from mbtl.zoo.worlds.traffic.ramp import RAMP_CAR, Queue, empty

ACTIONS = {"acceleration": ramp.RampAcc, "speed": ramp.RampVel}


def position(vehicle, car):
    """Of the front, from the zipper [m]."""
    return vehicle.getLanePosition(car) - ramp._AHEAD[vehicle.getRoadID(car)]


def same_state(twin, params, env):
    """The twin's state that SUMO is in at the first decision."""
    vehicle = env.simulation.api.vehicle
    cars = sorted(vehicle.getIDList(), key=lambda car: -position(vehicle, car))
    main = [car for car in cars if car.startswith("main")]
    number = {car: env._main_cars - len(main) + k for k, car in enumerate(main)}
    kinds = {"main": [], "side": [], "end": []}
    for car in cars:
        road = "main" if car.startswith("main") else "side"
        kinds["end" if position(vehicle, car) > 0.0 else road].append(car)
    shapes = jax.eval_shape(twin.start, jnp.zeros(1, jnp.uint32), params)
    state = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), shapes)
    queues = {}
    for name, own in kinds.items():
        columns = (
            [position(vehicle, car) for car in own],
            [vehicle.getSpeed(car) for car in own],
            [vehicle.getAllowedSpeed(car) for car in own],
            [np.inf for _ in own],
            [number.get(car, RAMP_CAR) for car in own],
        )
        rows = empty(len(getattr(state, name).x), 1)
        filled = zip(rows, columns, strict=True)
        queues[name] = Queue(*(field.at[: len(own), 0].set(jnp.array(x)) for field, x in filled))
    entered = jnp.array([env._main_cars])
    state = state._replace(**queues, entered=entered, steps=jnp.int32(twin.warm_up))
    return state._replace(look=twin._look(state)), {v: k for k, v in number.items()}


@pytest.mark.long
@pytest.mark.parametrize("actions", ACTIONS)
def test_without_noise_every_decision_ends_as_in_sumo(actions, opened):
    """New cars want other speeds in the twin; they change nothing before them for a while."""
    env = opened(ACTIONS[actions]({"hold": 2.0}, noise=0.0, visibility="hidden"))
    twin, (params,) = RampProblem(actions, noise=0.0)([{"hold": 2.0}])
    step, rng = jax.jit(twin.step), np.random.default_rng(0)
    seen, _ = env.reset(seed=3)
    state, cars = same_state(twin, params, env)
    for decision in range(6):
        numbers = np.asarray(state.look.car)[:, 0]
        places = {cars[k]: place for place, k in enumerate(numbers.tolist()) if k in cars}
        assert set(places) == set(seen) & set(cars.values())
        obs = np.asarray(twin.observe(state, params).obs)[0]
        for car, place in places.items():
            np.testing.assert_allclose(obs[place], seen[car], atol=0.02 if decision < 4 else 0.1)
        told = rng.uniform(-1, 1, 8) if actions == "acceleration" else rng.integers(2, 5, 8)
        advice = {car: np.atleast_1d(told[place]) for car, place in places.items()}
        if actions == "speed":
            advice = {car: int(level[0]) for car, level in advice.items()}
        seen, rewards, *_ = env.step(advice)
        seen = {car: seen[car] for car in env.agents}
        moved = step(state, jnp.asarray(told)[None], params)
        state = moved.state
        acting = np.asarray(moved.reward)[0, list(places.values())]
        np.testing.assert_allclose(acting, next(iter(rewards.values())), atol=0.06)
        vehicle = env.simulation.api.vehicle
        theirs = {car: position(vehicle, car) for car in vehicle.getIDList()}
        for queue in (state.main, state.end):
            for k, x in zip(np.asarray(queue.car)[:, 0], np.asarray(queue.x)[:, 0], strict=True):
                if k in cars and cars[k] in theirs:
                    assert x == pytest.approx(theirs[cars[k]], abs=0.5)
