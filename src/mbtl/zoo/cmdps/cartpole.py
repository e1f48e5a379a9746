"""CartPole with cart mass, pole mass and half-length as context (cmdp-spec, 4.1).

Notation: x, v cart position [m] and speed; t, w pole angle [rad] from upright and angular speed;
m pole mass, M total mass [kg]; l half the pole's length [m]; p = m l; F = +-force [N]; tau [s].

    a   = (F + p w^2 sin t) / M
    w'  = (g sin t - a cos t) / (l (4/3 - m cos^2 t / M))
    v'  = a - p w' cos t / M
    (x, v, t, w) += tau (v, v', w, w')                        explicit Euler, old speeds
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Literal, NamedTuple, Unpack

import numpy as np
from gymnasium.spaces import Discrete

from mbtl.contexts import Value
from mbtl.errors import InvalidInput, check_known
from mbtl.zoo.cmdps.contextual import ContextualEnv, Observation, Settings
from mbtl.zoo.cmdps.drawing import draw_cart

Physics = Literal["intended", "reference"]

X_LIMIT = 2.4
ANGLE_LIMIT = math.radians(12.0)
RESET_HALF_WIDTH = 0.05


class Constants(NamedTuple):
    """What one Euler step needs; pure numbers, derived from the features once."""

    gravity: float
    force: float
    timestep: float
    length: float
    pole_mass: float
    total_mass: float
    pole_moment: float
    """Pole mass x half-length [kg m]."""


def derive(features: Mapping[str, float], physics: Physics = "intended") -> Constants:
    """Constants of the dynamics from the features.

    Args:
        features: all of `CartPole.FEATURES`.
        physics: "intended" recomputes total mass and moment from the context. "reference" keeps
            them at the nominal 1.1 kg and 0.05 kg m as the released code does: there the cart mass
            never acts, pole mass and length act only in the denominator of w'.

    Raises:
        UnknownName: another physics.
    """
    check_known("physics", physics, ("intended", "reference"))
    source = features if physics == "intended" else CartPole.FEATURES
    return Constants(
        gravity=features["gravity"],
        force=features["force"],
        timestep=features["timestep"],
        length=features["length"],
        pole_mass=features["masspole"],
        total_mass=source["masscart"] + source["masspole"],
        pole_moment=source["masspole"] * source["length"],
    )


class CartPole(ContextualEnv):
    """Balance a pole on a cart that is pushed left (0) or right (1) at every step.

    Observation: x, v, t, w, then the visible features; reward 1 per step; the episode ends at
    |x| > 2.4 m or |t| > 12 degrees, and after `horizon` steps.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": ["rgb_array"], "render_fps": 50}

    HORIZON = 500
    FEATURES: ClassVar[Mapping[str, float]] = {
        "gravity": 9.8,  # m/s^2
        "masscart": 1.0,  # kg
        "masspole": 0.1,  # kg
        "length": 0.5,  # m, half the pole
        "force": 10.0,  # N
        "timestep": 0.02,  # s
    }

    def __init__(
        self,
        context: Mapping[str, Value] | None = None,
        *,
        physics: Physics = "intended",
        **settings: Unpack[Settings],
    ) -> None:
        """Derive the physics of one context.

        Args:
            context: features that differ from the nominal ones.
            physics: see `derive`.
            **settings: see `ContextualEnv`.
        """
        super().__init__(context, **settings)
        self.constants = derive(self.features, physics)
        self._state = (0.0, 0.0, 0.0, 0.0)
        # where several features vary, a light short pole on a light cart swings far in one step
        angle = 2 * ANGLE_LIMIT if len(context or {}) <= 1 else math.inf
        reach = [2 * X_LIMIT, math.inf, angle, math.inf]
        self.observation_space = self._space([-r for r in reach], reach)
        self.action_space = Discrete(2)

    @property
    def state(self) -> tuple[float, float, float, float]:
        """The state (x [m], v [m/s], t [rad], w [rad/s]); settable within an episode."""
        return self._state

    @state.setter
    def state(self, state: Sequence[float]) -> None:
        x, v, t, w = map(float, state)
        self._state = (x, v, t, w)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode with every state variable uniform in +-0.05."""
        super().reset(seed=seed)
        self.state = self.np_random.uniform(-RESET_HALF_WIDTH, RESET_HALF_WIDTH, 4).tolist()
        self._left = self.horizon
        return np.array(self._state + self.visible, dtype=np.float32), {}

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """One Euler step.

        Raises:
            InvalidInput: no episode is running, or the action is neither 0 nor 1.
        """
        if self._left <= 0:
            raise self._no_episode()
        g, force, tau, length, m, total, p = self.constants
        if action == 0:
            force = -force
        elif action != 1:
            raise InvalidInput(f"CartPole takes action 0 (left) or 1 (right), got {action!r}")
        x, v, t, w = self._state
        sin, cos = math.sin(t), math.cos(t)
        a = (force + p * w * w * sin) / total
        w_dot = (g * sin - a * cos) / (length * (4.0 / 3.0 - m * cos * cos / total))
        v_dot = a - p * w_dot * cos / total
        x, v, t, w = x + tau * v, v + tau * v_dot, t + tau * w, w + tau * w_dot
        self._state = (x, v, t, w)
        self._left -= 1
        out_of_time = self._left == 0
        failed = not (-X_LIMIT <= x <= X_LIMIT and -ANGLE_LIMIT <= t <= ANGLE_LIMIT)
        if failed:
            self._left = 0
        return (
            np.array((x, v, t, w, *self.visible), dtype=np.float32),
            1.0,
            failed or (out_of_time and self._terminal),
            out_of_time and not self._terminal,
            {},
        )

    def render(self) -> Any:
        """A picture, (height, width, 3); None without the render mode."""
        if self.render_mode is None:
            return None
        x, _, t, _ = self._state
        f = self.features
        return draw_cart(
            x, t, length=f["length"], cart=f["masscart"], pole=f["masspole"], reach=X_LIMIT
        )
