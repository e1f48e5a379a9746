import math

import gymnasium
import numpy as np
import pytest
from played import begun

from mbtl.zoo.cmdps.pendulum import Pendulum

NOTHING = np.zeros(1, dtype=np.float32)


@pytest.mark.parametrize("seed", range(3))
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


def test_one_step_by_hand():
    env = begun(Pendulum({"length": 2.0, "mass": 3.0, "timestep": 0.1}))
    env.state = (0.5, -1.0)
    _, reward, *_ = env.step(np.array([1.5]))
    w = -1.0 + (1.5 * 10.0 / 2.0 * math.sin(0.5) + 3.0 * 1.5 / (3.0 * 4.0)) * 0.1
    assert env.state == pytest.approx((0.5 + 0.1 * w, w), rel=1e-14)
    assert reward == pytest.approx(-(0.25 + 0.1 + 0.001 * 2.25), rel=1e-14)


def test_an_episode_is_200_steps_whatever_the_time_step():
    for timestep, time_limit, end in (
        (0.005, "truncation", (False, True)), (0.5, "terminal", (True, False)),
    ):  # fmt: skip
        env = begun(Pendulum({"timestep": timestep}, time_limit=time_limit))
        ends = [env.step(NOTHING)[2:4] for _ in range(200)]
        assert ends == [(False, False)] * 199 + [end]
