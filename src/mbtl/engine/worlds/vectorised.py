"""Functions of one simulation that compute many with the simulations in the last axis.

`jax.vmap` puts the simulations first. Where a simulation is a few short vectors, a CPU then works
along those, three or seven numbers at a time; with the simulations last it fills its registers.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, cast

import jax
import jax.numpy as jnp
from jax import custom_batching

from mbtl.engine.worlds.environments import Tree

_custom_vmap: Any = custom_batching.custom_vmap  # without types


def batch_last(many: Callable[..., Tree]) -> Callable[..., Tree]:
    """The function of one simulation, however often it is vectorised over its arguments.

    Args:
        many: function of n simulations; n is the last axis of all arrays that it takes and gives.
    """
    together = _custom_vmap(jax.jit(many))  # traced once for each shape, however often it is asked

    def further(size: int, batched: Any, *args: Any) -> tuple[Tree, Tree]:  # (size, ..., n)
        def joined(x: jax.Array) -> jax.Array:
            return jnp.moveaxis(x, 0, -2).reshape(*x.shape[1:-1], -1)

        def parted(x: jax.Array) -> jax.Array:
            return jnp.moveaxis(x.reshape(*x.shape[:-1], size, -1), -2, 0)

        found = jax.tree.map(parted, together(*jax.tree.map(joined, _all(size, batched, args))))
        return found, jax.tree.map(lambda _: True, found)

    def one(*args: Any) -> Tree:
        found = together(*jax.tree.map(lambda x: jnp.asarray(x)[..., None], args))
        return jax.tree.map(lambda x: x[..., 0], found)

    def first(size: int, batched: Any, *args: Any) -> tuple[Tree, Tree]:  # (size, ...)
        last = partial(jnp.moveaxis, source=0, destination=-1)
        found = together(*jax.tree.map(last, _all(size, batched, args)))
        found = jax.tree.map(partial(jnp.moveaxis, source=-1, destination=0), found)
        return found, jax.tree.map(lambda _: True, found)

    together.def_vmap(further)
    alone = _custom_vmap(one)
    alone.def_vmap(first)
    return cast(Callable[..., Tree], alone)


def _all(size: int, batched: Any, args: Any) -> Any:
    """The arguments, each with the new axis."""

    def own(x: jax.Array, has: bool) -> jax.Array:
        return x if has else jnp.broadcast_to(x, (size, *jnp.shape(x)))

    return jax.tree.map(own, args, tuple(batched))
