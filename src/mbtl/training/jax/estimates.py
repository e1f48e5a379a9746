"""Means over the rows that count."""

from __future__ import annotations

import jax
import jax.numpy as jnp


def mean_of(x: jax.Array, weight: jax.Array) -> jax.Array:
    """Mean of `x` weighted by `weight`; 0 without any."""
    return (x * weight).sum() / jnp.maximum(weight.sum(), 1.0)


def standard(x: jax.Array, weight: jax.Array) -> jax.Array:
    """Mean 0 and standard deviation 1 over the rows that count."""
    centred = x - mean_of(x, weight)
    return centred / (jnp.sqrt(mean_of(jnp.square(centred), weight)) + 1e-8)
