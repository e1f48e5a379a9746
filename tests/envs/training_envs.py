"""Environments of the training tests, in a module of their own so that trainers pickle."""

import os

import gymnasium
import numpy as np
from gymnasium import spaces


def same(one, other):
    """Whether two models of Stable-Baselines3 have the same weights."""
    pairs = zip(one.policy.parameters(), other.policy.parameters(), strict=True)
    return all(bool((a == b).all()) for a, b in pairs)


def cartpole(context):
    env = gymnasium.make("CartPole-v1")
    env.unwrapped.length = context["length"]
    env.unwrapped.polemass_length = env.unwrapped.masspole * context["length"]
    return env


def pendulum(context):
    env = gymnasium.make("Pendulum-v1", max_episode_steps=50)
    env.unwrapped.m = context["mass"]
    return env


class Guess(gymnasium.Env):
    """Name the sign of a number: `length` guesses per episode, 1 point for each right one."""

    observation_space = spaces.Box(-1, 1, (1,), np.float32)
    action_space = spaces.Discrete(2)

    def __init__(self, context):
        self.length, self.closed = int(context.get("length", 5)), False

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.left = self.length
        return self._next(), {}

    def step(self, action):
        reward = float(self.points(action))
        self.left -= 1
        return self._next(), reward, self.left == 0, False, {}

    def points(self, action):
        return (self.number[0] > 0) == bool(action)

    def _next(self):
        self.number = self.np_random.uniform(-1, 1, 1).astype(np.float32)
        return self.number

    def close(self):
        assert not self.closed
        self.closed = True


class MaskedGuess(Guess):
    """Only the right answer is allowed."""

    def action_masks(self):
        right = self.number[0] > 0
        return np.array([not right, right])


class GuessPair(Guess):
    """Two answers at once: the sign, and whether the number is beyond a half."""

    action_space = spaces.MultiDiscrete([2, 3])

    def points(self, action):
        assert action.shape == (2,)
        return (self.number[0] > 0) == bool(action[0])


class GuessDict(Guess):
    """The number inside a dictionary of observations."""

    observation_space = spaces.Dict(
        {"number": Guess.observation_space, "two": Guess.observation_space}
    )

    def _next(self):
        number = super()._next()
        return {"number": number, "two": number}


class GuessBits(Guess):
    """A vector of yes and no."""

    action_space = spaces.MultiBinary(2)

    def points(self, action):
        assert action.shape == (2,)
        return (self.number[0] > 0) == bool(action[0])


class NanAfter(Guess):
    """Observations turn NaN in the 20th step of an episode."""

    def __init__(self, context):
        super().__init__({"length": 60})

    def _next(self):
        number = super()._next()
        return number * np.float32(np.nan) if self.left < 40 else number


class NanReward(Guess):
    """The reward is not a number."""

    def points(self, action):
        return np.nan


class Endless(Guess):
    """No episode ever ends."""

    def step(self, action):
        observation, reward, *_ = super().step(action)
        return observation, reward, False, False, {}


class Broken(Guess):
    """Fails with an error of its own."""

    def step(self, action):
        raise RuntimeError("the simulator lost its connection")


class Gone(Guess):
    """What the end of a simulator's process looks like."""

    def step(self, action):
        raise EOFError


class Dies(Guess):
    """Its process ends in the middle of an episode, as a simulator that crashes takes its own."""

    def __init__(self, context):
        super().__init__({"length": 60})

    def step(self, action):
        if self.left == 30:
            os._exit(3)
        return super().step(action)
