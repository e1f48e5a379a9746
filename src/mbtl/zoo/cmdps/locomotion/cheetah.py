"""HalfCheetah with gravity, friction and stiffness as context (cmdp-spec, 4.4 and 10).

Gymnasium's HalfCheetah-v5, of which each instance has a model of its own. At multiplier 1 it is
that environment, step for step:

    gravity     [m/s^2], 9.81
    friction    sliding friction of all geoms, 0.4; of two that touch, MuJoCo takes the larger one
    stiffness   factor of the torque springs of the six joints with motors, 1; their damping stays

MuJoCo derives nothing from these when it compiles a model, so they are plain numbers in it.
"""

from __future__ import annotations

import copy
import functools
import math
from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple, Unpack

import mujoco
import numpy as np
from gymnasium.spaces import Box
from scipy.special import ndtri

from mbtl.arrays import Array
from mbtl.canvas import Canvas, Image, Window
from mbtl.contexts import Value
from mbtl.zoo.cmdps.contextual import ContextualEnv, Observation, Settings

# ---- the half cheetah as a MuJoCo model, with the numbers of Gymnasium's HalfCheetah-v5 ------
#
# Built here and not read from Gymnasium's file, which MuJoCo 4 calls deprecated whenever it is
# read.


SUBSTEPS = 5
"""Simulation steps of 0.01 s between two actions."""
MOTORS = slice(3, 9)
"""Joints with a motor and a spring; before them are those of the body in the world."""
_MASS = 14.0  # kg
_RADIUS = 0.046  # m, of all capsules


class _Part(NamedTuple):
    """A limb: lengths in m, angles in rad."""

    name: str
    parent: str
    place: tuple[float, float, float]
    reach: tuple[float, float]
    damping: float  # N m s/rad
    stiffness: float  # N m/rad
    gear: float  # N m
    middle: tuple[float, float, float]
    turn: float
    half_length: float


_LIMBS = (
    _Part(
        "bthigh", "torso", (-0.5, 0, 0), (-0.52, 1.05), 6, 240, 120, (0.1, 0, -0.13), -3.8, 0.145
    ),
    _Part(
        "bshin", "bthigh", (0.16, 0, -0.25), (-0.785, 0.785), 4.5, 180, 90, (-0.14, 0, -0.07),
        -2.03, 0.15,
    ),
    _Part(
        "bfoot", "bshin", (-0.28, 0, -0.14), (-0.4, 0.785), 3, 120, 60, (0.03, 0, -0.097),
        -0.27, 0.094,
    ),
    _Part(
        "fthigh", "torso", (0.5, 0, 0), (-1, 0.7), 4.5, 180, 120, (-0.07, 0, -0.12), 0.52, 0.133
    ),
    _Part(
        "fshin", "fthigh", (-0.14, 0, -0.24), (-1.2, 0.87), 3, 120, 60, (0.065, 0, -0.09),
        -0.6, 0.106,
    ),
    _Part(
        "ffoot", "fshin", (0.13, 0, -0.18), (-0.5, 0.5), 1.5, 60, 30, (0.045, 0, -0.07), -0.6, 0.07
    ),
)  # fmt: skip


def new_model() -> Any:
    """A model of one's own to change, `mujoco.MjModel`."""
    return copy.copy(base_model())


@functools.cache
def base_model() -> Any:
    """The model at multiplier 1, for all to copy and for nobody to change."""
    spec = mujoco.MjSpec()
    spec.modelname = "half cheetah"
    spec.compiler.degree = False
    spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE
    spec.option.timestep = 0.01
    # What is not a number must stay so: MuJoCo would start the simulation anew without a word.
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
    # All bodies hang together: looking for islands among them takes a tenth of a step, for nothing.
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_ISLAND
    _set_defaults(spec.default)
    _add_scenery(spec)
    torso = spec.worldbody.add_body(name="torso", pos=(0, 0, 0.7))
    slide, hinge = mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE
    torso.add_joint(name="rootx", type=slide, axis=(1, 0, 0), armature=0)
    torso.add_joint(name="rootz", type=slide, axis=(0, 0, 1), armature=0)
    torso.add_joint(name="rooty", type=hinge, axis=(0, 1, 0), armature=0)
    torso.add_camera(
        name="track", mode=mujoco.mjtCamLight.mjCAMLIGHT_TRACKCOM, pos=(0, -3, 0.3),
        quat=(math.sqrt(0.5), math.sqrt(0.5), 0, 0),
    )  # fmt: skip
    _add_capsule(torso, "torso", fromto=(-0.5, 0, 0, 0.5, 0, 0), size=(_RADIUS, 0, 0))
    _add_capsule(torso, "head", pos=(0.6, 0, 0.1), size=(_RADIUS, 0.15, 0), quat=_turned(0.87))
    bodies = {"torso": torso}
    for limb in _LIMBS:
        _add_limb(spec, bodies, limb)
    model = spec.compile()
    mujoco.mj_setTotalmass(model, _MASS)
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


def _set_defaults(default: Any) -> None:
    joint, geom = default.joint, default.geom
    joint.armature, joint.solref_limit, joint.solimp_limit[:3] = 0.1, (0.02, 1), (0, 0.8, 0.03)
    geom.friction, geom.solref, geom.solimp[:3] = (0.4, 0.1, 0.1), (0.02, 1), (0, 0.8, 0.01)
    geom.contype, geom.conaffinity, geom.condim = 1, 0, 3
    geom.rgba = (0.8, 0.6, 0.4, 1)


def _add_scenery(spec: Any) -> None:
    """The floor, with squares that show how fast the cheetah is, and a light."""
    squares = spec.add_texture(
        name="squares", type=mujoco.mjtTexture.mjTEXTURE_2D, width=100, height=100,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER, rgb1=(0.3, 0.35, 0.4), rgb2=(0.75, 0.8, 0.85),
    )  # fmt: skip
    floor = spec.add_material(name="floor", texrepeat=(1, 1), texuniform=True)
    floor.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = squares.name
    spec.worldbody.add_geom(
        name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=(0, 0, 1), conaffinity=1,
        material="floor", rgba=(1, 1, 1, 1),
    )  # fmt: skip
    spec.worldbody.add_light(pos=(0, 0, 3), dir=(0, 0, -1), type=1)


def _add_limb(spec: Any, bodies: dict[str, Any], limb: _Part) -> None:
    body = bodies[limb.name] = bodies[limb.parent].add_body(name=limb.name, pos=limb.place)
    body.add_joint(
        name=limb.name, type=mujoco.mjtJoint.mjJNT_HINGE, axis=(0, 1, 0), range=limb.reach,
        limited=True, damping=(limb.damping, 0, 0), stiffness=(limb.stiffness, 0, 0),
    )  # fmt: skip
    size = (_RADIUS, limb.half_length, 0)
    _add_capsule(body, limb.name, pos=limb.middle, size=size, quat=_turned(limb.turn))
    motor = spec.add_actuator(
        name=limb.name, trntype=mujoco.mjtTrn.mjTRN_JOINT, target=limb.name, ctrllimited=True,
        ctrlrange=(-1, 1),
    )  # fmt: skip
    motor.gear[0] = limb.gear


def _add_capsule(body: Any, name: str, **shape: Any) -> None:
    body.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_CAPSULE, **shape)


def _turned(angle: float) -> tuple[float, float, float, float]:
    """Quaternion of a turn about y."""
    return (math.cos(angle / 2), 0.0, math.sin(angle / 2), 0.0)


# Pictures of a half cheetah from the side, drawn from where its parts are: no OpenGL is needed


WIDTH = 480
"""Pixels."""
_VIEW, _SHAPE = 4.0, 0.5
"""Metres that are shown, and height by width."""
_SKY, _LIGHT, _DARK = (222, 230, 245), (150, 158, 168), (120, 128, 138)
_COLOURS = {"b": (150, 95, 40), "t": (205, 150, 80), "h": (205, 150, 80), "f": (225, 175, 110)}
"""By the first letter of a part: back leg, torso, head, front leg."""


def draw(model: Any, data: Any) -> Image:
    """What is around the cheetah; fields of the ground are one metre long.

    Args:
        model: `mujoco.MjModel`.
        data: `mujoco.MjData` of the moment, after its kinematics.

    Returns:
        (height, width, 3) uint8.
    """
    middle = float(data.qpos[0])
    left, bottom = middle - 0.5 * _VIEW, -0.12 * _VIEW
    window = Window(left, bottom, left + _VIEW, bottom + _SHAPE * _VIEW)
    canvas = Canvas(window, _SKY, WIDTH)
    for metre in range(int(np.floor(left)), int(np.ceil(left + _VIEW))):
        field = [(metre, 0.0), (metre + 1, 0.0), (metre + 1, bottom), (metre, bottom)]
        canvas.area(np.array(field, float), _DARK if metre % 2 else _LIGHT)
    for geom in range(1, model.ngeom):  # the first is the floor
        radius, half = model.geom_size[geom, :2]
        along = half * data.geom_xmat[geom].reshape(3, 3)[[0, 2], 2]
        place = data.geom_xpos[geom, [0, 2]]
        canvas.capsule(place - along, place + along, radius, _COLOURS[model.geom(geom).name[0]])
    return canvas.image()


# ---- the whole -------------------------------------------------------------------------------


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

    HORIZON = 1000
    FEATURES: ClassVar[Mapping[str, float]] = {
        "gravity": 9.81,  # m/s^2
        "friction": 0.4,
        "stiffness": 1.0,  # of the model's
    }

    def __init__(
        self, context: Mapping[str, Value] | None = None, **settings: Unpack[Settings]
    ) -> None:
        """Arguments as in `ContextualEnv`."""
        super().__init__(context, **settings)
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
        return self._seen(), float(reward), *self._ends(self._left == 0), {}

    def render(self) -> Any:
        """A picture from the side, (height, width, 3); None without the render mode."""
        return None if self.render_mode is None else draw(self.model, self.data)

    def _seen(self) -> Observation:
        data = self.data
        return np.concatenate([data.qpos[1:], data.qvel, self.visible], dtype=np.float32)
