"""PPO on many contexts at once: environment copies play contexts that take turns.

One queue for all copies: whenever an episode ends, its copy starts the next context, 0, 1, ...,
N - 1, 0, ...; of copies that end in the same step, the first goes first. So at any time no context
has been started more than once more often than another, however long its episodes are and however
many copies there are (cmdp-spec, 8.3). Learning is that of `ppo.py`.

Notation (shapes of one policy): N contexts, T steps, E environment copies.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from mbtl.training.jax import networks, ppo
from mbtl.training.jax.clock import Clock
from mbtl.training.jax.environments import Environment, Tree
from mbtl.training.jax.multitask import moore, paco
from mbtl.training.jax.recipes import MultiTaskRecipe
from mbtl.training.jax.rollout import Noise, Rollout, draw


class State(NamedTuple):
    """All of one training: with the next `update`'s arguments it decides everything to come.

    Attributes:
        weights: with attributes `actor`, `critic` and `log_std`.
        optimizer: what the optimiser remembers, over all weights as one vector.
        env: states of the E copies.
        elapsed: (E,) steps since each copy was reset.
        context: (E,) which context each copy plays.
        turn: the context of the next episode.
        key: the policy's own random key.
    """

    weights: Any
    optimizer: Tree
    env: Tree
    elapsed: jax.Array
    context: jax.Array
    turn: jax.Array
    key: jax.Array


def init(
    env: Environment,
    recipe: MultiTaskRecipe,
    seeds: Sequence[int],
    params: Tree,
    weights: Any = None,
) -> State:
    """All policies before their first update.

    Args:
        env: the dynamics.
        recipe: hyper-parameters.
        seeds: one per policy, 32 bits; decides its whole training.
        params: (policies, N, ...) contexts, with their places where the method wants them.
        weights: to begin from, leading axis; None for fresh ones.
    """
    if weights is None:
        n_contexts, n_visible = params.visible.shape[1:]
        n_inputs = env.n_features + n_visible - recipe.has_vectors  # no place for the layers
        make = _INITIAL[recipe.method]
        weights = networks.stack([make(env, recipe, seed, n_contexts, n_inputs) for seed in seeds])
    roots = jnp.asarray(np.array(seeds, dtype=np.uint32))
    state: State = _start(env, recipe, weights, roots, params)
    return state


def _ordinary(
    env: Environment, recipe: MultiTaskRecipe, seed: int, n_contexts: int, n_inputs: int
) -> networks.Weights:
    return networks.init_weights(seed, n_inputs, env.action, recipe.ppo.hidden, recipe.ppo.log_std)


_INITIAL: Mapping[str, Callable[[Environment, MultiTaskRecipe, int, int, int], Any]] = {
    "ppo": _ordinary,
    "paco": paco.init_weights,
    "moore": moore.init_weights,
}


@partial(jax.jit, static_argnums=(0, 1))
@partial(jax.vmap, in_axes=(None, None, 0, 0, 0))
def _start(
    env: Environment, recipe: MultiTaskRecipe, weights: Any, seed: jax.Array, params: Tree
) -> State:
    n_envs, n_contexts = recipe.ppo.n_envs, params.visible.shape[0]
    context = jnp.arange(n_envs) % n_contexts
    key, reset_key = jax.random.split(jax.random.PRNGKey(seed))
    noise = jax.random.uniform(reset_key, (n_envs, env.n_noise))
    return State(
        weights,
        ppo.optimizer(recipe.ppo).init(ravel_pytree(weights)[0]),
        jax.vmap(env.initial)(noise, _of(params, context)),
        jnp.zeros(n_envs, dtype=jnp.int32),
        context,
        jnp.int32(n_envs % n_contexts),
        key,
    )


def update(
    env: Environment, recipe: MultiTaskRecipe, state: State, params: Tree, clock: Clock
) -> State:
    """One rollout and the gradient steps on it; arguments as in `ppo.update`, N contexts."""
    key, noise = draw(env, state.key, (recipe.ppo.n_steps, recipe.ppo.n_envs))
    state, rollout = play(env, recipe, state._replace(key=key), params, noise)
    weights, moments = ppo.learn(env, recipe.ppo, state.weights, state.optimizer, rollout, clock)
    return state._replace(weights=weights, optimizer=moments)


def play(
    env: Environment, recipe: MultiTaskRecipe, state: State, params: Tree, noise: Noise
) -> tuple[State, Rollout]:
    """T steps of the E copies with sampled actions, from (T, E) noise; the key stays."""
    actor, log_std = state.weights.actor, state.weights.log_std
    n_contexts = params.visible.shape[0]
    observe = jax.vmap(env.observe)

    def step(carry: tuple[Tree, jax.Array, jax.Array, jax.Array], drawn: Noise) -> Any:
        state, elapsed, context, turn = carry
        own = _of(params, context)
        obs = observe(state, own)
        outputs = networks.apply(actor, obs, recipe.activation)
        action = networks.sample(outputs, log_std, drawn.action, env.action)
        applied = networks.to_environment(action, env.action)
        new, reward, terminated = jax.vmap(env.step)(state, applied, own)
        done = terminated | (elapsed + 1 >= env.horizon)
        after = observe(new, own)
        context, turn = take_turns(context, turn, done, n_contexts)
        start = jax.vmap(env.initial)(drawn.reset, _of(params, context))
        state = jax.tree.map(lambda s, n: jnp.where(done, s, n), start, new)
        elapsed = jnp.where(done, 0, elapsed + 1)
        if env.time_limit == "terminal":
            terminated = done
        record = Rollout(obs, outputs, action, reward, terminated, done, after)
        return (state, elapsed, context, turn), record

    carry = (state.env, state.elapsed, state.context, state.turn)
    (env_state, elapsed, context, turn), rollout = jax.lax.scan(step, carry, noise)
    state = state._replace(env=env_state, elapsed=elapsed, context=context, turn=turn)
    return state, rollout


def take_turns(
    context: jax.Array, turn: jax.Array, done: jax.Array, n_contexts: int
) -> tuple[jax.Array, jax.Array]:
    """(E,) contexts after the copies that are done took the next ones, and whose turn is next."""
    taken = jnp.cumsum(done)
    context = jnp.where(done, (turn + taken - 1) % n_contexts, context)
    return context, (turn + taken[-1]) % n_contexts


def _of(params: Tree, context: jax.Array) -> Tree:
    """Parameters of the context of each copy."""
    return jax.tree.map(lambda x: x[context], params)
