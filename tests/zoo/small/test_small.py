"""Small problems: worlds as in Gymnasium, sensors that are noisy, and a table of enough of them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from gymnasium.envs.classic_control import AcrobotEnv, Continuous_MountainCarEnv

from mbtl.zoo.small import worlds
from mbtl.zoo.small.problems import KINDS, SmallProblem, groups

SEEN = jnp.zeros(0)


def params_of(kind, **context):
    _, params = SmallProblem(kind, tuple(context), False)([context])
    return jax.tree.map(lambda x: jnp.asarray(x[0]), params)


def own(world, params):
    return world.params(*params[:-3], params.visible)


def test_acrobot_swings_as_in_gymnasium():
    world, params = worlds.Acrobot(), own(worlds.Acrobot(), params_of("acrobat", gravity=9.8))
    peer = AcrobotEnv()
    peer.reset(seed=0)
    state = worlds.AcrobotState(*(jnp.float32(x) for x in peer.state))
    step = jax.jit(world.step)
    for t in range(60):
        action = (t // 7) % 3
        moved, (seen, reward, terminated, _, _) = step(state, action, params), peer.step(action)
        state = moved.state
        np.testing.assert_allclose(world.observe(state, params), seen, atol=2e-3)
        assert (float(moved.reward), bool(moved.terminated)) == (reward, terminated)


def test_mountain_car_drives_as_in_gymnasium_and_energy_is_paid():
    world = worlds.MountainCar()
    params = own(world, params_of("hill", power=0.0015))
    peer = Continuous_MountainCarEnv()
    peer.reset(seed=0)
    state = worlds.MountainCarState(*(jnp.float32(x) for x in peer.state))
    step, paid, known = jax.jit(world.step), 0.0, 0.0
    for _ in range(200):
        push = 1.0 if float(state.v) >= 0 else -1.0
        moved = step(state, jnp.array([push]), params)
        (x, v), reward, terminated, _, _ = peer.step(np.array([push]))
        state, paid, known = moved.state, paid + float(moved.reward), known + reward
        np.testing.assert_allclose(state, (x, v), atol=1e-4)
        assert bool(moved.terminated) == terminated
        if terminated:
            break
    assert terminated
    height = 0.0025 / 3 * (np.sin(3 * x) + 1.0) + v**2 / 2
    assert paid - known == pytest.approx(worlds.CLIMB * height, rel=0.05)


def test_sensors_have_the_noise_and_actions_the_delay_that_the_context_says():
    world = worlds.Disturbed(worlds.Swing(), KINDS["swing"].scale)
    clear, noisy = params_of("swing", mass=1.0), params_of("swing", noise=0.5)
    late = params_of("swing", delay=3.2)
    noise = jax.random.uniform(jax.random.PRNGKey(0), (4000, world.n_noise))
    first = [jax.vmap(world.initial, (0, None))(noise, p) for p in (clear, noisy)]
    seen = [
        jax.vmap(world.observe, (0, None))(s, p) for s, p in zip(first, (clear, noisy), strict=True)
    ]
    off = np.asarray(seen[1] - seen[0]) / np.array(KINDS["swing"].scale)
    np.testing.assert_allclose(off.std(0), 0.5, rtol=0.05)
    np.testing.assert_allclose(off.mean(0), 0.0, atol=0.03)
    assert abs(np.corrcoef(off.T) - np.eye(3)).max() < 0.06

    def speeds(params):
        state, found = world.initial(noise[0] * 0 + 0.5, params), []
        for _ in range(5):
            state = world.step(state, jnp.array([1.0]), params).state
            found.append(float(state.inside.w))
        return found

    prompt, after = speeds(clear), speeds(late)
    assert after[:3] == [0.0, 0.0, 0.0]
    np.testing.assert_allclose(after[3:], prompt[:2], rtol=1e-5)


def test_there_are_enough_and_every_axis_reaches_the_world():
    ids = [cmdp.id for _, some in groups() for cmdp in some]
    assert len(ids) == len(set(ids)) >= 120
    for kind, one in KINDS.items():
        for axis, (low, high) in one.axes.items():
            _, params = SmallProblem(kind, (axis,), True)([{axis: low}, {axis: high}])
            assert any((np.ptp(x, axis=0) > 0).any() for x in params[:-1]), (kind, axis)
            np.testing.assert_allclose(params.visible, [[-1.0], [1.0]])
