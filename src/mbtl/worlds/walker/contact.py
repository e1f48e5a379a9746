"""Where a part of a leg, a box, meets a piece of ground, a line: Box2D's rules.

Either the line or a side of the box separates the two best. What lies along the other is cut to
that one's length; of its two ends, those that are near enough touch.

Notation: m pieces below a part. Shapes are of one part and piece, see `body`; of many, the axes of
parts and pieces come after those that are named, and those of walkers last.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from mbtl.worlds.walker import ground
from mbtl.worlds.walker.body import LEG_HEIGHT, across, dot, sin_cos, turned

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
        points: (2, 2) of either end [m].
        normals: (2, 2) away from the ground.
        gaps: (2,) between the skins [m], negative where they overlap.
        valid: (2,) whether there is such a point.
    """

    points: jax.Array
    normals: jax.Array
    gaps: jax.Array
    valid: jax.Array


Ends = tuple[jax.Array, jax.Array]
"""(2,) each, of a piece, from left to right [m]."""


def below(box: Box, heights: jax.Array, moved: Box | None = None) -> tuple[jax.Array, Ends]:
    """Number of the first of PIECES pieces below a box, or on its way, and (2, m) their ends.

    Of boxes (parts, n) of n walkers, and their ground, (200, n).
    """
    left = []
    for one in [box] if moved is None else [box, moved]:
        sin, cos = sin_cos(one.angle)
        reach = jnp.abs(cos) * one.width / 2.0 + jnp.abs(sin) * (LEG_HEIGHT / 2.0)
        left.append(one.centre[0] - reach)
    first = ground.number(jnp.minimum(left[0], left[-1]) - SKIN, PIECES)
    at = first + np.arange(PIECES + 1)[:, None, None]  # (m + 1, parts, n)
    points = jnp.stack([at.astype(jnp.float32) * ground.STEP, heights[at, np.arange(at.shape[-1])]])
    points = jnp.swapaxes(points, 1, 2)
    return first, (points[:, :, :-1], points[:, :, 1:])


def apart(box: Box, ends: Ends) -> jax.Array:
    """How far a box and a piece are apart without their skins [m]."""
    return _Sides.of(box, ends).apart


def touch(box: Box, ends: Ends) -> Touch:
    """Two points between a box and a piece."""
    own = _Sides.of(box, ends)
    by_side = jnp.maximum(*own.by_axis)
    of_side = by_side > 0.98 * own.by_line + 0.001  # Box2D's preference for the line

    # ends of the box's side that faces the piece, cut to the piece
    of_height = jnp.abs(own.lean[1]) > jnp.abs(own.lean[0])
    lean, half, other, axis = own.either(of_height, own.lean)
    outward = -jnp.sign(lean) * axis
    face = own.middle + outward * half
    reach = across(outward) * other
    a, b = face - reach, face + reach
    cut = _cut(dot(a, own.ahead), dot(b, own.ahead), jnp.zeros_like(half), own.length)
    on_line = [a + share * (b - a) for share in cut]  # seen from the piece's first end
    line_gaps = [dot(point, own.up) for point in on_line]

    # ends of the piece, cut to the box's side that is nearest to it
    of_height = own.by_axis[1] > own.by_axis[0]
    towards, half, other, axis = own.either(of_height, own.towards)
    outward = towards * axis
    edge = across(outward)
    low, high = -dot(own.middle, edge), dot(own.extent - own.middle, edge)
    side_cut = _cut(low, high, -other, other)
    on_side = [share * own.extent for share in side_cut]
    side_gaps = [dot(point - own.middle, outward) - half for point in on_side]

    normal = jnp.where(of_side, -outward, own.up)
    begins, stops = (jnp.where(of_side, s, c) for s, c in zip(side_cut, cut, strict=True))
    fits = (own.by_line <= SKIN) & (by_side <= SKIN) & (begins <= stops)
    points, gaps = [], []
    for end in range(2):
        gap = jnp.where(of_side, side_gaps[end], line_gaps[end])
        half_way = jnp.where(of_side, 0.5, -0.5) * gap * normal  # between the skins
        points.append(jnp.where(of_side, on_side[end], on_line[end]) + ends[0] + half_way)
        gaps.append(gap)
    gap = jnp.stack(gaps)
    return Touch(
        jnp.stack(points, axis=1),
        jnp.stack([normal, normal], axis=1),
        gap - SKIN,
        fits & (gap <= SKIN),
    )


def deepest(touches: Touch, count: int) -> list[Touch]:
    """Of the m pieces, (..., m, n), the `count` that overlap most, the deepest first, (..., n)."""
    pieces = range(touches.gaps.shape[-2])
    depth = jnp.where(touches.valid, touches.gaps, jnp.inf).min(axis=0)
    depths, chosen = [depth[..., m, :] for m in pieces], []
    for _ in range(count):
        least, at = depths[0], jnp.zeros(depths[0].shape, jnp.int32)
        for m in pieces[1:]:
            at = jnp.where(depths[m] < least, m, at)
            least = jnp.minimum(depths[m], least)
        chosen.append(jax.tree.map(lambda x, at=at: _at(x, at), touches))
        depths = [jnp.where(at == m, jnp.inf, depths[m]) for m in pieces]
    return chosen


class _Sides(NamedTuple):
    """How a box lies to a piece.

    Attributes:
        half: of width and height of the box [m].
        axes: their directions, (2,) each.
        extent: (2,) of the piece [m].
        length: of the piece [m].
        ahead: (2,) along the piece.
        up: (2,) away from it.
        middle: (2,) of the box, seen from the piece's first end [m].
        lean: of the box's axes along `up`.
        towards: sign of the axis whose side is nearer to the piece.
        by_line: how far the box is above the piece's line [m].
        by_axis: how far the piece is beyond the box's sides [m].
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
    def of(cls, box: Box, ends: Ends) -> _Sides:
        half = (box.width / 2.0, np.float32(LEG_HEIGHT / 2.0))
        along = turned(box.angle, 1.0, 0.0)
        axes = (along, across(along))
        extent = ends[1] - ends[0]
        length = jnp.sqrt(dot(extent, extent))
        ahead = extent / length
        up = across(ahead)
        middle = box.centre - ends[0]
        lean = [dot(axis, up) for axis in axes]
        by_line = dot(middle, up) - (half[0] * jnp.abs(lean[0]) + half[1] * jnp.abs(lean[1]))
        towards, by_axis = [], []
        for axis, own in zip(axes, half, strict=True):
            first, second = -dot(axis, middle), dot(axis, extent - middle)
            plus, minus = jnp.minimum(first, second), jnp.minimum(-first, -second)
            towards.append(jnp.where(plus >= minus, 1.0, -1.0))
            by_axis.append(jnp.maximum(plus, minus) - own)
        return cls(
            half, axes, extent, length, ahead, up, middle, lean, towards, by_line, by_axis
        )  # fmt: skip

    def either(self, of_height: jax.Array, values: Any) -> Any:
        """Of one of the axes: its value, half its side, half the other side, and its direction."""
        chosen = jnp.where(of_height, values[1], values[0])
        own = jnp.where(of_height, self.half[1], self.half[0])
        other = jnp.where(of_height, self.half[0], self.half[1])
        return chosen, own, other, jnp.where(of_height, self.axes[1], self.axes[0])

    @property
    def apart(self) -> jax.Array:
        return jnp.maximum(self.by_line, jnp.maximum(*self.by_axis))


def _cut(a: Any, b: Any, low: Any, high: Any) -> tuple[jax.Array, jax.Array]:
    """Shares of the way from a to b between which it is within low and high."""
    way = jnp.where(jnp.abs(b - a) < 1e-9, 1e-9, b - a)
    one, other = (low - a) / way, (high - a) / way
    return jnp.maximum(jnp.minimum(one, other), 0.0), jnp.minimum(jnp.maximum(one, other), 1.0)


def _at(x: jax.Array, at: jax.Array) -> jax.Array:
    """(..., n) of `x`, (..., m, n), that of the piece `at`."""
    chosen = x[..., 0, :]
    for m in range(1, x.shape[-2]):
        chosen = jnp.where(at == m, x[..., m, :], chosen)
    return chosen
