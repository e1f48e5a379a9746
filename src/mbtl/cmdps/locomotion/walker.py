"""BipedalWalker with gravity, friction and scale as context (cmdp-spec, 4.3).

Gymnasium's BipedalWalker-v3 on Box2D, each instance with constants of its own. In the nominal
context it is that environment, step for step, on the same ground:

    gravity    [m/s^2], 10
    friction   of the ground, 2.5; with a leg, whose own is 0.2, Box2D takes sqrt(0.2 friction)
    scale      30; the smaller, the larger the hull and the rougher the ground
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from gymnasium.spaces import Box

from mbtl.cmdps.contextual import ContextualEnv, Observation, TimeLimit, Visibility
from mbtl.cmdps.locomotion.walker_body import (
    FPS,
    N_MOTORS,
    N_NOISE,
    STANCE,
    Constants,
    Walker,
    advance,
    luck,
)
from mbtl.contexts import Value
from mbtl.errors import InvalidInput


def derive(features: Mapping[str, float]) -> Constants:
    """Constants of the world from all of `BipedalWalker.FEATURES`, in single precision."""
    names = ("gravity", "friction", "scale")
    return Constants(*(float(np.float32(features[name])) for name in names))


class BipedalWalker(ContextualEnv):
    """Walk to the far end of slightly uneven ground, with motors in two hips and two knees.

    Observation: hull angle and its speed, forward and upward speed; of either leg hip angle and
    speed, knee angle and speed, and whether its foot is on the ground; ten ranges to the ground
    ahead; then the visible features. Reward: 300 for the whole way, less for a tilted hull and for
    torque; -100 for a fall, which ends the episode.
    """

    FEATURES: ClassVar[Mapping[str, float]] = {
        "gravity": 10.0,  # m/s^2
        "friction": 2.5,
        "scale": 30.0,
    }
    metadata: ClassVar[dict[str, Any]] = {"render_modes": ["rgb_array"], "render_fps": FPS}

    def __init__(
        self,
        context: Mapping[str, Value] | None = None,
        *,
        unit: Mapping[str, float] | None = None,
        visibility: Visibility = "multiplier",
        time_limit: TimeLimit = "truncation",
        horizon: int = 1000,
        render_mode: str | None = None,
    ) -> None:
        """Derive the world of one context.

        Args:
            context: features that differ from the nominal ones.
            unit: varied features and their value at multiplier 1; missing: those of `context`, at
                their nominal value.
            visibility: what of the context the policy sees.
            time_limit: whether the horizon is reported as truncation or as a terminal state (the
                reference).
            horizon: steps; 1000 as in the reference, 1600 in Gymnasium.
            render_mode: "rgb_array": `render` gives pictures.
        """
        super().__init__(
            context, unit=unit, visibility=visibility, time_limit=time_limit, horizon=horizon
        )
        self.render_mode = render_mode
        self.constants = derive(self.features)
        self.walker: Walker | None = None
        leg = [math.inf] * 4 + [1.0]
        high = [math.inf] * 4 + leg + leg + [1.0] * 10
        low = [-x if math.isinf(x) else 0.0 for x in high]
        self.observation_space = self._space(low, high)
        self.action_space = Box(-1.0, 1.0, (N_MOTORS,), np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode on new ground, with a push; the first step is without torque."""
        super().reset(seed=seed)
        self.walker = Walker(self.constants, luck(self.np_random.random(N_NOISE)))
        self._left = self.horizon
        seen, _, _ = advance([self.walker], np.zeros((1, N_MOTORS), np.float32))
        return self._shown(seen[0]), {}

    def drive(self) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """One step of standing still, where that goes: the unguided baseline."""
        return self.step(STANCE)

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """One step; actions beyond +-1 act as +-1.

        Raises:
            InvalidInput: no episode is running.
        """
        if self._left <= 0 or self.walker is None:
            raise self._no_episode()
        motors = np.asarray(action, np.float32).reshape(1, N_MOTORS)
        seen, reward, ended = advance([self.walker], motors)
        self._left = 0 if ended[0] else self._left - 1
        out_of_time = self._left == 0 and not ended[0]
        return (
            self._shown(seen[0]),
            float(reward[0]),
            bool(ended[0] or (out_of_time and self._terminal)),
            bool(out_of_time and not self._terminal),
            {},
        )

    def render(self) -> Any:
        """A picture of the walker, (height, width, 3); None without the render mode.

        Raises:
            InvalidInput: there is no walker yet.
        """
        if self.render_mode is None:
            return None
        if self.walker is None:
            raise InvalidInput("render() needs an episode, got none; call reset()")
        from mbtl.cmdps.locomotion.walker_drawing import draw

        return draw(self.walker)

    def _shown(self, seen: Observation) -> Observation:
        return np.concatenate([seen, self.visible], dtype=np.float32)
