"""BipedalWalker as pure functions; environment and notation of `mbtl.cmdps.locomotion.walker`.

Box2D's world of five bodies, with two things done otherwise. Joints hold exactly, so seven numbers
move all (`body.py`). And an episode begins in the pose that Box2D's walker has two steps after it
was put together with its legs half a metre too high, see `_START`. How near the two are, page
docs/locomotion.md says.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from mbtl.worlds import environments, random
from mbtl.worlds.environments import TimeLimit
from mbtl.worlds.walker import ground
from mbtl.worlds.walker.body import (
    HULL,
    WIDTHS,
    Body,
    across,
    body,
    momentum,
    offset,
    speeds,
    turned,
)
from mbtl.worlds.walker.contact import PIECES, SKIN, Box, Touch, below, deepest, joined, touch
from mbtl.worlds.walker.impact import Landed, landed
from mbtl.worlds.walker.impulses import SLOP, Ground, Joints, Rows, settled

FPS = 50
TORQUE = 80.0
SPEEDS = np.array([4.0, 6.0, 4.0, 6.0], np.float32)
"""Of hips and knees [rad/s], at full speed."""
STANCE = (-0.2, 0.0, 0.2, 0.0)
"""An action with which it stands still: hips held apart. Without any torque it falls."""

_ACTION = environments.Box((-1.0,) * 4, (1.0,) * 4)
_LIMITS = np.array([[-0.8, 1.1], [-1.6, -0.1], [-0.8, 1.1], [-1.6, -0.1]], np.float32)
"""Of the joints [rad]; hips count from the angles that they are made with."""
_MADE = np.array([-0.05, 0.0, 0.05, 0.0], np.float32)
_LEG_FRICTION = 0.2
_PUSH = 5.0
"""Largest force on the hull in the first step [N]."""
_LIFTS, _SHARE = 10, 0.2
"""Rounds in which places are mended, and how much of an overlap in each."""
_SLACK, _MOST_TURN = np.float32(np.radians(2.0)), np.float32(np.radians(8.0))
"""How far a joint may be beyond its limit, and the most that is mended at once [rad]."""
_HULL_PIECES = 11
"""Of ground below the hull; a larger hull lies on the ground from the start."""

_JOINTS = np.array(
    [
        [0, 0, -1, 1, 0, 0, 0],
        [0, 0, 0, -1, 1, 0, 0],
        [0, 0, -1, 0, 0, 1, 0],
        [0, 0, 0, 0, 0, -1, 1],
    ],
    np.float32,
)
_SHINS = np.array([2, 4])
_PARTS = np.array([2, 2, 2, 2, 4, 4, 4, 4, 1, 1, 3, 3])
"""Bodies of the points at which legs may touch the ground: two pieces of it for a shin, one for a
thigh, two points each."""

_START = np.array(
    [  # scale, height of the hull's origin above the ground, its angle, hips and knees
        [5, 2.260, 0.000, 0.517, -1.169, 0.517, -1.166],
        [7, 2.265, 0.000, 0.512, -1.160, 0.513, -1.157],
        [10, 2.275, 0.000, 0.504, -1.143, 0.505, -1.140],
        [15, 2.298, 0.000, 0.484, -1.102, 0.486, -1.100],
        [20, 2.327, -0.001, 0.458, -1.046, 0.460, -1.044],
        [30, 2.399, -0.005, 0.386, -0.885, 0.389, -0.884],
        [40, 2.477, -0.011, 0.277, -0.647, 0.285, -0.652],
        [50, 2.529, -0.005, 0.125, -0.333, 0.154, -0.378],
        [60, 2.542, 0.006, 0.036, -0.135, 0.065, -0.173],
        [80, 2.568, -0.001, 0.028, -0.100, 0.049, -0.112],
        [100, 2.622, -0.033, 0.066, -0.096, 0.082, -0.103],
        [200, 2.731, -0.137, 0.184, -0.100, 0.186, -0.082],
        [300, 2.760, -0.160, 0.205, -0.099, 0.202, -0.069],
    ],
    np.float32,
)
"""Of Box2D's walker after two steps without torque (`evidence/walker_twin.py --part start`)."""


class WalkerParams(NamedTuple):
    """What a context changes, as `mbtl.cmdps.locomotion.walker.derive` orders it; scalars."""

    gravity: jax.Array
    friction: jax.Array
    scale: jax.Array
    visible: jax.Array


class WalkerState(NamedTuple):
    """A walker on its ground.

    Attributes:
        centre: (2,) of the hull's mass [m].
        angles: (5,) of hull, thigh, shin, thigh and shin [rad].
        moving: (5, 3) speeds of the bodies, each for itself, and angular speeds.
        heights: (200,) of the ground [m].
        first: (4,) number of the first piece of ground below each part of a leg.
        touching: (4, PIECES) which of the pieces from there on it touches.
        feet: (2,) whether a shin has come to the ground; one that leaves a piece of it counts as in
            the air, as in Gymnasium.
    """

    centre: jax.Array
    angles: jax.Array
    moving: jax.Array
    heights: jax.Array
    first: jax.Array
    touching: jax.Array
    feet: jax.Array


@dataclass(frozen=True)
class BipedalWalker:
    """Walk to the far end of slightly uneven ground, with motors in two hips and two knees."""

    horizon: int = 1000
    time_limit: TimeLimit = "truncation"
    action: environments.Box = _ACTION
    n_features: int = 24
    n_noise: int = 2
    max_return: float | None = None
    idle: tuple[float, ...] = STANCE
    params: type[WalkerParams] = WalkerParams

    def initial(self, noise: jax.Array, params: WalkerParams) -> WalkerState:
        """A walker on new ground, with a push."""
        words = jnp.floor(noise * 2.0**24).astype(jnp.uint32)
        seed = (words[0] ^ (words[1] << 8))[None]
        luck = random.uniform(seed, 0, jnp.uint32(0), ground.ROUGH + ground.PATCHES + 1)[:, 0]
        pose = [jnp.interp(params.scale, _START[:, 0], column) for column in _START[:, 1:].T]
        height, hull, hip, knee, other_hip, other_knee = pose
        turns = [
            hull,
            hull + hip,
            hull + hip + knee,
            hull + other_hip,
            hull + other_hip + other_knee,
        ]
        origin = jnp.stack([ground.STEP * ground.FLAT / 2.0, ground.HEIGHT + height])
        centre = origin + turned(hull, *offset(params.scale))
        angles = jnp.stack(turns)
        push = (-_PUSH + 2.0 * _PUSH * luck[-1]) / FPS
        moving = jnp.zeros((5, 3)).at[0, 0].set(push / body(centre, angles, params.scale).masses[0])
        return WalkerState(
            centre,
            angles,
            moving,
            ground.heights(luck[:-1], params.scale),
            jnp.zeros(4, jnp.int32),
            jnp.zeros((4, PIECES), bool),
            jnp.ones(2, bool),
        )

    def step(
        self, state: WalkerState, action: jax.Array, params: WalkerParams
    ) -> environments.Step:
        """One step of 1/50 s; actions beyond +-1 act as +-1."""
        strength = jnp.minimum(jnp.abs(action), 1.0)
        new = _moved(state, jnp.sign(action) * SPEEDS, TORQUE * strength, params)
        now, x = _body(new, params), _origin(new, params)[0]
        fallen = _lies(now, new, params) | (x < 0.0)
        gain = _progress(new, params) - _progress(state, params)
        reward = jnp.where(fallen, -100.0, gain - 0.00035 * TORQUE * strength.sum())
        return environments.Step(new, reward, fallen | (x > ground.END) | ~jnp.isfinite(x))

    def observe(self, state: WalkerState, params: WalkerParams) -> jax.Array:
        """Hull, joints, feet, ranges and the visible features, as Gymnasium orders them."""
        hull, turning = state.moving[0], state.moving[:, 2] @ _JOINTS[:, 2:].T / SPEEDS
        view = 0.3 / FPS / params.scale
        bent = _angles(state.angles) - _MADE + jnp.array([0.0, 1.0, 0.0, 1.0])
        joints = jnp.stack([bent, turning], axis=-1).reshape(2, 4)
        legs = jnp.concatenate([joints, state.feet[:, None]], axis=1).reshape(-1)
        seen = [
            jnp.stack([
                state.angles[0],
                2.0 * hull[2] / FPS,
                600.0 * view * hull[0],
                400.0 * view * hull[1],
            ]),
            legs,
            ground.ranges(state.heights, _origin(state, params)),
            params.visible,
        ]  # fmt: skip
        return jnp.concatenate(seen).astype(jnp.float32)


def _moved(
    state: WalkerState, wanted: jax.Array, torques: jax.Array, params: WalkerParams
) -> WalkerState:
    """The state after one step of the world."""
    now = _body(state, params)
    first, touches = _touches(now, state)
    points = _points(touches)
    friction = jnp.sqrt(_LEG_FRICTION * params.friction)
    along, away = _rows(now, points)
    earth = Ground(
        Rows.of(along, now.inverse, points.valid),
        Rows.of(away, now.inverse, points.valid),
        friction,
    )
    bent = _angles(state.angles) - _MADE
    low, high = bent <= _LIMITS[:, 0], bent >= _LIMITS[:, 1]
    inwards = jnp.where(low, 1.0, -1.0)
    limits = Rows.of(_JOINTS * inwards[:, None], now.inverse, low | high)
    joints = Joints(Rows.of(jnp.asarray(_JOINTS), now.inverse), wanted, torques / FPS, limits)

    falling = state.moving.at[:, 1].add(-params.gravity / FPS)
    u = settled(_together(now, falling), joints, earth)
    moving = speeds(now, u)

    # places: each body for itself, then the joints pull it back, then out of limits and ground
    centre, angles = state.centre + u[:2] / FPS, state.angles + u[2:] / FPS
    strayed = now.centres + moving[:, :2] / FPS - body(centre, angles, params.scale).centres
    centre, angles = _pulled(now, strayed, jnp.zeros(5), centre, angles)
    then = body(centre, angles, params.scale)
    arms = points.points - now.centres[_PARTS]
    turns = (angles - state.angles)[_PARTS]
    shifts = then.centres[_PARTS] + turned(turns, arms[:, 0], arms[:, 1]) - points.points
    gaps = points.gaps + (shifts * points.normals).sum(-1)
    bent = _angles(angles) - _MADE
    beyond = jnp.where(low, bent - _LIMITS[:, 0], _LIMITS[:, 1] - bent)
    mended = _mended(limits, beyond, earth, gaps)
    centre, angles = centre + mended[:2], angles + mended[2:]

    # shins that come down within the step
    then = body(centre, angles, params.scale)
    ends = _landed(now, then, state, angles, moving, friction)
    moving = moving.at[_SHINS].set(ends.moving)
    strayed = jnp.zeros((5, 2)).at[_SHINS].set(ends.centre - then.centres[_SHINS])
    turned_off = jnp.zeros(5).at[_SHINS].set(ends.angle - angles[_SHINS])
    centre, angles = _pulled(now, strayed, turned_off, centre, angles)

    touching = touches.valid.any(-1)
    feet = _feet(state, first, touching)
    feet = feet | ends.touching.any(-1)
    return WalkerState(
        centre,
        angles,
        moving,
        state.heights,
        first.at[1::2].set(jnp.where(ends.hit, ends.first, first[1::2])),
        touching.at[1::2].set(jnp.where(ends.hit[:, None], ends.touching, touching[1::2])),
        feet,
    )


def _body(state: WalkerState, params: WalkerParams) -> Body:
    return body(state.centre, state.angles, params.scale)


def _origin(state: WalkerState, params: WalkerParams) -> jax.Array:
    """(2,) of the hull [m]."""
    return state.centre - turned(state.angles[0], *offset(params.scale))


def _progress(state: WalkerState, params: WalkerParams) -> jax.Array:
    """What the way so far is worth."""
    x = _origin(state, params)[0]
    return 130.0 * x / params.scale - 5.0 * jnp.abs(state.angles[0])


def _angles(angles: jax.Array) -> jax.Array:
    """(4,) of the joints [rad]."""
    return angles[jnp.array([1, 2, 3, 4])] - angles[jnp.array([0, 1, 0, 3])]


def _together(now: Body, moving: jax.Array) -> jax.Array:
    """(7,) how bodies move that moved each for itself, when the joints pull."""
    return (now.inverse * momentum(now, moving)[None]).sum(-1)


def _pulled(
    now: Body, strayed: jax.Array, turned_off: jax.Array, centre: jax.Array, angles: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Hull and angles after the joints pulled back bodies that strayed from there."""
    shift = _together(now, jnp.concatenate([strayed, turned_off[:, None]], axis=1))
    return centre + shift[:2], angles + shift[2:]


def _boxes(now: Body, angles: jax.Array) -> Box:
    return Box(now.centres[1:], angles[1:], jnp.asarray(WIDTHS))


def _touches(now: Body, state: WalkerState) -> tuple[jax.Array, Touch]:
    """(4,) first pieces below the parts of the legs, and (4, PIECES, 2) points there."""

    def of(box: Box) -> tuple[jax.Array, Touch]:
        first, ends = below(box, state.heights)
        return first, jax.vmap(touch, (None, 0))(box, ends)

    found: tuple[jax.Array, Touch] = jax.vmap(of)(_boxes(now, state.angles))
    return found


def _points(touches: Touch) -> Touch:
    """Those of `_PARTS`."""
    parts = [jax.tree.map(lambda x, i=i: x[i], touches) for i in (1, 3, 0, 2)]
    return joined([deepest(part, n) for part, n in zip(parts, (2, 2, 1, 1), strict=True)])


def _rows(now: Body, points: Touch) -> tuple[jax.Array, jax.Array]:
    """(c, 7) rows along the ground and away from it."""
    turn = across(now.hip - now.centres[0])
    directions = jnp.stack([-across(points.normals), points.normals])  # (2, c, 2)
    rows = []
    for i, part in enumerate(_PARTS.tolist()):
        leg = (part - 1) // 2
        joint, shin = now.knees[leg], part % 2 == 0
        thigh_arm = across((joint if shin else points.points[i]) - now.hip)
        shin_arm = across(points.points[i] - joint) if shin else jnp.zeros(2)
        arms = jnp.zeros((5, 2)).at[0].set(turn)
        arms = arms.at[2 * leg + 1].set(thigh_arm).at[2 * leg + 2].set(shin_arm)
        own = directions[:, i]  # (2, 2)
        rows.append(jnp.concatenate([own, (own[:, None] * arms[None]).sum(-1)], axis=1))
    found = jnp.stack(rows, axis=1)
    return found[0], found[1]


def _mended(limits: Rows, beyond: jax.Array, earth: Ground, gaps: jax.Array) -> jax.Array:
    """(7,) how far hull and angles are moved out of limits and ground.

    Args:
        limits: see `Joints`.
        beyond: (4,) how far each joint is within its limit [rad].
        earth: points.
        gaps: (c,) at the points [m].
    """

    def back(moved: jax.Array, own: tuple[Rows, jax.Array]) -> tuple[jax.Array, None]:
        limit, beyond = own
        wrong = jnp.clip(beyond + limit.along(moved) + _SLACK, -_MOST_TURN, 0.0)
        return moved - limit.effect * wrong * limit.ease, None

    def one(number: int, moved: jax.Array) -> jax.Array:
        done = (number > 0) & (earth.overlap(moved, gaps) >= -3.0 * SLOP)
        further, _ = jax.lax.scan(back, moved, (limits, beyond))
        return jnp.where(done, moved, earth.lift(further, gaps, _SHARE))

    mended: jax.Array = jax.lax.fori_loop(0, _LIFTS, one, jnp.zeros(7))
    return mended


def _landed(
    now: Body,
    then: Body,
    state: WalkerState,
    angles: jax.Array,
    moving: jax.Array,
    friction: jax.Array,
) -> Landed:
    """The shins at the end of the step; thighs seldom come down."""

    def of(box: Box, centre, angle, moving, mass, moment) -> Landed:  # type: ignore[no-untyped-def]
        return landed(
            box, centre, angle, moving, (mass, moment), state.heights, friction, 1.0 / FPS
        )

    shins: Box = jax.tree.map(lambda x: x[1::2], _boxes(now, state.angles))
    found: Landed = jax.vmap(of)(
        shins,
        then.centres[_SHINS],
        angles[_SHINS],
        moving[_SHINS],
        now.masses[_SHINS],
        now.moments[_SHINS],
    )
    return found


def _feet(state: WalkerState, first: jax.Array, touching: jax.Array) -> jax.Array:
    """(2,) whether shins are on the ground, after what touched it and what left it."""
    pieces, before = first[:, None] + jnp.arange(PIECES), state.first[:, None] + jnp.arange(PIECES)
    same = pieces[:, :, None] == before[:, None, :]  # (4, now, before)
    come = (touching & ~(same & state.touching[:, None, :]).any(2)).any(1)
    gone = (state.touching & ~(same & touching[:, :, None]).any(1)).any(1)
    return jnp.where(gone[1::2], False, state.feet | come[1::2])


def _lies(now: Body, state: WalkerState, params: WalkerParams) -> jax.Array:
    """Whether the hull touches the ground."""
    corners = jnp.asarray(HULL, jnp.float32) / params.scale
    at = now.origin + turned(state.angles[0], corners[:, 0], corners[:, 1])  # (5, 2), clockwise
    piece = jnp.clip(jnp.floor(at[:, 0] / ground.STEP), 0, ground.POINTS - 2).astype(jnp.int32)
    left, right = state.heights[piece], state.heights[piece + 1]
    level = left + (right - left) * (at[:, 0] / ground.STEP - piece)
    above = (at[:, 0] >= 0.0) & (at[:, 0] <= ground.STEP * (ground.POINTS - 1))
    corner = above & (at[:, 1] - level < SKIN)
    first = ground.number(now.origin[0] - ground.STEP * _HULL_PIECES / 2.0, _HULL_PIECES)
    points = ground.pieces(state.heights, first, _HULL_PIECES)
    outward = across(jnp.roll(at, -1, axis=0) - at)
    outward = outward / jnp.sqrt((outward * outward).sum(-1, keepdims=True))
    out = ((points[:, None] - at[None]) * outward[None]).sum(-1).max(-1)
    return corner.any() | (out < SKIN).any()
