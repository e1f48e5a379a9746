import math

import gymnasium
import numpy as np
import pytest

from mbtl.zoo.cmdps.pendulum import Pendulum, derive

NOTHING = np.zeros(1, dtype=np.float32)


@pytest.mark.parametrize("seed", range(5))
def test_agrees_step_for_step_with_gymnasium_at_the_nominal_context(seed):
    ours, theirs = Pendulum({"length": 1.0}, visibility="hidden"), gymnasium.make("Pendulum-v1")
    assert ours.observation_space == theirs.observation_space
    assert ours.action_space == theirs.action_space
    np.testing.assert_allclose(ours.reset(seed=seed)[0], theirs.reset(seed=seed)[0], rtol=1e-6)
    theirs = theirs.unwrapped  # its wrappers insist on float32, which rounds its torque term
    rng = np.random.default_rng(seed)
    for _ in range(200):
        action = rng.uniform(-3.0, 3.0, 1)
        got, want = ours.step(action), theirs.step(action)
        np.testing.assert_allclose(ours.state, theirs.state, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(got[0], want[0], rtol=1e-5, atol=1e-6)
        assert got[1] == pytest.approx(want[1], rel=1e-9)
    assert got[2:4] == (False, True)


@pytest.mark.parametrize("seed", range(3))
def test_stays_near_gymnasium_with_float32_torques(seed):
    ours, theirs = Pendulum({"mass": 1.0}, visibility="hidden"), gymnasium.make("Pendulum-v1")
    ours.reset(seed=seed)
    theirs.reset(seed=seed)
    rng = np.random.default_rng(seed)
    for t in range(200):
        action = rng.uniform(-2.0, 2.0, 1).astype(np.float32)
        got, want = ours.step(action), theirs.step(action)
        np.testing.assert_allclose(got[0], want[0], atol=1e-3)
        assert got[2:4] == want[2:4] == (False, t == 199)


def test_hanging_at_rest_for_200_steps_returns_about_minus_1974():
    env = Pendulum()
    env.reset(seed=0)
    env.state = (math.pi, 0.0)
    total = sum(env.step(NOTHING)[1] for _ in range(200))
    assert total == pytest.approx(-200 * math.pi**2, rel=1e-9)


def test_one_step_by_hand():
    env = Pendulum({"length": 2.0, "mass": 3.0, "timestep": 0.1})
    env.reset(seed=0)
    env.state = (0.5, -1.0)
    _, reward, *_ = env.step(np.array([1.5]))
    w = -1.0 + (1.5 * 10.0 / 2.0 * math.sin(0.5) + 3.0 * 1.5 / (3.0 * 4.0)) * 0.1
    assert env.state == pytest.approx((0.5 + 0.1 * w, w), rel=1e-14)
    assert reward == pytest.approx(-(0.25 + 0.1 + 0.001 * 2.25), rel=1e-14)


@pytest.mark.parametrize(
    ("feature", "value", "gravity_gain", "torque_gain"),
    [
        ("length", 0.1, 7.5, 15.0),
        ("length", 10.0, 0.075, 0.0015),
        ("mass", 0.1, 0.75, 1.5),
        ("mass", 10.0, 0.75, 0.015),
        ("timestep", 0.005, 0.075, 0.015),
        ("timestep", 0.5, 7.5, 1.5),
    ],
)
def test_derived_constants_at_the_corners(feature, value, gravity_gain, torque_gain):
    constants = derive({**Pendulum.FEATURES, feature: value})
    assert constants.gravity_gain == pytest.approx(gravity_gain, rel=1e-14)
    assert constants.torque_gain == pytest.approx(torque_gain, rel=1e-14)


@pytest.mark.parametrize("timestep", [0.005, 0.05, 0.5])
def test_an_episode_is_200_steps_whatever_the_time_step(timestep):
    for time_limit, end in (("truncation", (False, True)), ("terminal", (True, False))):
        env = Pendulum({"timestep": timestep}, time_limit=time_limit)
        env.reset(seed=0)
        ends = [env.step(NOTHING)[2:4] for _ in range(200)]
        assert ends == [(False, False)] * 199 + [end]


@pytest.mark.parametrize(
    ("visibility", "tail"),
    [("hidden", []), ("multiplier", [0.7]), ("raw", [8.0, 0.05, 10.0, 0.7, 1.0])],
)
def test_visible_features_end_every_observation(visibility, tail):
    env = Pendulum({"mass": 0.7}, visibility=visibility)
    for observation in (env.reset(seed=0)[0], env.step(NOTHING)[0]):
        assert observation.dtype == np.float32
        np.testing.assert_allclose(observation[3:], tail, rtol=1e-6)


def test_speed_and_torque_are_clipped():
    env = Pendulum({"length": 0.1})
    env.reset(seed=0)
    env.state = (math.pi / 2, 7.9)
    env.step(np.array([100.0]))
    assert env.state[1] == 8.0
    env.state, twin = (1.0, 0.0), Pendulum({"length": 0.1})
    twin.reset(seed=0)
    twin.state = (1.0, 0.0)
    assert env.step(np.array([100.0]))[1] == twin.step(np.array([2.0]))[1]


def test_a_torque_that_is_not_a_number_is_not_hidden():
    env = Pendulum()
    env.reset(seed=0)
    assert math.isnan(env.step(np.array([math.nan]))[1])


def test_a_varied_speed_limit_leaves_the_space_the_same():
    slow, fast = Pendulum({"max_speed": 1.0}), Pendulum({"max_speed": 80.0})
    assert slow.observation_space == fast.observation_space
    assert slow.observation_space.high[2] == np.inf
