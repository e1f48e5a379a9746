"""Sums along time, and means over the rows that count: what learners share."""

from __future__ import annotations

import jax
import jax.numpy as jnp


def summed_back(x: jax.Array, decay: jax.Array) -> jax.Array:
    """(T, ...) y_t = x_t + decay_t y_(t+1), as generalised advantages are of temporal differences.

    delta_t = r_t + gamma V(after) (1 - terminated) - V(obs)
    A_t     = delta_t + gamma lambda (1 - done) A_(t+1)
    """

    def back(later: jax.Array, now: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        total = now[0] + now[1] * later
        return total, total

    _, totals = jax.lax.scan(back, jnp.zeros_like(x[0]), (x, decay), reverse=True, unroll=8)
    return totals


def mean_of(x: jax.Array, weight: jax.Array) -> jax.Array:
    """Mean of `x` weighted by `weight`; 0 without any."""
    return (x * weight).sum() / jnp.maximum(weight.sum(), 1.0)


def standard(x: jax.Array, weight: jax.Array) -> jax.Array:
    """Mean 0 and standard deviation 1 over the rows that count."""
    centred = x - mean_of(x, weight)
    return centred / (jnp.sqrt(mean_of(jnp.square(centred), weight)) + 1e-8)
