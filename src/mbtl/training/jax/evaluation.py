"""Deterministic episodes of many policies on many contexts, with common random numbers.

Notation (shapes): P policies, C contexts, E episodes.

Episode e starts from the same random numbers for every policy and context, and those are the ones
that the Gymnasium environment would draw from the episode's seed: returns can be compared across
engines episode by episode, up to the rounding of float32.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from mbtl.arrays import Array
from mbtl.errors import InvalidInput
from mbtl.training.jax import networks
from mbtl.training.jax.environments import Environment, Tree
from mbtl.training.jax.networks import Network
from mbtl.training.jax.recipes import Activation

CPU_ROWS = 400
"""Episodes played together on a CPU: few enough that their activations stay in its cache."""

DEVICE_ROWS = 1 << 20
"""The same on an accelerator: 256 MB for each layer of 64 units."""


def on_cpu() -> bool:
    """Whether jax computes on the CPU of this machine."""
    return bool(jax.default_backend() == "cpu")


def episode_noise(env: Environment, seeds: Sequence[int]) -> NDArray[np.float32]:
    """(E, n_noise) uniform numbers that start the episodes, as `reset(seed=...)` draws them."""
    draws = [np.random.default_rng(seed).random(env.n_noise) for seed in seeds]
    return np.asarray(draws, dtype=np.float32)


def evaluate(
    env: Environment,
    actors: Network,
    params: Tree,
    noise: NDArray[np.float32],
    *,
    activation: Activation = "tanh",
    rows: int | None = None,
    on_block: Callable[[int, int], None] | None = None,
) -> Array:
    """Undiscounted returns of every policy on every context.

    Memory is bounded by `rows`; a block ends as soon as all of its episodes have.

    Args:
        env: the dynamics.
        actors: of P policies, leading axis.
        params: of C contexts, leading axis.
        noise: (E, n_noise), see `episode_noise`.
        activation: between the layers of the actors.
        rows: episodes at a time; None chooses for the device.
        on_block: called with (pairs of policy and context done, planned) after each block.

    Returns:
        (P, C, E) returns in raw units.

    Raises:
        InvalidInput: there are no policies, contexts or episodes.
    """
    n_policies, n_contexts = (len(jax.tree.leaves(tree)[0]) for tree in (actors, params))
    if 0 in (n_policies, n_contexts, len(noise)):
        raise InvalidInput(
            "evaluation needs at least one policy, context and episode, "
            f"got {n_policies}, {n_contexts} and {len(noise)}"
        )
    if rows is None:
        rows = CPU_ROWS if on_cpu() else DEVICE_ROWS
    width = max(1, min(n_contexts, rows // len(noise)))
    height = max(1, min(n_policies, rows // (width * len(noise))))
    returns = np.empty((n_policies, n_contexts, len(noise)))
    done = 0
    for p in range(0, n_policies, height):
        some = _take(actors, p, height)
        for c in range(0, n_contexts, width):
            part = np.asarray(_every_pair(env, activation, some, _take(params, c, width), noise))
            target = returns[p : p + height, c : c + width]
            target[...] = part[: target.shape[0], : target.shape[1]]
            done += target.shape[0] * target.shape[1]
            if on_block is not None:
                on_block(done, n_policies * n_contexts)
    return returns


def _take(tree: Tree, first: int, count: int) -> Tree:
    """Members first..first+count-1; the last one repeats, so that there is one shape to compile."""

    def part(leaf: jax.Array) -> NDArray[np.float32]:
        at = np.minimum(np.arange(first, first + count), len(leaf) - 1)
        return np.asarray(leaf, dtype=np.float32)[at]

    return jax.tree.map(part, tree)


@partial(jax.jit, static_argnums=(0, 1))
def _every_pair(
    env: Environment, activation: Activation, actors: Network, params: Tree, noise: jax.Array
) -> jax.Array:
    """(P, C, E): every policy on every context."""
    play = partial(_play, env, activation)
    return jax.vmap(play, in_axes=(0, None, None))(actors, params, noise)


def own_returns(
    env: Environment, activation: Activation, actors: Network, params: Tree, noise: jax.Array
) -> jax.Array:
    """(P, E): each policy on its own contexts with its own (P, E, n_noise) noise; can be traced.

    Parameters are (P, ...), one context per policy, or (P, C, ...): then the episodes are dealt out
    evenly, the first E / C to the first context.
    """
    if params.visible.ndim == 2:
        alone = jax.tree.map(lambda x: x[:, None], params)
        return jax.vmap(partial(_play, env, activation))(actors, alone, noise)[:, 0]
    dealt = noise.reshape(*params.visible.shape[:2], -1, noise.shape[-1])

    def one(actor: Network, params: Tree, noise: jax.Array) -> jax.Array:
        alone = jax.tree.map(lambda x: x[None], params)
        return _play(env, activation, actor, alone, noise)[0]

    returns = jax.vmap(jax.vmap(one, (None, 0, 0)))(actors, params, dealt)
    return returns.reshape(len(returns), -1)


def _play(
    env: Environment, activation: Activation, actor: Network, params: Tree, noise: jax.Array
) -> jax.Array:
    """(C, E) returns of one policy."""

    def choose(moment: jax.Array, observations: jax.Array) -> jax.Array:
        return networks.mode(networks.apply(actor, observations, activation), env.action)

    return play_out(env, choose, params, noise)


def play_out(
    env: Environment,
    choose: Callable[[jax.Array, jax.Array], jax.Array],
    params: Tree,
    noise: jax.Array,
) -> jax.Array:
    """(C, E) returns under any rule; stops when no episode is alive. Can be traced.

    Args:
        env: the dynamics.
        choose: number of the step, (C, E, f) observations -> actions, leading axes (C, E).
        params: of C contexts, leading axis.
        noise: (E, n_noise), see `episode_noise`.
    """
    start = jax.vmap(jax.vmap(env.initial, (0, None)), (None, 0))
    step = jax.vmap(jax.vmap(env.step, (0, 0, None)))
    observe = jax.vmap(jax.vmap(env.observe, (0, None)))
    n_contexts = params.visible.shape[0]
    shape = (n_contexts, noise.shape[0])

    def running(carry: tuple[jax.Array, Tree, jax.Array, jax.Array]) -> jax.Array:
        steps, _, alive, _ = carry
        return (steps < env.horizon) & alive.any()

    def advance(
        carry: tuple[jax.Array, Tree, jax.Array, jax.Array],
    ) -> tuple[jax.Array, Tree, jax.Array, jax.Array]:
        steps, state, alive, total = carry
        new, reward, terminated = step(state, choose(steps, observe(state, params)), params)
        total = total + jnp.where(alive, reward, 0.0).astype(jnp.float32)
        return steps + 1, new, alive & ~terminated, total

    first = (jnp.int32(0), start(noise, params), jnp.ones(shape, bool), jnp.zeros(shape))
    return jax.lax.while_loop(running, advance, first)[3]
