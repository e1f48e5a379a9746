"""HalfCheetah with gravity, friction and stiffness as context (cmdp-spec, 4.4 and 10).

Gymnasium's HalfCheetah-v5, of which each instance has a model of its own. At multiplier 1 it is
that environment, step for step:

    gravity     [m/s^2], 9.81
    friction    sliding friction of all geoms, 0.4; of two that touch, MuJoCo takes the larger one
    stiffness   factor of the torque springs of the six joints with motors, 1; their damping stays

MuJoCo derives nothing from these when it compiles a model, so they are plain numbers in it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple

import mujoco
import numpy as np
from gymnasium.spaces import Box
from scipy.special import ndtri

from mbtl.arrays import Array
from mbtl.cmdps.contextual import ContextualEnv, Observation, TimeLimit, Visibility
from mbtl.cmdps.locomotion.cheetah_drawing import draw
from mbtl.cmdps.locomotion.cheetah_model import MOTORS, SUBSTEPS, new_model
from mbtl.contexts import Value

STEP = 0.05
"""Seconds between two actions."""
ACTION_COST = 0.1
"""Reward lost per squared action."""
N_MOTORS, N_POSITIONS = 6, 9
N_FEATURES = 17
"""Of an observation: all positions but the way run, and all speeds."""
N_NOISE = 2 * N_POSITIONS
"""Uniform random numbers that start an episode."""
_SPREAD = 0.1
_LEAST = 2.0**-24  # of uniform numbers: normal ones must be finite


class Constants(NamedTuple):
    """What a context changes in the model."""

    gravity: float
    friction: float
    stiffness: float


def derive(features: Mapping[str, float]) -> Constants:
    """Constants of the model from all of `HalfCheetah.FEATURES`."""
    return Constants(features["gravity"], features["friction"], features["stiffness"])


def first_state(noise: Any, numpy: Any = np, ndtri: Any = ndtri) -> tuple[Any, Any]:
    """Positions, uniform in +-0.1, and speeds, normal with deviation 0.1.

    Args:
        noise: (..., 18) uniform numbers in [0, 1).
        numpy: whose functions, NumPy's or jax's.
        ndtri: inverse of the normal distribution, likewise.
    """
    place, speed = noise[..., :N_POSITIONS], noise[..., N_POSITIONS:]
    normal = ndtri(numpy.clip(speed, _LEAST, 1.0 - _LEAST))
    return _SPREAD * (2.0 * place - 1.0), _SPREAD * normal


class HalfCheetah(ContextualEnv):
    """Run forward on two legs in a plane: 0.05 s per action, and no early end.

    Observation: height, pitch and six joint angles; forward and upward speed, pitch rate and six
    joint rates; then the visible features. Reward: forward speed - 0.1 x the sum of squared
    actions. Actions beyond +-1 act as +-1 but cost what they are, as in Gymnasium.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": ["rgb_array"], "render_fps": 20}

    FEATURES: ClassVar[Mapping[str, float]] = {
        "gravity": 9.81,  # m/s^2
        "friction": 0.4,
        "stiffness": 1.0,  # of the model's
    }

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
        """Make the model of one context.

        Args:
            context: features that differ from the nominal ones.
            unit: varied features and their value at multiplier 1; missing: those of `context`, at
                their nominal value.
            visibility: what of the context the policy sees.
            time_limit: whether the horizon is reported as truncation or as a terminal state (the
                reference).
            horizon: steps.
            render_mode: "rgb_array": `render` gives pictures.
        """
        super().__init__(
            context, unit=unit, visibility=visibility, time_limit=time_limit, horizon=horizon
        )
        self.render_mode = render_mode
        self.constants = derive(self.features)
        self.model = new_model()
        self.model.opt.gravity[2] = -self.constants.gravity
        self.model.geom_friction[:, 0] = self.constants.friction
        self.model.jnt_stiffness[MOTORS] *= self.constants.stiffness
        self.data = mujoco.MjData(self.model)
        self.observation_space = self._space([-np.inf] * N_FEATURES, [np.inf] * N_FEATURES)
        self.action_space = Box(-1.0, 1.0, (N_MOTORS,), np.float32)

    @property
    def state(self) -> tuple[Array, Array]:
        """Positions and speeds, (9,) each; settable within an episode, with no memory of before."""
        return self.data.qpos.copy(), self.data.qvel.copy()

    @state.setter
    def state(self, state: tuple[Array, Array]) -> None:
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:], self.data.qvel[:] = state
        mujoco.mj_forward(self.model, self.data)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode near standing still; see `first_state`."""
        super().reset(seed=seed)
        self.state = first_state(self.np_random.random(N_NOISE))
        self._left = self.horizon
        return self._seen(), {}

    def drive(self) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """One step without torque: the unguided baseline."""
        return self.step(np.zeros(N_MOTORS))

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """One step; what is not a number stays so, in the action as in the simulator.

        Raises:
            InvalidInput: no episode is running.
        """
        if self._left <= 0:
            raise self._no_episode()
        data, action = self.data, np.asarray(action, np.float64)
        before = data.qpos[0]
        data.ctrl[:] = action
        mujoco.mj_step(self.model, data, nstep=SUBSTEPS)
        reward = (data.qpos[0] - before) / STEP - ACTION_COST * np.square(action).sum()
        self._left -= 1
        out_of_time = self._left == 0
        return (
            self._seen(),
            float(reward),
            out_of_time and self._terminal,
            out_of_time and not self._terminal,
            {},
        )

    def render(self) -> Any:
        """A picture from the side, (height, width, 3); None without the render mode."""
        return None if self.render_mode is None else draw(self.model, self.data)

    def _seen(self) -> Observation:
        data = self.data
        return np.concatenate([data.qpos[1:], data.qvel, self.visible], dtype=np.float32)
