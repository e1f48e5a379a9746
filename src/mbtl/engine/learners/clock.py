"""When an update happens: the same for every policy of a training, and never drawn from a seed."""

from __future__ import annotations

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp

_ROOT = 0x6D62_746C  # of the clock's keys, the same in every training
_NEVER = 1 << 30


class Pace(NamedTuple):
    """What the schedules of a training follow, in updates.

    Attributes:
        whole: exploration falls within a share of as many.
        begin: from here on the learning rate falls linearly,
        end: and is zero here.
        slowing: before, it is that of the recipe over sqrt(1 + updates / slowing).
        before: updates of the training that this one is tuned from: all of the above go on from
            them, but begin and end count from its own first update.
    """

    whole: int | jax.Array
    begin: int | jax.Array
    end: int | jax.Array
    slowing: float | jax.Array = math.inf
    before: int | jax.Array = 0

    @classmethod
    def endless(cls, whole: int, slowing: float = math.inf, before: int = 0) -> Pace:
        """The learning rate never falls to zero."""
        return cls(whole, _NEVER, _NEVER + 1, slowing, before)

    @classmethod
    def falling(cls, whole: int) -> Pace:
        """It falls from the first update to the last."""
        return cls(whole, 0, whole)

    def branch(self, begin: int, end: int) -> Pace:
        """It falls here, whatever it did before."""
        return self._replace(begin=begin, end=end)


class Clock(NamedTuple):
    """One tick per update.

    Attributes:
        number: updates done before this one.
        pace: what schedules follow.
        key: random key, a function of `number` alone: what all policies draw from it they share,
            which is cheaper, and a policy still does not depend on its company.
    """

    number: jax.Array
    pace: Pace
    key: jax.Array

    @property
    def progress(self) -> jax.Array:
        """Share of the whole training that is done, >= 0."""
        return (self.pace.before + self.number) / self.pace.whole

    @property
    def rate(self) -> jax.Array:
        """Share of the learning rate, from 0 to 1."""
        _, begin, end, slowing, before = self.pace
        slowed = 1.0 / jnp.sqrt(1.0 + (before + jnp.minimum(self.number, begin)) / slowing)
        return slowed * jnp.clip(1.0 - (self.number - begin) / (end - begin), 0.0, 1.0)


def clock_at(number: jax.Array, pace: Pace) -> Clock:
    """The clock after `number` updates."""
    return Clock(number, pace, jax.random.fold_in(jax.random.PRNGKey(_ROOT), number))
