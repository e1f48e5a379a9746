"""Agents that act, packed: most places for agents are empty, and networks shall not see those.

Notation (shapes): P policies, E episodes each, A places in each; the agents of a policy are counted
over its episodes in the order of episodes and places. A chunk is K agents of each policy, from
number `start` on; which numbers are beyond the last agent does not matter, as nobody reads them.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

_CHUNKS = 10
"""Chunks into which all places go: an eco-driving region has up to 40 agents, and mostly a few."""


class Agents(NamedTuple):
    """Who acts at one moment.

    Attributes:
        acting: (P, E, A).
        number: (P, E, A) of each agent among those of its policy, from 0.
        within: (P, E, A) agents of the episode up to and with this place.
        before: (P, E) agents in earlier episodes.
        most: of a policy.
    """

    acting: jax.Array
    number: jax.Array
    within: jax.Array
    before: jax.Array
    most: jax.Array

    @classmethod
    def of(cls, acting: jax.Array) -> Agents:
        """From a mask (P, E, A)."""
        within = _running(acting)
        count = within[..., -1]
        before = _running(count) - count
        number = before[..., None] + within - 1
        return cls(acting, number, within, before, (before[:, -1] + count[:, -1]).max())

    def chunk(self, start: jax.Array, size: int) -> tuple[jax.Array, jax.Array]:
        """(P, K) simulations, counted over all policies, and places of the agents of a chunk."""
        policies, episodes, places = self.acting.shape
        number = start + jnp.arange(size)
        later = self.before[:, None, 1:] <= number[:, None]
        episode = later.sum(axis=-1)
        own = jnp.arange(policies)[:, None]
        rank = number - self.before[own, episode]
        place = (self.within[own, episode] <= rank[..., None]).sum(axis=-1)
        return own * episodes + episode, jnp.minimum(place, places - 1)

    def spread(self, found: jax.Array, start: jax.Array, into: jax.Array) -> jax.Array:
        """`into`, (P, E, A, ...), with what was found for the agents of a chunk, (P, K, ...)."""
        at = self.number - start
        mine = self.acting & (at >= 0) & (at < found.shape[1])
        own = jnp.arange(len(found))[:, None, None]
        values = found[own, jnp.clip(at, 0, found.shape[1] - 1)]
        return jnp.where(mine.reshape(*mine.shape, *[1] * (values.ndim - 3)), values, into)


def chunk_size(places: int) -> int:
    """K for E x A places."""
    return max(1, -(-places // _CHUNKS))


def most_rows(places: int) -> int:
    """Rows of the chunks of one moment if all E x A places are taken."""
    size = chunk_size(places)
    return size * -(-places // size)


def _running(count: jax.Array) -> jax.Array:
    """Running sums along the last axis, as a product: a scan would be a dozen passes on a CPU."""
    width = count.shape[-1]
    upto = jnp.triu(jnp.ones((width, width), jnp.float32))
    return (count.astype(jnp.float32) @ upto).astype(jnp.int32)
