"""A walker's body: a hull with two legs of two parts, moved by seven numbers.

Joints hold exactly: what moves is the hull's centre of mass and the angles of all five parts.

Notation (order): bodies hull, thigh, shin, thigh, shin; joints hip, knee, hip, knee.
    u (7,)    forward and upward speed of the hull [m/s], then angular speeds of the bodies [rad/s]
    row (7,)  a direction of motion: how fast one thing moves is row . u
"""

from __future__ import annotations

from typing import NamedTuple

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
        centres: (5, 2) of mass [m].
        hip: (2,) where the legs hang [m].
        knees: (2, 2) [m].
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
    return jnp.asarray(_CENTRE, jnp.float32) / scale


def turned(angle: jax.Array, x: jax.Array, y: jax.Array) -> jax.Array:
    """(..., 2) the vector (x, y), turned."""
    sin, cos = jnp.sin(angle), jnp.cos(angle)
    return jnp.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)


def across(vector: jax.Array) -> jax.Array:
    """(..., 2) speed of its tip where it turns by 1 rad/s."""
    return jnp.stack([-vector[..., 1], vector[..., 0]], axis=-1)


def body(centre: jax.Array, angles: jax.Array, scale: jax.Array) -> Body:
    """The body in a pose.

    Args:
        centre: (2,) of the hull's mass [m].
        angles: (5,) of all parts [rad].
        scale: of the context.
    """
    cx, cy = offset(scale)
    origin = centre - turned(angles[0], cx, cy)
    to_hip = turned(angles[0], -cx, LEG_DOWN - cy)
    hip = centre + to_hip
    down = turned(angles[1:], jnp.float32(0.0), jnp.float32(-_HALF))  # (4, 2), half of each part
    thighs, shins = down[0::2], down[1::2]
    knees = hip + 2.0 * thighs
    centres = jnp.stack(
        [centre, hip + thighs[0], knees[0] + shins[0], hip + thighs[1], knees[1] + shins[1]]
    )
    masses = jnp.concatenate([_HULL_DENSITY * _AREA / scale[None] ** 2, jnp.asarray(_MASSES)])
    moments = jnp.concatenate([_HULL_DENSITY * _MOMENT / scale[None] ** 4, jnp.asarray(_MOMENTS)])
    return Body(
        origin,
        centres,
        hip,
        knees,
        masses,
        moments,
        _inverse(to_hip, thighs, shins, masses, moments),
    )


def _inverse(
    to_hip: jax.Array, thighs: jax.Array, shins: jax.Array, masses: jax.Array, moments: jax.Array
) -> jax.Array:
    """(7, 7) inverse of the mass matrix: each leg is taken out first, then the hull is left."""
    thigh, shin = masses[1], masses[2]
    half = jnp.float32(_HALF) ** 2
    tt = moments[1] + (thigh + 4.0 * shin) * half
    ss = moments[2] + shin * half
    ts = 2.0 * shin * (thighs * shins).sum(-1)  # (2,)
    det = tt * ss - ts * ts
    leg = jnp.stack(
        [jnp.stack([ss / det, -ts / det], -1), jnp.stack([-ts / det, tt / det], -1)], -2
    )  # (2, 2, 2)
    # how each leg's two speeds pull on the hull's three, (2 legs, 3, 2)
    pull_t, pull_s = (thigh + 2.0 * shin) * across(thighs), shin * across(shins)
    turn = across(to_hip)
    pull = jnp.stack(
        [
            jnp.concatenate([pull_t, (pull_t * turn).sum(-1, keepdims=True)], -1),
            jnp.concatenate([pull_s, (pull_s * turn).sum(-1, keepdims=True)], -1),
        ],
        -1,
    )
    legs = 2.0 * (thigh + shin)
    total = masses[0] + legs
    hull = jnp.stack(
        [
            jnp.stack([total, jnp.float32(0.0), legs * turn[0]]),
            jnp.stack([jnp.float32(0.0), total, legs * turn[1]]),
            jnp.stack(
                [legs * turn[0], legs * turn[1], moments[0] + legs * (to_hip * to_hip).sum()]
            ),
        ]
    )
    back = _times(leg, jnp.swapaxes(pull, -1, -2))  # (2, 2, 3)
    left = _inverse_of_three(hull - _times(pull, back).sum(0))
    legs_hull = -_times(back, left[None])  # (2, 2, 3)
    rows = [jnp.concatenate([left, legs_hull[0].T, legs_hull[1].T], 1)]
    for i in range(2):
        cross = [-_times(legs_hull[i], back[j].T) for j in range(2)]
        cross[i] = cross[i] + leg[i]
        rows.append(jnp.concatenate([legs_hull[i], *cross], 1))
    return jnp.concatenate(rows, 0)


def _times(a: jax.Array, b: jax.Array) -> jax.Array:
    """Product of small matrices, as sums that are computed for many walkers at once."""
    return (a[..., :, :, None] * b[..., None, :, :]).sum(-2)


def _inverse_of_three(m: jax.Array) -> jax.Array:
    """(3, 3), symmetric."""
    (a, b, c), (_, d, e), (_, _, f) = m
    A, B, C = d * f - e * e, c * e - b * f, b * e - c * d
    D, E, F = a * f - c * c, b * c - a * e, a * d - b * b
    det = a * A + b * B + c * C
    return jnp.stack([jnp.stack([A, B, C]), jnp.stack([B, D, E]), jnp.stack([C, E, F])]) / det


def momentum(now: Body, moving: jax.Array) -> jax.Array:
    """(7,) generalised momentum of bodies that move each for itself.

    Args:
        now: the body.
        moving: (5, 3) speeds of the centres, and angular speeds.
    """
    linear = now.masses[:, None] * moving[:, :2]
    turning = now.moments * moving[:, 2]
    legs = linear[1:].sum(0)
    parts = [linear[0] + legs, (turning[0] + (across(now.hip - now.centres[0]) * legs).sum())[None]]
    for i, (t, s) in enumerate(((1, 2), (3, 4))):
        thigh = across(now.centres[t] - now.hip)
        shin = across(now.centres[s] - now.knees[i])
        parts.append(
            jnp.stack(
                [
                    turning[t] + (thigh * (linear[t] + 2.0 * linear[s])).sum(),
                    turning[s] + (shin * linear[s]).sum(),
                ]
            )
        )
    return jnp.concatenate(parts)


def speeds(now: Body, u: jax.Array) -> jax.Array:
    """(5, 3) speeds of the centres, and angular speeds, when the joints hold."""
    hip = u[:2] + u[2] * across(now.hip - now.centres[0])
    found = [u[:2]]
    for i, (t, s) in enumerate(((1, 2), (3, 4))):
        thigh = across(now.centres[t] - now.hip)
        found += [
            hip + u[2 + t] * thigh,
            hip + 2.0 * u[2 + t] * thigh + u[2 + s] * across(now.centres[s] - now.knees[i]),
        ]
    return jnp.concatenate([jnp.stack(found), u[2:, None]], 1)
