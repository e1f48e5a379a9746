"""Learning in the units of what is seen: each number of an observation with mean 0 and deviation 1.

Weights always take observations as they are, so whoever plays, judges or saves a policy knows
nothing of this. To learn from a rollout the first layers are rewritten for its standardised
observations, and back afterwards; neither changes what a policy does.

    x W + b = ((x - m) / s) (s W) + (b + m W)
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

from mbtl.engine.learners.networks import Network

_CONSTANT = 1e-4
"""Deviation below which a number is taken as it is: what a policy sees of its only context."""


class Units(NamedTuple):
    """Zero and size of the unit of each number of an observation, (o,) both."""

    mean: jax.Array
    spread: jax.Array

    @classmethod
    def of(cls, obs: jax.Array) -> Units:
        """Of observations (..., o)."""
        flat = obs.reshape(-1, obs.shape[-1])
        mean, spread = flat.mean(axis=0), flat.std(axis=0)
        varies = spread > _CONSTANT
        return cls(jnp.where(varies, mean, 0.0), jnp.where(varies, spread, 1.0))

    def measured(self, obs: jax.Array) -> jax.Array:
        """Observations in these units."""
        return (obs - self.mean) / self.spread

    def entered(self, network: Network) -> Network:
        """The network that takes observations in these units."""
        (weight, bias), *others = network
        return ((self.spread[:, None] * weight, bias + self.mean @ weight), *others)

    def left(self, network: Network) -> Network:
        """The network that takes observations as they are."""
        (weight, bias), *others = network
        weight = weight / self.spread[:, None]
        return ((weight, bias - self.mean @ weight), *others)
