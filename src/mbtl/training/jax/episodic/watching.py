"""Networks of many policies applied to what agents see at one moment; empty places are left out."""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from mbtl.training.jax import networks
from mbtl.training.jax.networks import Network
from mbtl.training.jax.recipes import Activation
from mbtl.worlds.environments import Tree
from mbtl.worlds.packing import Agents, chunk_size
from mbtl.worlds.world import Crowd, World


class Rows(NamedTuple):
    """Observations so far, (P, rows, f), and how many of the rows are used."""

    obs: jax.Array
    used: jax.Array


class Watched(NamedTuple):
    """A moment: who acts, (P, E, A), what networks say of it, (P, E, A, m) each; a crowd's rows."""

    acting: jax.Array
    found: tuple[jax.Array, ...]
    row: jax.Array | None = None


def watched(
    twin: World,
    activation: Activation,
    params: Tree,
    shape: tuple[int, ...],
    played: tuple[Network, ...],
    state: Tree,
    rows: Rows | None = None,
) -> tuple[Watched, Any]:
    """Networks of P policies, `shape` (P, E), applied to what their agents see; 0 where none is.

    `rows` is where to keep the observations of a crowd; None to keep none.
    """
    if not isinstance(twin, Crowd):
        obs, acting = twin.observe(state, params)
        acting = acting.reshape(*shape, -1)
        obs = obs.reshape(*acting.shape, -1)
        return Watched(acting, tuple(each(activation, network, obs) for network in played)), rows
    used = jnp.int32(0) if rows is None else rows.used

    def kept(rows: Rows | None, obs: jax.Array, at: jax.Array) -> Rows | None:
        if rows is None:
            return None
        return rows._replace(obs=jax.lax.dynamic_update_slice(rows.obs, obs, (0, at, 0)))

    acting = twin.acting(state).reshape(*shape, -1)
    agents = Agents.of(acting)
    size = chunk_size(acting[0].size)

    def chunk(carry: tuple[jax.Array, Any, Any]) -> tuple[jax.Array, Any, Any]:
        start, found, rows = carry
        obs = twin.views(state, params, *agents.chunk(start, size))
        new = (each(activation, network, obs) for network in played)
        found = tuple(agents.spread(x, start, into) for x, into in zip(new, found, strict=True))
        return start + size, found, kept(rows, obs, used + start)

    def more(carry: tuple[jax.Array, Any, Any]) -> jax.Array:
        return carry[0] < agents.most

    nothing = tuple(jnp.zeros((*acting.shape, network[-1][1].shape[-1])) for network in played)
    end, found, rows = jax.lax.while_loop(more, chunk, (jnp.int32(0), nothing, rows))
    if rows is not None:
        rows = rows._replace(used=used + end)
    return Watched(acting, found, used + agents.number), rows


def each(activation: Activation, network: Network, obs: jax.Array) -> jax.Array:
    """(P, ..., f) -> (P, ..., m), each policy its own."""
    one = partial(networks.apply, activation=activation)
    outputs: jax.Array = jax.vmap(one)(network, obs)
    return outputs
