"""When an update happens: the same for every policy of a training, and never drawn from a seed."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

_ROOT = 0x6D62_746C  # of the clock's keys, the same in every training


class Clock(NamedTuple):
    """One tick per update.

    Attributes:
        number: updates done before this one.
        total: updates planned.
        key: random key, a function of `number` alone: what all policies draw from it they share,
            which is cheaper, and a policy still does not depend on its company.
    """

    number: jax.Array
    total: jax.Array
    key: jax.Array

    @property
    def progress(self) -> jax.Array:
        """Share of the training that is done, 0 <= progress < 1."""
        return self.number / self.total

    def rate(self, anneal: bool) -> jax.Array:
        """Share of the learning rate: it falls linearly to 0, or stays."""
        return 1.0 - self.progress if anneal else jnp.float32(1.0)


def clock_at(number: jax.Array, total: jax.Array) -> Clock:
    """The clock after `number` updates."""
    return Clock(number, total, jax.random.fold_in(jax.random.PRNGKey(_ROOT), number))
