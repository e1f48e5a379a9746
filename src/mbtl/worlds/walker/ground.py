"""The ground of a walker: a line of pieces of equal length, and ranges to it.

Notation: `heights` (200,) of the points between the pieces [m], STEP apart; drawn as in
Gymnasium's BipedalWalker-v3.
"""

from __future__ import annotations

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

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
