"""One step of a walker's world: impulses, then places, then what comes down within the step."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from mbtl.worlds.vectorised import batch_last
from mbtl.worlds.walker.body import WIDTHS, Body, across, body, dot, momentum, speeds, turned
from mbtl.worlds.walker.contact import PIECES, Box, Touch, below, deepest, touch
from mbtl.worlds.walker.impact import landed
from mbtl.worlds.walker.impulses import SLOP, Ground, Joints, Rows, settled

FPS = 50
_LIMITS = np.array([[-0.8, 1.1], [-1.6, -0.1], [-0.8, 1.1], [-1.6, -0.1]], np.float32)
"""Of the joints [rad]; hips count from the angles that they are made with."""
MADE = np.array([-0.05, 0.0, 0.05, 0.0], np.float32)
_LEG_FRICTION = 0.2
_LIFTS, _SHARE = 10, 0.2
"""Rounds in which places are mended, and how much of an overlap in each."""
_SLACK, _MOST_TURN = np.float32(np.radians(2.0)), np.float32(np.radians(8.0))
"""How far a joint may be beyond its limit, and the most that is mended at once [rad]."""

JOINTS = np.array(
    [
        [0, 0, -1, 1, 0, 0, 0],
        [0, 0, 0, -1, 1, 0, 0],
        [0, 0, -1, 0, 0, 1, 0],
        [0, 0, 0, 0, 0, -1, 1],
    ],
    np.float32,
)
_SHIN_WIDTHS = WIDTHS[1::2]
_GROUPS = ((0, 4, 2), (4, 8, 4), (8, 10, 1), (10, 12, 3))
"""Points at which legs may touch the ground, from and to, and of which body: two pieces of ground
for a shin, one for a thigh, two points each."""
_PARTS = [part for begin, stop, part in _GROUPS for _ in range(begin, stop)]


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


def moved(
    state: WalkerState, wanted: jax.Array, torques: jax.Array, params: WalkerParams
) -> WalkerState:
    """The state after one step of the world."""
    constants = params._replace(visible=())
    new: WalkerState = _moved(state, wanted, torques, constants)
    return new._replace(heights=state.heights)


def _step(
    state: WalkerState, wanted: jax.Array, torques: jax.Array, params: WalkerParams
) -> WalkerState:
    """As `moved`, of n walkers, the last axis of everything; without the ground."""
    now = body_of(state, params)
    first, touches = _touches(now, state)
    points = _points(touches)
    friction = jnp.sqrt(_LEG_FRICTION * params.friction)
    along, away = _rows(now, points)
    earth = Ground(
        Rows.of(along, now.inverse, points.valid),
        Rows.of(away, now.inverse, points.valid),
        friction,
    )
    bent = joint_angles(state.angles) - MADE[:, None]
    low, high = bent <= _LIMITS[:, :1], bent >= _LIMITS[:, 1:]
    inwards = jnp.where(low, 1.0, -1.0)
    motors = Rows.of(jnp.broadcast_to(JOINTS[..., None], (4, *now.inverse.shape[1:])), now.inverse)
    limits = Rows(
        motors.row * inwards[:, None],
        motors.effect * inwards[:, None],
        jnp.where(low | high, motors.ease, 0.0),
    )
    joints = Joints(motors, wanted, torques / FPS, limits)

    falling = state.moving.at[:, 1].add(-params.gravity / FPS)
    u = settled(_together(now, falling), joints, earth)
    moving = speeds(now, u)

    # places: each body for itself, then the joints pull it back, then out of limits and ground
    centre, angles = state.centre + u[:2] / FPS, state.angles + u[2:] / FPS
    gone = jnp.stack([moving[:, 0], moving[:, 1]]) / FPS
    strayed = now.centres + gone - body(centre, angles, params.scale).centres
    centre, angles = _pulled(now, strayed, jnp.zeros_like(angles), centre, angles)
    then = body(centre, angles, params.scale)
    arms = points.points - _of_parts(now.centres)
    turns = turned(_of_parts((angles - state.angles)[None])[0], *arms)
    shifts = _of_parts(then.centres) + turns - points.points
    gaps = points.gaps + dot(shifts, points.normals)
    bent = joint_angles(angles) - MADE[:, None]
    beyond = jnp.where(low, bent - _LIMITS[:, :1], _LIMITS[:, 1:] - bent)
    mended = _mended(limits, beyond, earth, gaps)
    centre, angles = centre + mended[:2], angles + mended[2:]

    # shins that come down within the step; thighs seldom do
    then = body(centre, angles, params.scale)
    was = _boxes(now.centres[:, 2::2], state.angles[2::2], _SHIN_WIDTHS)
    would = _boxes(then.centres[:, 2::2], angles[2::2], _SHIN_WIDTHS)
    inertia = jnp.stack([now.masses[2::2], now.masses[2::2], now.moments[2::2]])
    fast = jnp.swapaxes(moving[2::2], 0, 1)
    ends = landed(was, would, fast, inertia, state.heights, friction, 1.0 / FPS)
    moving = moving.at[2::2].set(jnp.swapaxes(ends.moving, 0, 1))
    strayed = jnp.zeros_like(then.centres).at[:, 2::2].set(ends.centre - would.centre)
    turned_off = jnp.zeros_like(angles).at[2::2].set(ends.angle - would.angle)
    centre, angles = _pulled(now, strayed, turned_off, centre, angles)

    touching = touches.valid.any(axis=0)
    feet = _feet(state, first, touching) | ends.touching.any(axis=1)
    hit = ends.hit
    return WalkerState(
        centre,
        angles,
        moving,
        (),
        first.at[1::2].set(jnp.where(hit, ends.first, first[1::2])),
        touching.at[1::2].set(jnp.where(hit[:, None], ends.touching, touching[1::2])),
        feet,
    )


_moved = batch_last(_step)


def body_of(state: WalkerState, params: WalkerParams) -> Body:
    """The body in its pose."""
    return body(state.centre, state.angles, params.scale)


def joint_angles(angles: jax.Array) -> jax.Array:
    """(4,) of the joints [rad]."""
    return angles[1:] - jnp.stack([angles[0], angles[1], angles[0], angles[3]])


def _together(now: Body, moving: jax.Array) -> jax.Array:
    """(7,) how bodies move that moved each for itself, when the joints pull."""
    return dot(momentum(now, moving), now.inverse)


def _pulled(
    now: Body, strayed: jax.Array, turned_off: jax.Array, centre: jax.Array, angles: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Hull and angles after the joints pulled back bodies that strayed from there."""
    shift = _together(now, jnp.stack([*strayed, turned_off], axis=1))
    return centre + shift[:2], angles + shift[2:]


def _boxes(centres: jax.Array, angles: jax.Array, widths: NDArray[np.float32]) -> Box:
    wide = widths.reshape(len(widths), *[1] * (angles.ndim - 1))
    return Box(centres, angles, jnp.broadcast_to(wide, angles.shape))


def _touches(now: Body, state: WalkerState) -> tuple[jax.Array, Touch]:
    """(4,) first pieces below the parts of the legs, and (..., 4, PIECES) points there."""
    boxes = _boxes(now.centres[:, 1:], state.angles[1:], WIDTHS)
    first, ends = below(boxes, state.heights)
    return first, touch(jax.tree.map(lambda x: jnp.expand_dims(x, -2), boxes), ends)


def _points(touches: Touch) -> Touch:
    """Those of `_PARTS`, (..., c)."""
    shins: Touch = jax.tree.map(lambda x: x[..., 1::2, :, :], touches)
    thighs: Touch = jax.tree.map(lambda x: x[..., 0::2, :, :], touches)
    (first, second), (only,) = deepest(shins, 2), deepest(thighs, 1)
    parts = [(each, leg) for leg in range(2) for each in (first, second)]
    parts += [(only, leg) for leg in range(2)]
    found = [jax.tree.map(lambda x, leg=leg: x[..., leg, :], each) for each, leg in parts]
    joint: Touch = jax.tree.map(lambda *x: jnp.concatenate(x, axis=-2), *found)
    return joint


def _of_parts(bodies: jax.Array) -> jax.Array:
    """(k, c) what the bodies of `_PARTS` have, of (k, 5)."""
    return jnp.stack([bodies[:, part] for part in _PARTS], axis=1)


def _rows(now: Body, points: Touch) -> tuple[jax.Array, jax.Array]:
    """(c, 7) rows along the ground and away from it."""
    hip, turn = now.hip[:, None], across(now.hip - now.centres[:, 0])[:, None]
    along: list[jax.Array] = []
    away: list[jax.Array] = []
    for begin, stop, part in _GROUPS:
        leg, shin = (part - 1) // 2, part % 2 == 0
        at, normals = points.points[:, begin:stop], points.normals[:, begin:stop]
        knee = now.knees[:, leg, None]
        thigh_arm = across((knee if shin else at) - hip)
        shin_arm = across(at - knee)
        for found, own in ((along, -across(normals)), (away, normals)):
            none = jnp.zeros_like(own[0])
            moved = [dot(own, thigh_arm), dot(own, shin_arm) if shin else none]
            legs = [*moved, none, none] if leg == 0 else [none, none, *moved]
            found.append(jnp.stack([*own, dot(own, turn), *legs], axis=1))
    return jnp.concatenate(along), jnp.concatenate(away)


def _mended(limits: Rows, beyond: jax.Array, earth: Ground, gaps: jax.Array) -> jax.Array:
    """(7,) how far hull and angles are moved out of limits and ground.

    Args:
        limits: see `Joints`.
        beyond: (4,) how far each joint is within its limit [rad].
        earth: points.
        gaps: (c,) at the points [m].
    """

    def one(number: int, moved: jax.Array) -> jax.Array:
        done = (number > 0) & (earth.overlap(moved, gaps) >= -3.0 * SLOP)
        further = moved
        for i in range(len(beyond)):
            wrong = beyond[i] + dot(limits.row[i], further) + _SLACK
            push = jnp.clip(wrong, -_MOST_TURN, 0.0) * limits.ease[i]
            further = further - limits.effect[i] * push
        return jnp.where(done, moved, earth.lift(further, gaps, _SHARE))

    start = jnp.zeros_like(limits.row[0])
    mended: jax.Array = jax.lax.fori_loop(0, _LIFTS, one, start)
    return mended


def _feet(state: WalkerState, first: jax.Array, touching: jax.Array) -> jax.Array:
    """(2,) whether shins are on the ground, after what touched it and what left it."""
    number = np.arange(PIECES)[:, None]
    shins, before = first[1::2, None] + number, state.first[1::2, None] + number  # (2, m, n)
    same = shins[:, :, None] == before[:, None, :]  # (2, now, before, n)
    now, then = touching[1::2], state.touching[1::2]
    come = (now & ~(same & then[:, None, :]).any(axis=2)).any(axis=1)
    gone = (then & ~(same & now[:, :, None]).any(axis=1)).any(axis=1)
    return jnp.where(gone, False, state.feet | come)
