"""One step of a walker's world: impulses, then places, then what comes down within the step."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from mbtl.worlds.walker.body import WIDTHS, Body, across, body, momentum, speeds, turned
from mbtl.worlds.walker.contact import PIECES, Box, Touch, below, deepest, joined, touch
from mbtl.worlds.walker.impact import Landed, landed
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
_SHINS = np.array([2, 4])
_PARTS = np.array([2, 2, 2, 2, 4, 4, 4, 4, 1, 1, 3, 3])
"""Bodies of the points at which legs may touch the ground: two pieces of it for a shin, one for a
thigh, two points each."""


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
    bent = joint_angles(state.angles) - MADE
    low, high = bent <= _LIMITS[:, 0], bent >= _LIMITS[:, 1]
    inwards = jnp.where(low, 1.0, -1.0)
    limits = Rows.of(JOINTS * inwards[:, None], now.inverse, low | high)
    joints = Joints(Rows.of(jnp.asarray(JOINTS), now.inverse), wanted, torques / FPS, limits)

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
    bent = joint_angles(angles) - MADE
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


def body_of(state: WalkerState, params: WalkerParams) -> Body:
    """The body in its pose."""
    return body(state.centre, state.angles, params.scale)


def joint_angles(angles: jax.Array) -> jax.Array:
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
