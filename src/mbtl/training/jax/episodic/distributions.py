"""Action distributions compared, and means over the rows that count."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from mbtl.worlds.environments import Box, Discrete


def kl(
    old: jax.Array,
    old_log_std: jax.Array,
    new: jax.Array,
    new_log_std: jax.Array,
    action: Discrete | Box,
) -> jax.Array:
    """(...) KL(old, new) of action distributions, from outputs (..., m) and log deviations (d,)."""
    if isinstance(action, Discrete):
        logs = jax.nn.log_softmax(old)
        return (jnp.exp(logs) * (logs - jax.nn.log_softmax(new))).sum(axis=-1)
    ratio = jnp.exp(2.0 * (old_log_std - new_log_std))
    apart = jnp.square((old - new) * jnp.exp(-new_log_std))
    return (new_log_std - old_log_std + 0.5 * (ratio + apart - 1.0)).sum(axis=-1)


def mean_of(x: jax.Array, weight: jax.Array) -> jax.Array:
    """Mean of `x` weighted by `weight`; 0 without any."""
    return (x * weight).sum() / jnp.maximum(weight.sum(), 1.0)


def standard(x: jax.Array, weight: jax.Array) -> jax.Array:
    """Mean 0 and standard deviation 1 over the rows that count."""
    centred = x - mean_of(x, weight)
    return centred / (jnp.sqrt(mean_of(jnp.square(centred), weight)) + 1e-8)
