"""A part of a leg that comes down on the ground within a step.

As in Box2D it is stopped where it arrives, as if it hung on nothing, and goes on from there with
the rest of the step; the joints pull it back in the next one. Without this a foot would be a few
centimetres in the ground before it is felt.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from mbtl.worlds.walker.body import across
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
    centre: jax.Array,
    angle: jax.Array,
    moving: jax.Array,
    inertia: tuple[jax.Array, jax.Array],
    heights: jax.Array,
    friction: jax.Array,
    step: float,
) -> Landed:
    """Where a part is that would be at (centre, angle).

    Args:
        box: where it was.
        centre: (2,) [m].
        angle: [rad].
        moving: (3,) its speeds.
        inertia: mass [kg] and moment [kg m^2].
        heights: of the ground.
        friction: between the two.
        step: its length [s].
    """
    first, ends = below(box, heights, Box(centre, angle, box.width))

    def on_the_way(share: jax.Array) -> Box:
        return Box(
            box.centre + share * (centre - box.centre),
            box.angle + share * (angle - box.angle),
            box.width,
        )

    share, hit = jax.vmap(lambda piece: _arrival(lambda s: apart(on_the_way(s), piece)))(ends)
    share = jnp.where(hit, share, 1.0).min()
    there = on_the_way(share)
    touches = jax.vmap(touch, (None, 0))(there, ends)
    points = deepest(touches, 1)
    hit = hit.any() & points.valid.any()

    mass, moment = inertia
    inverse = jnp.diag(1.0 / jnp.stack([mass, mass, moment]))
    along, away = -across(points.normals), points.normals
    arms = across(points.points - there.centre)

    def row(way: jax.Array) -> Rows:
        turn = (arms * way).sum(-1, keepdims=True)
        return Rows.of(jnp.concatenate([way, turn], axis=1), inverse, points.valid)

    ground = Ground(row(along), row(away), friction)

    def lift(_: int, moved: jax.Array) -> jax.Array:
        further = ground.lift(moved, points.gaps, 0.75)
        return jnp.where(ground.overlap(moved, points.gaps) >= -1.5 * SLOP, moved, further)

    def push(_: int, carry: Any) -> Any:
        return ground.push(*carry)

    lifted = jax.lax.fori_loop(0, _LIFTS, lift, jnp.zeros(3))
    speed, _ = jax.lax.fori_loop(0, _ROUNDS, push, (moving, ground.untouched()))
    left = step * (1.0 - share)
    end = there.centre + lifted[:2] + left * speed[:2], there.angle + lifted[2] + left * speed[2]
    return Landed(
        jnp.where(hit, end[0], centre),
        jnp.where(hit, end[1], angle),
        jnp.where(hit, speed, moving),
        hit,
        first,
        touches.valid.any(-1) & hit,
    )


def _arrival(far: Any) -> tuple[jax.Array, jax.Array]:
    """Share of the way at which `far` falls to `_STOP`, and whether it does; by false position."""
    low, high = jnp.float32(0.0), jnp.float32(1.0)
    at_low, at_high = far(low), far(high)
    near = at_low < _STOP + _TOLERANCE
    hit = (at_low > 0.0) & (near | (at_high < _STOP))
    share = low
    for _ in range(_LOOKS):
        fall = jnp.maximum(at_low - at_high, 1e-9)
        share = jnp.clip(low + (at_low - _STOP) / fall * (high - low), low, high)
        now = far(share)
        before = now > _STOP
        low, at_low = jnp.where(before, share, low), jnp.where(before, now, at_low)
        high, at_high = jnp.where(before, high, share), jnp.where(before, at_high, now)
    return jnp.where(near, 0.0, share), hit
