"""One environment for all contexts: drawn as stated, closed in time."""

from collections import Counter

import numpy as np
import pytest

pytest.importorskip("gymnasium", reason="the envs extra is not installed")

import gymnasium

from mbtl.envs.everywhere import Everywhere
from mbtl.errors import InvalidInput
from mbtl.faults import REASON, reason_of

CONTEXTS = [{"size": float(size)} for size in (1, 2, 4)]


class Told(gymnasium.Env):
    """Shows its context; the action nearest to it earns most. One step."""

    def __init__(self, context, width=1):
        self.size = context["size"]
        self.observation_space = gymnasium.spaces.Box(0.0, 4.0, (width,), np.float32)
        self.action_space = gymnasium.spaces.Discrete(5)
        self.episode_steps = int(self.size)
        self.closed = False

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return np.full(self.observation_space.shape, self.size, np.float32), {}

    def step(self, action):
        reward = -abs(float(action) - self.size)
        return np.full(self.observation_space.shape, self.size, np.float32), reward, True, False, {}

    def close(self):
        self.closed = True


def everywhere(make_env):
    return Everywhere(make_env, tuple(CONTEXTS))({})


def test_contexts_are_drawn_uniformly_and_a_seed_decides_all_that_follow():
    def drawn(seed):
        env = everywhere(Told)
        first = env.reset(seed=seed)[0][0]
        return [first, *(env.reset()[0][0] for _ in range(599))]

    once = drawn(3)
    assert drawn(3) == once
    assert drawn(4) != once
    shares = Counter(once)
    assert set(shares) == {1.0, 2.0, 4.0}
    assert all(abs(count - 200) < 5 * np.sqrt(600 * 2 / 9) for count in shares.values())


def test_a_fault_says_in_which_context():
    class Breaks(Told):
        def step(self, action):
            raise RuntimeError("lost" * 200)

    env = everywhere(Breaks)
    size = env.reset(seed=3)[0][0]
    with pytest.raises(RuntimeError) as crash:
        env.step(0)
    said = reason_of(crash.value)
    assert said.endswith(f"..., in the context {{'size': {size}}}")
    assert len(said) == REASON


def test_an_environment_is_closed_when_the_next_context_comes():
    env = everywhere(Told)
    env.reset(seed=0)
    before = env.env
    env.reset()
    assert before.closed
    assert not env.env.closed
    env.close()
    assert env.env.closed


def test_an_episode_is_as_long_as_in_the_mean_over_contexts():
    assert everywhere(Told).episode_steps == 3  # of 1, 2 and 4, rounded up


def test_contexts_of_other_spaces_are_refused():
    uneven = everywhere(lambda c: Told(c, width=int(c["size"])))
    uneven.reset(seed=11)  # it draws the narrow context first, and then a wider one
    with pytest.raises(InvalidInput, match="same spaces in each"):
        uneven.reset()
