"""Pendulum with mass, length and time step as context (cmdp-spec, 4.2).

Notation: t angle [rad] from upright, w angular speed [rad/s]; m mass [kg]; l length [m]; u torque
[N m]; dt [s]; W largest speed [rad/s].

    w <- clip(w + (1.5 g/l sin t + 3 u / (m l^2)) dt, -W, W)
    t <- t + w dt                                             with the new w
    reward = -(wrap(t)^2 + 0.1 w^2 + 0.001 u^2)               with the old t, w
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, NamedTuple, Unpack

import numpy as np
from gymnasium.spaces import Box

from mbtl.contexts import Value
from mbtl.zoo.cmdps.contextual import ContextualEnv, Observation, Settings
from mbtl.zoo.cmdps.drawing import draw_pendulum

MAX_TORQUE = 2.0
_RESET_HIGH = np.array([math.pi, 1.0])
_TURN = 2.0 * math.pi


class Constants(NamedTuple):
    """What one step needs; pure numbers, derived from the features once."""

    gravity_gain: float
    """dt 1.5 g/l: change of w per sin t."""
    torque_gain: float
    """dt 3/(m l^2): change of w per torque."""
    timestep: float
    max_speed: float


def derive(features: Mapping[str, float]) -> Constants:
    """Constants of the dynamics from all of `Pendulum.FEATURES`.

    The reference derives them too, so there is no other physics to choose.
    """
    dt, mass, length = features["timestep"], features["mass"], features["length"]
    return Constants(
        gravity_gain=1.5 * features["gravity"] / length * dt,
        torque_gain=3.0 / (mass * length**2) * dt,
        timestep=dt,
        max_speed=features["max_speed"],
    )


class Pendulum(ContextualEnv):
    """Swing a pendulum up and hold it, with a torque of at most 2 N m.

    Observation: cos t, sin t, w, then the visible features. Episodes last `horizon` steps whatever
    the time step, so 1 s to 100 s on the paper's grid.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": ["rgb_array"], "render_fps": 20}

    HORIZON = 200
    FEATURES: ClassVar[Mapping[str, float]] = {
        "max_speed": 8.0,  # rad/s
        "timestep": 0.05,  # s
        "gravity": 10.0,  # m/s^2
        "mass": 1.0,  # kg
        "length": 1.0,  # m
    }

    def __init__(
        self, context: Mapping[str, Value] | None = None, **settings: Unpack[Settings]
    ) -> None:
        """Arguments as in `ContextualEnv`."""
        super().__init__(context, **settings)
        self.constants = derive(self.features)
        self._state = (0.0, 0.0)
        # The space must not depend on the context, so a varied speed limit is not in its bounds.
        speed = math.inf if "max_speed" in (context or {}) else self.FEATURES["max_speed"]
        self.observation_space = self._space([-1.0, -1.0, -speed], [1.0, 1.0, speed])
        self.action_space = Box(-MAX_TORQUE, MAX_TORQUE, (1,), np.float32)

    @property
    def state(self) -> tuple[float, float]:
        """The state (t [rad], w [rad/s]); settable within an episode."""
        return self._state

    @state.setter
    def state(self, state: Sequence[float]) -> None:
        t, w = map(float, state)
        self._state = (t, w)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode with t uniform in +-pi and w uniform in +-1."""
        super().reset(seed=seed)
        self.state = self.np_random.uniform(-_RESET_HIGH, _RESET_HIGH).tolist()
        self._left = self.horizon
        t, w = self._state
        return np.array((math.cos(t), math.sin(t), w, *self.visible), dtype=np.float32), {}

    def drive(self) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """One step without torque: the unguided baseline."""
        return self.step((0.0,))

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """One step; torques beyond the limit are clipped, NaN is passed on.

        Raises:
            InvalidInput: no episode is running.
        """
        if self._left <= 0:
            raise self._no_episode()
        gravity_gain, torque_gain, dt, max_speed = self.constants
        t, w = self._state
        u = min(max(float(action[0]), -MAX_TORQUE), MAX_TORQUE)
        wrapped = (t + math.pi) % _TURN - math.pi
        reward = -(wrapped * wrapped + 0.1 * w * w + 0.001 * u * u)
        w += gravity_gain * math.sin(t) + torque_gain * u
        w = min(max(w, -max_speed), max_speed)
        t += w * dt
        self._state = (t, w)
        self._left -= 1
        out_of_time = self._left == 0
        return (
            np.array((math.cos(t), math.sin(t), w, *self.visible), dtype=np.float32),
            reward,
            out_of_time and self._terminal,
            out_of_time and not self._terminal,
            {},
        )

    def render(self) -> Any:
        """A picture, (height, width, 3); None without the render mode."""
        if self.render_mode is None:
            return None
        return draw_pendulum(self._state[0], mass=self.features["mass"])
