"""A part of a leg that comes down on the ground within a step.

As in Box2D it is stopped where it arrives, as if it hung on nothing, and goes on from there with
the rest of the step; the joints pull it back in the next one. Without this a foot would be a few
centimetres in the ground before it is felt.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from mbtl.worlds.walker.body import across, dot
from mbtl.worlds.walker.contact import Box, apart, below, deepest, touch
from mbtl.worlds.walker.impulses import SLOP, Ground, Rows

_STOP, _TOLERANCE = 0.005, 0.00125
"""A part is stopped at this distance, within the tolerance [m]."""
_LOOKS, _LIFTS, _ROUNDS = 3, 2, 8


class Landed(NamedTuple):
    """A part at the end of the step.

    Attributes:
        centre: (2,) [m].
        angle: [rad].
        moving: (3,) speed and angular speed.
        hit: whether it came down.
        first: number of the first piece of ground below it.
        touching: (m,) which pieces it touched.
    """

    centre: jax.Array
    angle: jax.Array
    moving: jax.Array
    hit: jax.Array
    first: jax.Array
    touching: jax.Array


def landed(
    box: Box,
    then: Box,
    moving: jax.Array,
    inertia: jax.Array,
    heights: jax.Array,
    friction: jax.Array,
    step: float,
) -> Landed:
    """Where parts of legs are, of n walkers; shapes (..., parts, n), see `Landed`.

    Args:
        box: where each was.
        then: where it would be.
        moving: (3, parts, n) its speeds.
        inertia: (3, parts, n) mass [kg], again, and moment [kg m^2].
        heights: of the ground.
        friction: between the two.
        step: its length [s].
    """
    first, ends = below(box, heights, then)
    way, turn = then.centre - box.centre, then.angle - box.angle
    pieces: Box = jax.tree.map(lambda x: jnp.expand_dims(x, -2), box)

    def on_the_way(share: jax.Array, way: jax.Array, turn: jax.Array, box: Box) -> Box:
        return Box(box.centre + share * way, box.angle + share * turn, box.width)

    own = way[:, :, None], turn[:, None], pieces
    share, hit = _arrival(lambda share: apart(on_the_way(share, *own), ends))  # (parts, m, n)
    share = jnp.where(hit, share, 1.0).min(axis=-2)
    there = on_the_way(share, way, turn, box)
    touches = touch(jax.tree.map(lambda x: jnp.expand_dims(x, -2), there), ends)
    (points,) = deepest(touches, 1)
    hit = hit.any(axis=-2) & points.valid.any(axis=0)
    arms = across(points.points - there.centre[:, None])  # (2, ends, parts, n)

    def row(directions: jax.Array) -> Rows:
        rows = jnp.stack([*directions, dot(arms, directions)], axis=1)
        effect = rows / inertia
        size = dot(jnp.swapaxes(rows, 0, 1), jnp.swapaxes(effect, 0, 1))
        valid = points.valid
        return Rows(rows, effect, jnp.where(valid, 1.0 / jnp.where(valid, size, 1.0), 0.0))

    ground = Ground(row(-across(points.normals)), row(points.normals), friction)

    def lift(_: int, moved: jax.Array) -> jax.Array:
        further = ground.lift(moved, points.gaps, 0.75)
        return jnp.where(ground.overlap(moved, points.gaps) >= -1.5 * SLOP, moved, further)

    def push(_: int, carry: Any) -> Any:
        return ground.push(*carry)

    lifted = jax.lax.fori_loop(0, _LIFTS, lift, jnp.zeros_like(moving))
    speed, _ = jax.lax.fori_loop(0, _ROUNDS, push, (moving, ground.untouched()))
    left = step * (1.0 - share)
    end = there.centre + lifted[:2] + left * speed[:2], there.angle + lifted[2] + left * speed[2]
    return Landed(
        jnp.where(hit, end[0], then.centre),
        jnp.where(hit, end[1], then.angle),
        jnp.where(hit, speed, moving),
        hit,
        first,
        touches.valid.any(axis=0) & hit[:, None],  # (parts, m, n)
    )


def _arrival(far: Any) -> tuple[jax.Array, jax.Array]:
    """Share of the way at which `far` falls to `_STOP`, and whether it does; by false position."""
    at_low, at_high = jax.vmap(far)(jnp.array([0.0, 1.0]))
    low, high = jnp.zeros_like(at_low), jnp.ones_like(at_low)
    near = at_low < _STOP + _TOLERANCE
    hit = (at_low > 0.0) & (near | (at_high < _STOP))

    def look(_: int, found: Any) -> Any:
        share, low, high, at_low, at_high = found
        fall = jnp.maximum(at_low - at_high, 1e-9)
        share = jnp.clip(low + (at_low - _STOP) / fall * (high - low), low, high)
        now = far(share)
        before = now > _STOP
        low, at_low = jnp.where(before, share, low), jnp.where(before, now, at_low)
        high, at_high = jnp.where(before, high, share), jnp.where(before, at_high, now)
        return share, low, high, at_low, at_high

    share = jax.lax.fori_loop(0, _LOOKS, look, (low, low, high, at_low, at_high))[0]
    return jnp.where(near, 0.0, share), hit
