"""The half cheetah as a MuJoCo model, with the numbers of Gymnasium's HalfCheetah-v5.

Built here and not read from Gymnasium's file, which MuJoCo 4 calls deprecated whenever it is read.
"""

from __future__ import annotations

import copy
import functools
import math
from typing import Any, NamedTuple

import mujoco

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
