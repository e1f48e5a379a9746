"""Playing an actor-critic in its environment, and what its steps were worth; PPO and A2C share it.

Notation (shapes of one policy): T steps, E environment copies, o observation.
    obs (T, E, o); action (T, E) or (T, E, d); reward, value, advantage (T, E)
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax.flatten_util import ravel_pytree

from mbtl.training.jax import networks
from mbtl.training.jax.environments import Environment, Tree
from mbtl.training.jax.networks import Network, Weights
from mbtl.training.jax.recipes import A2CRecipe, PPORecipe


class State(NamedTuple):
    """All of one training: with the next `update`'s arguments it decides everything to come.

    Attributes:
        weights: the networks.
        optimizer: what the optimiser remembers, over all weights as one vector.
        env: states of the E copies.
        elapsed: (E,) steps since each copy was reset.
        key: the policy's own random key.
    """

    weights: Weights
    optimizer: Tree
    env: Tree
    elapsed: jax.Array
    key: jax.Array


class Noise(NamedTuple):
    """Random numbers of some steps: for the actions, and for the states after a reset."""

    action: jax.Array
    reset: jax.Array


class Moved(NamedTuple):
    """One step of the E copies; `after` is the observation before a reset."""

    env: Tree
    elapsed: jax.Array
    reward: jax.Array
    terminated: jax.Array
    done: jax.Array
    after: jax.Array


class Rollout(NamedTuple):
    """What T steps of E copies gave; `after` is the observation before a reset."""

    obs: jax.Array
    outputs: jax.Array
    action: jax.Array
    reward: jax.Array
    terminated: jax.Array
    done: jax.Array
    after: jax.Array


def start(
    env: Environment,
    recipe: PPORecipe | A2CRecipe,
    optimizer: Callable[[Any], optax.GradientTransformation],
    seeds: Sequence[int],
    params: Tree,
    weights: Weights | None = None,
) -> State:
    """Networks, an optimiser without memory and freshly reset environments of all policies.

    Args:
        env: the dynamics.
        recipe: hyper-parameters.
        optimizer: makes the optimiser from the recipe; a module's function.
        seeds: one per policy, 32 bits; decides its whole training.
        params: one context per policy, leading axis.
        weights: to begin from, leading axis; None for fresh ones.
    """
    if weights is None:
        n_inputs = env.n_features + params.visible.shape[-1]
        each = [
            networks.init_weights(seed, n_inputs, env.action, recipe.hidden, recipe.log_std)
            for seed in seeds
        ]
        weights = networks.stack(each)
    roots = jnp.asarray(np.array(seeds, dtype=np.uint32))
    state: State = _start(env, recipe, optimizer, weights, roots, params)
    return state


@partial(jax.jit, static_argnums=(0, 1, 2))
@partial(jax.vmap, in_axes=(None, None, None, 0, 0, 0))
def _start(
    env: Environment,
    recipe: PPORecipe | A2CRecipe,
    optimizer: Callable[[Any], optax.GradientTransformation],
    weights: Weights,
    seed: jax.Array,
    params: Tree,
) -> State:
    moments = optimizer(recipe).init(ravel_pytree(weights)[0])
    return State(weights, moments, *first_copies(env, recipe.n_envs, seed, params))


def first_copies(
    env: Environment, n_envs: int, seed: jax.Array, params: Tree
) -> tuple[Tree, jax.Array, jax.Array]:
    """States of freshly reset copies, steps since then, and the key of what follows."""
    key, reset_key = jax.random.split(jax.random.PRNGKey(seed))
    noise = jax.random.uniform(reset_key, (n_envs, env.n_noise))
    states = jax.vmap(env.initial, (0, None))(noise, params)
    return states, jnp.zeros(n_envs, dtype=jnp.int32), key


def draw(env: Environment, key: jax.Array, shape: tuple[int, ...]) -> tuple[jax.Array, Noise]:
    """The next key, and noise for steps of this shape, e.g. (T, E)."""
    key, action_key, reset_key = jax.random.split(key, 3)
    noise = Noise(
        networks.action_noise(action_key, shape, env.action),
        jax.random.uniform(reset_key, (*shape, env.n_noise)),
    )
    return key, noise


def advance(
    env: Environment,
    params: Tree,
    state: Tree,
    elapsed: jax.Array,
    action: jax.Array,
    noise: jax.Array,
) -> Moved:
    """One step of the E copies; a copy that has ended starts anew from its (n_noise,) noise."""
    observe = jax.vmap(env.observe, (0, None))
    new, reward, terminated = jax.vmap(env.step, (0, 0, None))(state, action, params)
    out_of_time = elapsed + 1 >= env.horizon
    done = terminated | out_of_time
    after = observe(new, params)
    start = jax.vmap(env.initial, (0, None))(noise, params)
    state = jax.tree.map(lambda s, n: jnp.where(done, s, n), start, new)
    elapsed = jnp.where(done, 0, elapsed + 1)
    if env.time_limit == "terminal":
        terminated = done
    return Moved(state, elapsed, reward, terminated, done, after)


def play(
    env: Environment, recipe: PPORecipe | A2CRecipe, state: State, params: Tree, noise: Noise
) -> tuple[State, Rollout]:
    """T steps of the E copies with sampled actions, from (T, E) noise; the key stays."""
    observe = jax.vmap(env.observe, (0, None))
    actor, log_std = state.weights.actor, state.weights.log_std

    def step(carry: tuple[Tree, jax.Array, jax.Array], drawn: Noise) -> Any:
        state, elapsed, obs = carry
        outputs = networks.apply(actor, obs, recipe.activation)
        action = networks.sample(outputs, log_std, drawn.action, env.action)
        applied = networks.to_environment(action, env.action)
        moved = advance(env, params, state, elapsed, applied, drawn.reset)
        record = Rollout(
            obs, outputs, action, moved.reward, moved.terminated, moved.done, moved.after
        )
        return (moved.env, moved.elapsed, observe(moved.env, params)), record

    carry = (state.env, state.elapsed, observe(state.env, params))
    (env_state, elapsed, _), rollout = jax.lax.scan(step, carry, noise)
    return state._replace(env=env_state, elapsed=elapsed), rollout


def advantages(
    recipe: PPORecipe | A2CRecipe, critic: Network, rollout: Rollout, value: jax.Array
) -> jax.Array:
    """(T, E) generalised advantage estimates, given `value`, the critic's of the observations.

    delta = r + gamma V(after) (1 - terminated) - V(obs); truncated episodes bootstrap from the
    observation in which they were cut off.
    """
    value_after = networks.apply(critic, rollout.after, recipe.activation)[..., 0]
    reward = rollout.reward.astype(jnp.float32)
    delta = reward + recipe.gamma * jnp.where(rollout.terminated, 0.0, value_after) - value
    decay = jnp.where(rollout.done, 0.0, recipe.gamma * recipe.gae_lambda)

    def back(later: jax.Array, now: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        advantage = now[0] + now[1] * later
        return advantage, advantage

    _, advantage = jax.lax.scan(
        back, jnp.zeros_like(delta[0]), (delta, decay), reverse=True, unroll=8
    )
    return advantage
