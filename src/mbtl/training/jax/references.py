"""What an environment gives without any policy: random actions, and no action where there is one.

Notation (shapes): C contexts, E episodes. All play in one compiled program.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from mbtl.arrays import Array
from mbtl.training.jax.environments import Box, Discrete, Environment, Tree
from mbtl.training.jax.evaluation import episode_noise, play_out

_ACTIONS = 1
"""Stream of an episode's random actions."""


def reference_returns(env: Environment, params: Tree, seeds: Sequence[int]) -> dict[str, Array]:
    """(C, E) returns by name; "unguided" where the environment has an action `idle`.

    Args:
        env: the dynamics.
        params: of C contexts, leading axis.
        seeds: one per episode, as in `episode_noise`.
    """
    noise = jnp.asarray(episode_noise(env, seeds))
    params = jax.tree.map(jnp.float32, params)
    rows = {"random_actions": _random(env, params, noise, jnp.asarray(seeds, jnp.uint32))}
    if hasattr(env, "idle"):
        rows["unguided"] = _idle(env, params, noise)
    return {name: np.asarray(row, dtype=np.float64) for name, row in rows.items()}


@partial(jax.jit, static_argnums=0)
def _random(env: Environment, params: Tree, noise: jax.Array, seeds: jax.Array) -> jax.Array:
    """Uniform actions; those of an episode are the same in every context."""
    streams = jax.vmap(lambda seed: jax.random.fold_in(jax.random.key(seed), _ACTIONS))(seeds)
    contexts = params.visible.shape[0]

    def choose(moment: jax.Array, observations: jax.Array) -> jax.Array:
        keys = jax.vmap(lambda stream: jax.random.fold_in(stream, moment))(streams)
        one = jax.vmap(partial(_uniform, action=env.action))(keys)
        return jnp.broadcast_to(one, (contexts, *one.shape))

    return play_out(env, choose, params, noise)


@partial(jax.jit, static_argnums=0)
def _idle(env: Environment, params: Tree, noise: jax.Array) -> jax.Array:
    action = jnp.asarray(env.idle)  # type: ignore[attr-defined]  # asked for by the caller
    shape = (params.visible.shape[0], noise.shape[0], *action.shape)
    return play_out(env, lambda *_: jnp.broadcast_to(action, shape), params, noise)


def _uniform(key: jax.Array, action: Discrete | Box) -> jax.Array:
    if isinstance(action, Discrete):
        return jax.random.randint(key, (), 0, action.n)
    low, high = jnp.asarray(action.low), jnp.asarray(action.high)
    return jax.random.uniform(key, low.shape, minval=low, maxval=high)
