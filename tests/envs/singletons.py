"""Simulators that live once per process, in a module of their own so that they can be sent."""

import os

import gymnasium
import numpy as np
from gymnasium.spaces import Box, Discrete

ENGINE = {}
"""Of this process, as MetaDrive and libsumo have it."""


class Walk(gymnasium.Env):
    """position += gain (action - 1/2); ten steps."""

    observation_space = Box(-np.inf, np.inf, (1,), np.float64)
    action_space = Discrete(2)
    strata = (0.25, 0.75)

    def __init__(self, context):
        self.gain, self.process = context["gain"], os.getpid()

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.x, self.t = float(self.np_random.normal()), 0
        return np.array([self.x]), {}

    def step(self, action):
        self.x += self.gain * (action - 0.5)
        self.t += 1
        return np.array([self.x]), self.x, False, self.t >= 10, {}

    def double(self, number, *, more=0):
        return 2 * number + more


class Guarded(Walk):
    """A second engine is refused."""

    def reset(self, **given):
        if ENGINE.setdefault("owner", self) is not self:
            raise AssertionError("there should be only one engine in one process")
        return super().reset(**given)

    def close(self):
        if ENGINE.get("owner") is self:
            del ENGINE["owner"]


class Shared(Walk):
    """A second simulation silently is the first."""

    def reset(self, **given):
        ENGINE["gain"] = self.gain
        return super().reset(**given)

    def step(self, action):
        self.gain = ENGINE["gain"]
        return super().step(action)


class Normalised(Walk):
    def __init__(self, context):
        super().__init__(context)
        self.running_mean = np.zeros(1)


ONLY = Walk({"gain": 1.0})


def only_one(context):
    return ONLY
