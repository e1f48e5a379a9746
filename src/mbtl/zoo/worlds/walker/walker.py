"""BipedalWalker as pure functions; environment and notation of `mbtl.zoo.cmdps.locomotion.walker`.

Box2D's world of five bodies, with two things done otherwise. Joints hold exactly, so seven numbers
move all (`body.py`). And what the first action does is looked up (`starts.py`). How near the two
are, page docs/locomotion.md says.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from mbtl.engine.worlds import environments, random
from mbtl.engine.worlds.environments import TimeLimit
from mbtl.engine.worlds.vectorised import batch_last

# ---- the ground of a walker: a line of pieces of equal length, and ranges to it --------------
#
# Notation: `heights` (200,) of the points between the pieces [m], STEP apart; drawn as in
# Gymnasium's BipedalWalker-v3.


NOMINAL_SCALE = 30.0
STEP = 14.0 / NOMINAL_SCALE
"""Length of a piece of ground [m]."""
POINTS = 200
FLAT = 20
"""Pieces of flat ground at the beginning; the walker starts in their middle."""
HEIGHT = 400.0 / NOMINAL_SCALE / 4.0
"""Of the ground [m], on average."""
END = (POINTS - 10) * STEP
"""Where an episode is won [m]."""
ROUGH, PATCHES = POINTS - FLAT - 1, (POINTS - FLAT) // 5 + 1
"""Numbers that slopes and the distances of level pieces take."""
REACH = 160.0 / NOMINAL_SCALE
"""Of the range finder [m]."""
RAYS = 10
_NEAR = math.ceil(REACH / STEP) + 2
"""Pieces of ground that a ray can meet."""
_TURNS = 1.5 * np.arange(RAYS) / RAYS
_AHEAD, _BELOW = np.float32(np.sin(_TURNS) * REACH), np.float32(np.cos(_TURNS) * REACH)


def heights(luck: jax.Array, scale: jax.Array) -> jax.Array:
    """(200,) heights [m]: a random walk that is drawn back, with level pieces.

    Args:
        luck: (ROUGH + PATCHES,) uniform numbers in [0, 1).
        scale: the larger, the smoother.
    """
    lengths = 5 + jnp.floor(5.0 * luck[ROUGH:]).astype(jnp.int32)
    places = FLAT + jnp.concatenate([jnp.zeros(1, jnp.int32), jnp.cumsum(lengths)])
    level = jnp.zeros(POINTS, bool).at[places].set(True, mode="drop")
    rough = (jnp.arange(POINTS) > FLAT) & ~level
    pushes = (2.0 * luck[:ROUGH] - 1.0) / scale
    pushes = jnp.where(rough, pushes[jnp.cumsum(rough) - 1], 0.0)

    def point(carry: tuple[Any, Any], own: tuple[Any, Any]) -> tuple[tuple[Any, Any], Any]:
        y, slope = carry
        level, push = own
        slope = jnp.where(level, slope, 0.8 * slope + 0.01 * jnp.sign(HEIGHT - y) + push)
        y = jnp.where(level, y, y + slope)
        return (y, slope), y

    first = jnp.float32(HEIGHT), jnp.float32(0.0)
    return jax.lax.scan(point, first, (level, pushes))[1]


def pieces(heights: jax.Array, first: jax.Array, count: int) -> jax.Array:
    """(count + 1, 2) points of `count` pieces from number `first` on [m]."""
    ys = jax.lax.dynamic_slice(heights, (first,), (count + 1,))
    xs = (first + jnp.arange(count + 1)).astype(jnp.float32) * STEP
    return jnp.stack([xs, ys], axis=-1)


def number(x: jax.Array, count: int) -> jax.Array:
    """Of the piece below x [m], but so that `count` of them are there."""
    return jnp.clip(jnp.floor(x / STEP), 0, POINTS - 1 - count).astype(jnp.int32)


def ranges(heights: jax.Array, place: jax.Array) -> jax.Array:
    """(10,) share of its reach that is free along each ray from `place`, (2,)."""
    points = pieces(heights, number(place[0] - STEP, _NEAR), _NEAR)
    start, extent = points[:-1], points[1:] - points[:-1]
    dx, dy = jnp.asarray(_AHEAD)[:, None], -jnp.asarray(_BELOW)[:, None]
    ex, ey = extent.T
    x, y = (start - place).T
    turn = dx * ey - dy * ex
    turn = jnp.where(turn == 0.0, 1e-12, turn)
    t, s = (x * ey - y * ex) / turn, (x * dy - y * dx) / turn
    hit = (t >= 0.0) & (t <= 1.0) & (s >= 0.0) & (s <= 1.0)
    return jnp.where(hit, t, 1.0).min(axis=-1)


# ---- a walker's body: a hull with two legs of two parts, moved by seven numbers --------------
#
# Joints hold exactly: what moves is the hull's centre of mass and the angles of all five parts.
#
# Notation (order): bodies hull, thigh, shin, thigh, shin; joints hip, knee, hip, knee. Vectors
# have x and y in the first axis. Shapes are of one walker; those of many come last, which is much
# faster.
#     u (7,)    forward and upward speed of the hull [m/s], then angular speeds of the bodies
#         [rad/s]
#     row (7,)  a direction of motion: how fast one thing moves is row . u


HULL = np.array([(-30.0, 9.0), (6.0, 9.0), (34.0, 1.0), (34.0, -8.0), (-30.0, -8.0)])
"""Corners at scale 1 [m]."""
LEG_HEIGHT = 34.0 / NOMINAL_SCALE
LEG_DOWN = -8.0 / NOMINAL_SCALE
"""Where the hips are on the hull [m]."""
WIDTHS = np.array([1.0, 0.8, 1.0, 0.8], np.float32) * np.float32(8.0 / NOMINAL_SCALE)
"""Of thigh, shin, thigh and shin [m]."""
_HALF = LEG_HEIGHT / 2.0


def _polygon(corners: np.ndarray) -> tuple[float, np.ndarray, float]:
    """Area, centre, and second moment about the centre, of a polygon."""
    a, b = corners, np.roll(corners, -1, axis=0)
    cross = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    area = cross.sum() / 2.0
    centre = ((a + b) * cross[:, None]).sum(axis=0) / (6.0 * area)
    about = (cross * ((a * a).sum(1) + (a * b).sum(1) + (b * b).sum(1))).sum() / 12.0
    return abs(area), centre, abs(about) - abs(area) * float(centre @ centre)


_AREA, _CENTRE, _MOMENT = _polygon(HULL)
_HULL_DENSITY = 5.0
_MASSES = WIDTHS * np.float32(LEG_HEIGHT)
_MOMENTS = _MASSES * (WIDTHS**2 + np.float32(LEG_HEIGHT) ** 2) / 12.0


class Body(NamedTuple):
    """Where the parts are, and how they answer to impulses.

    Attributes:
        origin: (2,) of the hull, from which the ranges are measured [m].
        centres: (2, 5) of mass [m].
        hip: (2,) where the legs hang [m].
        knees: (2, 2) of each leg [m].
        masses: (5,) [kg].
        moments: (5,) of inertia [kg m^2].
        inverse: (7, 7) what impulses do: u changes by inverse @ impulse.
    """

    origin: jax.Array
    centres: jax.Array
    hip: jax.Array
    knees: jax.Array
    masses: jax.Array
    moments: jax.Array
    inverse: jax.Array


def offset(scale: jax.Array) -> jax.Array:
    """(2,) from the hull's origin to its centre of mass, at angle 0 [m]."""
    return jnp.stack([np.float32(_CENTRE[0]) / scale, np.float32(_CENTRE[1]) / scale])


def sin_cos(angle: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Sine and cosine to float32's rounding, of many at once: a CPU's own are one at a time.

    Of the rest after quarter turns, by the polynomials of Cephes; angles below some 10,000 rad.
    """
    quarters = jnp.round(angle * np.float32(2.0 / np.pi))
    rest = angle
    for part in (1.5703125, 4.837512969970703e-4, 7.54978995489188e-8):  # pi / 2
        rest = rest - quarters * np.float32(part)
    z = rest * rest
    sin = rest + rest * z * (-1.6666654611e-1 + z * (8.3321608736e-3 - z * 1.9515295891e-4))
    cos = 4.166664568298827e-2 + z * (-1.388731625493765e-3 + z * 2.443315711809948e-5)
    cos = 1.0 - 0.5 * z + z * z * cos
    turns = quarters.astype(jnp.int32)
    odd, back, down = (turns & 1) == 1, (turns & 2) != 0, ((turns + 1) & 2) != 0
    one, other = jnp.where(odd, cos, sin), jnp.where(odd, sin, cos)
    return jnp.where(back, -one, one), jnp.where(down, -other, other)


def turned(angle: jax.Array, x: Any, y: Any) -> jax.Array:
    """(2, ...) the vector (x, y), turned."""
    return _turned(*sin_cos(angle), x, y)


def _turned(sin: jax.Array, cos: jax.Array, x: Any, y: Any) -> jax.Array:
    return jnp.stack([cos * x - sin * y, sin * x + cos * y])


def across(vector: jax.Array) -> jax.Array:
    """(2, ...) speed of its tip where it turns by 1 rad/s."""
    return jnp.stack([-vector[1], vector[0]])


def dot(a: Any, b: Any) -> jax.Array:
    """Inner product along the first axis, which is short."""
    products = [a[i] * b[i] for i in range(len(a))]
    return sum(products[1:], products[0])


def body(centre: jax.Array, angles: jax.Array, scale: jax.Array) -> Body:
    """The body in a pose.

    Args:
        centre: (2,) of the hull's mass [m].
        angles: (5,) of all parts [rad].
        scale: of the context.
    """
    cx, cy = offset(scale)
    sin, cos = sin_cos(angles)
    origin = centre - _turned(sin[0], cos[0], cx, cy)
    to_hip = _turned(sin[0], cos[0], -cx, LEG_DOWN - cy)
    hip = centre + to_hip
    down = _HALF * jnp.stack([sin[1:], -cos[1:]])  # (2, 4), of each part
    thighs, shins = down[:, 0::2], down[:, 1::2]
    knees = hip[:, None] + 2.0 * thighs
    legs = jnp.stack([hip[:, None] + thighs, knees + shins], axis=2)  # (2, legs, parts)
    centres = jnp.concatenate([centre[:, None], legs.reshape(2, 4, *scale.shape)], axis=1)
    size = jnp.ones_like(scale)
    masses = jnp.stack([_HULL_DENSITY * _AREA / scale**2, *(size * m for m in _MASSES)])
    moments = jnp.stack([_HULL_DENSITY * _MOMENT / scale**4, *(size * m for m in _MOMENTS)])
    inverse = _inverse(to_hip, thighs, shins, masses[0], moments[0])
    return Body(origin, centres, hip, knees, masses, moments, inverse)


def _inverse(
    to_hip: jax.Array, thighs: jax.Array, shins: jax.Array, mass: jax.Array, moment: jax.Array
) -> jax.Array:
    """(7, 7) inverse of the mass matrix: each leg is taken out first, then the hull is left.

    `mass` and `moment` are the hull's; what has two entries below is of a leg's thigh and shin.
    """
    thigh, shin = _MASSES[:2]
    half = np.float32(_HALF) ** 2
    tt = _MOMENTS[0] + (thigh + 4.0 * shin) * half
    ss = _MOMENTS[1] + shin * half
    ts = 2.0 * shin * dot(thighs, shins)  # (legs,)
    det = tt * ss - ts * ts
    leg = ((ss / det, -ts / det), (-ts / det, tt / det))
    # how each leg's two speeds pull on the hull's three
    turn = across(to_hip)
    pull = []
    for part in ((thigh + 2.0 * shin) * across(thighs), shin * across(shins)):
        pull.append((part[0], part[1], dot(part, turn[:, None])))
    back = [[leg[i][0] * pull[0][k] + leg[i][1] * pull[1][k] for k in range(3)] for i in range(2)]

    weight = 2.0 * (thigh + shin)
    total, none = mass + weight, jnp.zeros_like(mass)
    x, y = weight * turn
    hull = [[total, none, x], [none, total, y], [x, y, moment + weight * dot(to_hip, to_hip)]]
    for i, j in ((i, j) for i in range(3) for j in range(3)):
        taken = pull[0][i] * back[0][j] + pull[1][i] * back[1][j]
        hull[i][j] = hull[i][j] - (taken[0] + taken[1])
    left = _inverse_of_three(hull)
    out = [[-dot(row, [m[k] for m in left]) for k in range(3)] for row in back]  # (legs,) each
    rows = [[*left[k], *(out[i][k][j] for j in range(2) for i in range(2))] for k in range(3)]
    for here, i in ((here, i) for here in range(2) for i in range(2)):
        own = [out[i][k][here] for k in range(3)]
        cross = [-dot(own, [b[there] for b in back[j]]) for there in range(2) for j in range(2)]
        for j in range(2):
            cross[2 * here + j] = cross[2 * here + j] + leg[i][j][here]
        rows.append([*own, *cross])
    return jnp.stack([jnp.stack(row) for row in rows])


def _inverse_of_three(m: Any) -> Any:
    """(3, 3), symmetric."""
    (a, b, c), (_, d, e), (_, _, f) = m
    A, B, C = d * f - e * e, c * e - b * f, b * e - c * d
    D, E, F = a * f - c * c, b * c - a * e, a * d - b * b
    det = a * A + b * B + c * C
    return [[x / det for x in row] for row in ((A, B, C), (B, D, E), (C, E, F))]


def momentum(now: Body, moving: jax.Array) -> jax.Array:
    """(7,) generalised momentum of bodies that move each for itself.

    Args:
        now: the body.
        moving: (5, 3) speeds of the centres, and angular speeds.
    """
    linear = now.masses * jnp.stack([moving[:, 0], moving[:, 1]])  # (2, 5)
    turning = now.moments * moving[:, 2]
    legs = linear[:, 1] + linear[:, 2] + linear[:, 3] + linear[:, 4]
    parts = [*(linear[:, 0] + legs), turning[0] + dot(across(now.hip - now.centres[:, 0]), legs)]
    for i, (t, s) in enumerate(((1, 2), (3, 4))):
        thigh = across(now.centres[:, t] - now.hip)
        shin = across(now.centres[:, s] - now.knees[:, i])
        parts.append(turning[t] + dot(thigh, linear[:, t] + 2.0 * linear[:, s]))
        parts.append(turning[s] + dot(shin, linear[:, s]))
    return jnp.stack(parts)


def speeds(now: Body, u: jax.Array) -> jax.Array:
    """(5, 3) speeds of the centres, and angular speeds, when the joints hold."""
    hip = u[:2] + u[2] * across(now.hip - now.centres[:, 0])
    found = [u[:2]]
    for i, (t, s) in enumerate(((1, 2), (3, 4))):
        thigh = u[2 + t] * across(now.centres[:, t] - now.hip)
        shin = u[2 + s] * across(now.centres[:, s] - now.knees[:, i])
        found += [hip + thigh, hip + 2.0 * thigh + shin]
    return jnp.stack([jnp.stack([*each, u[2 + i]]) for i, each in enumerate(found)])


# ---- where a part of a leg, a box, meets a piece of ground, a line: Box2D's rules ------------
#
# Either the line or a side of the box separates the two best. What lies along the other is cut to
# that one's length; of its two ends, those that are near enough touch.
#
# Notation: m pieces below a part. Shapes are of one part and piece, see `body`; of many, the axes
# of parts and pieces come after those that are named, and those of walkers last.


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
    first = number(jnp.minimum(left[0], left[-1]) - SKIN, PIECES)
    at = first + np.arange(PIECES + 1)[:, None, None]  # (m + 1, parts, n)
    points = jnp.stack([at.astype(jnp.float32) * STEP, heights[at, np.arange(at.shape[-1])]])
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


# ---- a part of a leg that comes down on the ground within a step -----------------------------
#
# As in Box2D it is stopped where it arrives, as if it hung on nothing, and goes on from there with
# the rest of the step; the joints pull it back in the next one. Without this a foot would be a few
# centimetres in the ground before it is felt.


_STOP, _TOLERANCE = 0.005, 0.00125
"""A part is stopped at this distance, within the tolerance [m]."""
_LOOKS, _HULL_LIFTS, _ROUNDS = 3, 2, 8


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

    lifted = jax.lax.fori_loop(0, _HULL_LIFTS, lift, jnp.zeros_like(moving))
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


# What motors, limits of joints and the ground do in a step: impulses, found one after another
#
# Box2D's equations and its order. As joints hold exactly here, and only they make it slow to
# converge, a sixth of Box2D's 180 rounds is enough.
#
# Notation: d numbers move a thing; r rows, each a direction in which something moves, as fast as
# row . u. Shapes are of one walker; those of many come last, see `body`.


ROUNDS = 30
SLOP, FURTHEST = 0.005, 0.2
"""Overlap that nobody mends, and the most that is mended at once [m]."""


class Rows(NamedTuple):
    """Directions of impulses.

    Attributes:
        row: (r, d).
        effect: (r, d) what an impulse of 1 does to u.
        ease: (r,) how large an impulse stops a motion of 1; 0 where there is none.
    """

    row: jax.Array
    effect: jax.Array
    ease: jax.Array

    @classmethod
    def of(cls, row: jax.Array, inverse: jax.Array, valid: jax.Array | bool = True) -> Rows:
        """Rows of a thing with a mass matrix whose inverse is (d, d)."""
        effect = dot([row[:, i, None] for i in range(len(inverse))], inverse)
        size = dot(jnp.swapaxes(row, 0, 1), jnp.swapaxes(effect, 0, 1))
        return cls(row, effect, jnp.where(valid, 1.0 / jnp.where(valid, size, 1.0), 0.0))

    def along(self, number: int, u: jax.Array) -> jax.Array:
        """How fast the thing moves along one of them; in a round, where each sum is one kernel."""
        return (self.row[number] * u).sum(axis=0)


class Ground(NamedTuple):
    """Points at which something touches the ground, (c,) rows along it and away from it."""

    along: Rows
    away: Rows
    friction: jax.Array

    def push(self, u: jax.Array, pushed: Any) -> tuple[jax.Array, Any]:
        """One round: friction, at most in proportion to the pressure, then pressure."""
        along, away, after = self.along, self.away, []
        for i, (rubbed, pressed) in enumerate(pushed):
            most = self.friction * pressed
            rub = jnp.clip(rubbed - along.along(i, u) * along.ease[i], -most, most)
            u = u + along.effect[i] * (rub - rubbed)
            press = jnp.maximum(pressed - away.along(i, u) * away.ease[i], 0.0)
            u = u + away.effect[i] * (press - pressed)
            after.append((rub, press))
        return u, after

    def untouched(self) -> Any:
        """Impulses before the first round."""
        none = jnp.zeros_like(self.away.ease[0])
        return [(none, none)] * len(self.away.ease)

    def lift(self, moved: jax.Array, gaps: jax.Array, share: float) -> jax.Array:
        """One round of moving things out of the ground, `share` of the overlap at a time."""
        away = self.away
        for i in range(len(gaps)):
            wrong = share * (gaps[i] + dot(away.row[i], moved) + SLOP)
            moved = moved - away.effect[i] * (jnp.clip(wrong, -FURTHEST, 0.0) * away.ease[i])
        return moved

    def overlap(self, moved: jax.Array, gaps: jax.Array) -> jax.Array:
        """The deepest one that is left, <= 0 [m]."""
        left = gaps + dot(jnp.swapaxes(self.away.row, 0, 1), moved[:, None])
        return jnp.where(self.away.ease > 0.0, left, 0.0).min(axis=0)


class Joints(NamedTuple):
    """Four joints with motors and limits.

    Attributes:
        motors: rows that turn the joints.
        wanted: (4,) speeds [rad/s].
        strongest: (4,) impulses [N m s].
        limits: rows that turn joints away from the limit that they are at.
    """

    motors: Rows
    wanted: jax.Array
    strongest: jax.Array
    limits: Rows

    def push(self, u: jax.Array, pushed: Any) -> tuple[jax.Array, Any]:
        """One round: motors, as strong as they may be, then limits."""
        driven, held = [], []
        for i, before in enumerate(pushed[0]):
            short = (self.wanted[i] - self.motors.along(i, u)) * self.motors.ease[i]
            most = self.strongest[i]
            driven.append(jnp.clip(before + short, -most, most))
            u = u + self.motors.effect[i] * (driven[-1] - before)
        for i, before in enumerate(pushed[1]):
            back = self.limits.along(i, u) * self.limits.ease[i]
            held.append(jnp.maximum(before - back, 0.0))
            u = u + self.limits.effect[i] * (held[-1] - before)
        return u, (driven, held)

    def still(self) -> Any:
        """Impulses before the first round."""
        none = [jnp.zeros_like(self.wanted[0])] * len(self.wanted)
        return none, none


def settled(u: jax.Array, joints: Joints, ground: Ground, rounds: int = ROUNDS) -> jax.Array:
    """(7,) speeds after all impulses of a step."""

    def one(_: int, carry: Any) -> Any:
        u, turned, pressed = carry
        u, turned = joints.push(u, turned)
        u, pressed = ground.push(u, pressed)
        return u, turned, pressed

    start = u, joints.still(), ground.untouched()
    settled: jax.Array = jax.lax.fori_loop(0, rounds, one, start)[0]
    return settled


# One step of a walker's world: impulses, then places, then what comes down within the step


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
    """What a context changes, as `mbtl.zoo.cmdps.locomotion.walker.derive` orders it; scalars."""

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


# ---- how an episode begins: the first two steps of Box2D's walkers, which are looked up ------
#
# Their legs are put half a metre too high and pushed out of the ground at once, which joints that
# hold exactly cannot do. In the first step, without torque, they get half of the way; what the
# first action does is mixed with the rest, and moves a knee by up to half a turn. So a walker in
# jax is first seen as Box2D's is after one step, and the state after its first action is looked up
# among those that Box2D's walkers had, with every combination of a few strengths of the four
# motors. A strength between two of these counts as either, by chance: a state between theirs is
# none of Box2D's. A policy that always began in the same state walked from there only, and fell in
# Box2D.
#
# Gravity and friction add what they change at the nominal scale. Notation (shapes): s values of one
# axis, L strengths of a motor.


FILE = Path(__file__).parent / "starts.npz"
"""`evidence/walker_twin.py --write` wrote it: per axis its values, (s,), and states
after the first action, (s, L**4, 24), of gravity and friction as differences; and per scale what is
seen before it, (s, 7)."""
AXES = ("gravity", "friction", "scale")
_MOTORS = 4
with np.load(FILE) as _file:
    _FOUND: dict[str, NDArray[np.float32]] = {k: _file[k].astype(np.float32) for k in _file.files}
_STRENGTHS = round(len(_FOUND["by_scale"][0]) ** (1.0 / _MOTORS))


class Start(NamedTuple):
    """A walker after its first action.

    Attributes:
        place: (2,) of the hull's origin: from the middle of the flat ground, and above it [m].
        angles: (5,) of the bodies [rad].
        moving: (5, 3) of the bodies: in the first step Box2D's joints do not hold all of it.
        feet: (2,) whether the shins are on the ground.
    """

    place: jax.Array
    angles: jax.Array
    moving: jax.Array
    feet: jax.Array


def made(scale: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Before it: (2,) place of the hull's origin, as in `Start`, and (5,) angles."""
    (low, high), share = _between("scale", scale)
    table = jnp.asarray(_FOUND["made"])
    numbers = table[low] + share * (table[high] - table[low])
    return numbers[:2], numbers[2:]


def after(
    action: jax.Array, luck: jax.Array, gravity: jax.Array, friction: jax.Array, scale: jax.Array
) -> Start:
    """The state after a first action, (4,) within -1..1; luck, (4,) within 0..1, rounds it."""
    at = (action + 1.0) / 2.0 * (_STRENGTHS - 1)
    nearby = jnp.clip(jnp.floor(at + luck), 0, _STRENGTHS - 1).astype(jnp.int32)
    row = nearby @ _STRENGTHS ** np.arange(_MOTORS)[::-1]
    numbers = jnp.zeros(24)
    for axis, value in zip(AXES, (gravity, friction, scale), strict=True):
        (low, high), share = _between(axis, value)
        table = jnp.asarray(_FOUND[f"by_{axis}"])
        numbers = numbers + (1.0 - share) * table[low, row] + share * table[high, row]
    return Start(numbers[:2], numbers[2:7], numbers[7:22].reshape(5, 3), numbers[22:] > 0.5)


def _between(axis: str, value: jax.Array) -> tuple[tuple[jax.Array, jax.Array], jax.Array]:
    """Rows of the two nearest values, and how near the second is, 0..1."""
    values = jnp.asarray(_FOUND[axis])
    high = jnp.clip(jnp.searchsorted(values, value), 1, len(_FOUND[axis]) - 1)
    share = (value - values[high - 1]) / (values[high] - values[high - 1])
    return (high - 1, high), jnp.clip(share, 0.0, 1.0)


# ---- the whole -------------------------------------------------------------------------------


TORQUE = 80.0
SPEEDS = np.array([4.0, 6.0, 4.0, 6.0], np.float32)
"""Of hips and knees [rad/s], at full speed."""
STANCE = (-0.2, 0.0, 0.2, 0.0)
"""An action with which it stands still: hips held apart. Without any torque it falls."""

_ACTION = environments.Box((-1.0,) * 4, (1.0,) * 4)
_PUSH = 5.0
"""Largest force on the hull in the first step [N]."""
_ANEW = np.int32(-1)
"""Instead of numbers of pieces of ground, this or less: no action has been taken. How much less is
the luck of the four motors."""
_LUCKS = np.float32(2.0**20)
_MIDDLE = np.array([STEP * FLAT / 2.0, HEIGHT], np.float32)
"""Of the flat ground at the beginning [m]."""
_HULL_PIECES = 11
"""Of ground below the hull; a larger hull lies on the ground from the start."""


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
        count = ROUGH + PATCHES + 1
        luck = random.uniform(seed, 0, jnp.uint32(0), count + 4)[:, 0]
        place, angles = made(params.scale)
        push = (-_PUSH + 2.0 * _PUSH * luck[count - 1]) / FPS
        pushed = push / body(jnp.zeros(2), angles, params.scale).masses[0]
        moving = jnp.zeros((5, 3)).at[0, :2].set(jnp.stack([pushed, -params.gravity / FPS]))
        return WalkerState(
            _MIDDLE + place + turned(angles[0], *offset(params.scale)),
            angles,
            moving,
            heights(luck[: count - 1], params.scale),
            _ANEW - (luck[count:] * _LUCKS).astype(jnp.int32),
            jnp.zeros((4, PIECES), bool),
            jnp.ones(2, bool),
        )

    def step(
        self, state: WalkerState, action: jax.Array, params: WalkerParams
    ) -> environments.Step:
        """One step of 1/50 s; actions beyond +-1 act as +-1."""
        strength = jnp.minimum(jnp.abs(action), 1.0)
        new = moved(state, jnp.sign(action) * SPEEDS, TORQUE * strength, params)
        small, later = state._replace(heights=()), new._replace(heights=())
        first = _or_begun(small, later, jnp.clip(action, -1.0, 1.0), params._replace(visible=()))
        new = first._replace(heights=new.heights)
        now, x = body_of(new, params), _origin(new, params)[0]
        fallen = _lies(now, new, params) | (x < 0.0)
        gain = _progress(new, params) - _progress(state, params)
        reward = jnp.where(fallen, -100.0, gain - 0.00035 * TORQUE * strength.sum())
        return environments.Step(new, reward, fallen | (x > END) | ~jnp.isfinite(x))

    def observe(self, state: WalkerState, params: WalkerParams) -> jax.Array:
        """Hull, joints, feet, ranges and the visible features, as Gymnasium orders them."""
        hull, turning = state.moving[0], state.moving[:, 2] @ JOINTS[:, 2:].T / SPEEDS
        view = 0.3 / FPS / params.scale
        bent = joint_angles(state.angles) - MADE + jnp.array([0.0, 1.0, 0.0, 1.0])
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
            ranges(state.heights, _origin(state, params)),
            params.visible,
        ]  # fmt: skip
        return jnp.concatenate(seen).astype(jnp.float32)


def _begun(
    state: WalkerState, later: WalkerState, action: jax.Array, params: WalkerParams
) -> WalkerState:
    """The state after a first action, whose walker was pushed before.

    What it touched is as in `later`: where it stood when the step began.
    """
    luck = (_ANEW - state.first) / _LUCKS
    start = after(action, luck, params.gravity, params.friction, params.scale)
    return later._replace(
        centre=_MIDDLE + start.place + turned(start.angles[0], *offset(params.scale)),
        angles=start.angles,
        moving=start.moving.at[0, 0].add(state.moving[0, 0]),
        feet=start.feet,
    )


@batch_last
def _or_begun(
    state: WalkerState, later: WalkerState, action: jax.Array, params: WalkerParams
) -> WalkerState:
    """What `later` says, or the state after a first action; looked up where anybody begins."""
    anew = (state.first[0] <= _ANEW) & jnp.isfinite(action).all(axis=0)  # (n,)

    def looked_up() -> WalkerState:
        begun = jax.vmap(_begun, -1, -1)(state, later, action, params)
        chosen: WalkerState = jax.tree.map(lambda a, b: jnp.where(anew, a, b), begun, later)
        return chosen

    found: WalkerState = jax.lax.cond(anew.any(), looked_up, lambda: later)
    return found


def _origin(state: WalkerState, params: WalkerParams) -> jax.Array:
    """(2,) of the hull [m]."""
    return state.centre - turned(state.angles[0], *offset(params.scale))


def _progress(state: WalkerState, params: WalkerParams) -> jax.Array:
    """What the way so far is worth."""
    x = _origin(state, params)[0]
    return 130.0 * x / params.scale - 5.0 * jnp.abs(state.angles[0])


def _lies(now: Body, state: WalkerState, params: WalkerParams) -> jax.Array:
    """Whether the hull touches the ground."""
    corners = jnp.asarray(HULL, jnp.float32) / params.scale
    at = now.origin + turned(state.angles[0], *corners.T).T  # (5, 2), clockwise
    piece = jnp.clip(jnp.floor(at[:, 0] / STEP), 0, POINTS - 2).astype(jnp.int32)
    left, right = state.heights[piece], state.heights[piece + 1]
    level = left + (right - left) * (at[:, 0] / STEP - piece)
    above = (at[:, 0] >= 0.0) & (at[:, 0] <= STEP * (POINTS - 1))
    corner = above & (at[:, 1] - level < SKIN)
    first = number(now.origin[0] - STEP * _HULL_PIECES / 2.0, _HULL_PIECES)
    points = pieces(state.heights, first, _HULL_PIECES)
    outward = across((jnp.roll(at, -1, axis=0) - at).T).T
    outward = outward / jnp.sqrt((outward * outward).sum(-1, keepdims=True))
    out = ((points[:, None] - at[None]) * outward[None]).sum(-1).max(-1)
    return corner.any() | (out < SKIN).any()
