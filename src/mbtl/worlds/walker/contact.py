"""Where a part of a leg, a box, meets a piece of ground, a line: Box2D's rules.

Either the line or a side of the box separates the two best. What lies along the other is cut to
that one's length; of its two ends, those that are near enough touch.

Notation: m pieces below a part, c points at which it may touch.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from mbtl.worlds.walker import ground
from mbtl.worlds.walker.body import LEG_HEIGHT, across, turned

SKIN = 0.02
"""Box2D's shapes touch when they are so near; both have a skin of half of it [m]."""
PIECES = 4
"""Of ground that a part can lie on."""


class Box(NamedTuple):
    """A part of a leg.

    Attributes:
        centre: (2,) [m].
        angle: [rad].
        width: LEG_HEIGHT high [m].
    """

    centre: jax.Array
    angle: jax.Array
    width: jax.Array


class Touch(NamedTuple):
    """Points at which a part touches the ground, or could.

    Attributes:
        points: (..., c, 2) [m].
        normals: (..., c, 2) away from the ground.
        gaps: (..., c) between the skins [m], negative where they overlap.
        valid: (..., c) whether there is such a point.
    """

    points: jax.Array
    normals: jax.Array
    gaps: jax.Array
    valid: jax.Array


def below(box: Box, heights: jax.Array, moved: Box | None = None) -> tuple[jax.Array, jax.Array]:
    """Number of the first of PIECES pieces below a box, or on its way, and (m, 2, 2) their ends."""
    boxes = [box] if moved is None else [box, moved]
    left = [
        one.centre[0]
        - jnp.abs(jnp.cos(one.angle)) * one.width / 2.0
        - jnp.abs(jnp.sin(one.angle)) * LEG_HEIGHT / 2.0
        for one in boxes
    ]
    first = ground.number(jnp.stack(left).min() - SKIN, PIECES)
    points = ground.pieces(heights, first, PIECES)
    return first, jnp.stack([points[:-1], points[1:]], axis=1)


def apart(box: Box, ends: jax.Array) -> jax.Array:
    """How far a box and a piece, (2, 2) its ends, are apart without their skins [m]."""
    return _Sides.of(box, ends).apart


def touch(box: Box, ends: jax.Array) -> Touch:
    """Two points between a box and a piece, (2, 2) its ends from left to right."""
    own = _Sides.of(box, ends)
    by_side = own.by_axis.max()
    of_side = by_side > 0.98 * own.by_line + 0.001  # Box2D's preference for the line

    # ends of the box's side that faces the piece, cut to the piece
    lowest = jnp.argmax(jnp.abs(own.lean))
    outward = -jnp.sign(own.lean[lowest]) * own.axes[lowest]
    face = own.middle + outward * own.half[lowest]
    reach = across(outward) * own.half[1 - lowest]
    a, b = face - reach, face + reach
    cut = _cut((a * own.ahead).sum(), (b * own.ahead).sum(), jnp.float32(0.0), own.length)
    on_line = a + cut[:, None] * (b - a)  # (2, 2), seen from the piece's first end
    line_gaps = (on_line * own.up).sum(-1)

    # ends of the piece, cut to the box's side that is nearest to it
    axis = jnp.argmax(own.by_axis)
    outward = own.towards[axis] * own.axes[axis]
    edge, reach = across(outward), own.half[1 - axis]
    low, high = -(own.middle * edge).sum(), ((own.extent - own.middle) * edge).sum()
    side_cut = _cut(low, high, -reach, reach)
    on_side = side_cut[:, None] * own.extent
    side_gaps = ((on_side - own.middle) * outward).sum(-1) - own.half[axis]

    normal = jnp.where(of_side, -outward, own.up)
    gaps = jnp.where(of_side, side_gaps, line_gaps)
    cut = jnp.where(of_side, side_cut, cut)
    # halfway between the skins
    found = jnp.where(of_side, on_side, on_line) + ends[0]
    half_way = jnp.where(of_side, 0.5, -0.5) * gaps[:, None] * normal
    near = (own.by_line <= SKIN) & (by_side <= SKIN) & (cut[0] <= cut[1]) & (gaps <= SKIN)
    normals = jnp.broadcast_to(normal, (2, 2))
    return Touch(found + half_way, normals, gaps - SKIN, near)


def deepest(touches: Touch, count: int) -> Touch:
    """The points of the `count` pieces, of (m,), that overlap most; (2 count,) points."""
    depth = jnp.where(touches.valid, touches.gaps, jnp.inf).min(-1)
    chosen = []
    for _ in range(count):
        here = jnp.arange(len(depth)) == jnp.argmin(depth)
        chosen.append(jax.tree.map(lambda x, here=here: _at(x, here), touches))
        depth = jnp.where(here, jnp.inf, depth)
    return joined(chosen)


def joined(touches: list[Touch]) -> Touch:
    """All points of several."""
    joint: Touch = jax.tree.map(lambda *x: jnp.concatenate(x), *touches)
    return joint


class _Sides(NamedTuple):
    """How a box lies to a piece.

    Attributes:
        half: (2,) width and height of the box [m].
        axes: (2, 2) their directions.
        extent: (2,) of the piece [m].
        length: of the piece [m].
        ahead: (2,) along the piece.
        up: (2,) away from it.
        middle: (2,) of the box, seen from the piece's first end [m].
        lean: (2,) of the box's axes along `up`.
        towards: (2,) sign of the axis whose side is nearer to the piece.
        by_line: how far the box is above the piece's line [m].
        by_axis: (2,) how far the piece is beyond the box's sides [m].
    """

    half: Any
    axes: Any
    extent: Any
    length: Any
    ahead: Any
    up: Any
    middle: Any
    lean: Any
    towards: Any
    by_line: Any
    by_axis: Any

    @classmethod
    def of(cls, box: Box, ends: jax.Array) -> _Sides:
        half = jnp.stack([box.width / 2.0, jnp.float32(LEG_HEIGHT / 2.0)])
        along = turned(box.angle, jnp.float32(1.0), jnp.float32(0.0))
        axes = jnp.stack([along, across(along)])
        extent = ends[1] - ends[0]
        length = jnp.sqrt((extent * extent).sum())
        ahead = extent / length
        up = across(ahead)
        middle = box.centre - ends[0]
        lean = (axes * up).sum(-1)
        by_line = (middle * up).sum() - (half * jnp.abs(lean)).sum()
        first, second = -(axes * middle).sum(-1), (axes * (extent - middle)).sum(-1)
        plus, minus = jnp.minimum(first, second), jnp.minimum(-first, -second)
        towards = jnp.where(plus >= minus, 1.0, -1.0)
        by_axis = jnp.maximum(plus, minus) - half
        return cls(
            half, axes, extent, length, ahead, up, middle, lean, towards, by_line, by_axis
        )  # fmt: skip

    @property
    def apart(self) -> jax.Array:
        return jnp.maximum(self.by_line, self.by_axis.max())


def _cut(a: jax.Array, b: jax.Array, low: jax.Array, high: jax.Array) -> jax.Array:
    """(2,) shares of the way from a to b between which it is within low and high."""
    way = jnp.where(jnp.abs(b - a) < 1e-9, 1e-9, b - a)
    one, other = (low - a) / way, (high - a) / way
    first, last = jnp.minimum(one, other), jnp.maximum(one, other)
    return jnp.stack([jnp.maximum(first, 0.0), jnp.minimum(last, 1.0)])


def _at(x: jax.Array, here: jax.Array) -> jax.Array:
    """The entry of `x` where `here`, (m,), is true."""
    chosen = jnp.where(here.reshape(-1, *[1] * (x.ndim - 1)), x, jnp.zeros_like(x))
    return chosen.any(0) if x.dtype == bool else chosen.sum(0)
