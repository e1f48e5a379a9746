"""A walker's body: a hull with two legs of two parts, moved by seven numbers.

Joints hold exactly: what moves is the hull's centre of mass and the angles of all five parts.

Notation (order): bodies hull, thigh, shin, thigh, shin; joints hip, knee, hip, knee. Vectors have x
and y in the first axis. Shapes are of one walker; those of many come last, which is much faster.
    u (7,)    forward and upward speed of the hull [m/s], then angular speeds of the bodies [rad/s]
    row (7,)  a direction of motion: how fast one thing moves is row . u
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from mbtl.worlds.walker.ground import NOMINAL_SCALE

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
