"""Proximal policy optimisation of one policy, written to be vectorised over many with `jax.vmap`.

State in, state out: `init` makes a state, `update` plays one rollout and learns from it. Semantics
are those of Stable-Baselines3 (advantage normalisation per minibatch, bootstrap at truncation,
no clipping of values), so its recipe gives its learning curves.

Notation (shapes of one policy): T steps, E environment copies, B minibatch, o observation.
    obs (T, E, o); action (T, E) or (T, E, d); reward, value, advantage, target (T, E)
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import optax
from jax.flatten_util import ravel_pytree

from mbtl.training.jax import networks
from mbtl.training.jax.clock import Clock
from mbtl.training.jax.networks import Weights
from mbtl.training.jax.recipes import PPORecipe
from mbtl.training.jax.rollout import Rollout, State, advantages, draw, play, start
from mbtl.worlds.environments import Tree
from mbtl.worlds.world import Solo


class Batch(NamedTuple):
    """Transitions to learn from, one leading axis."""

    obs: jax.Array
    action: jax.Array
    log_prob: jax.Array
    advantage: jax.Array
    target: jax.Array


def init(
    world: Solo,
    recipe: PPORecipe,
    seeds: Sequence[int],
    params: Tree,
    weights: Weights | None = None,
) -> State:
    """All policies before their first update; see `rollout.start`."""
    return start(world, recipe, optimizer, seeds, params, weights)


def update(
    world: Solo,
    recipe: PPORecipe,
    state: State,
    params: Tree,
    clock: Clock,
) -> State:
    """One rollout and the gradient steps on it.

    Args:
        world: the dynamics; static.
        recipe: hyper-parameters; static.
        state: one policy's.
        params: its context.
        clock: which update it is. Its key gives the order of the minibatches, one for all policies:
            sorting apart for each would cost a tenth of the training.
    """
    key, noise = draw(world, state.key, (recipe.n_steps, recipe.n_envs))
    state, rollout = play(world, recipe, state._replace(key=key), params, noise)
    weights, moments = learn(world, recipe, state.weights, state.optimizer, rollout, clock)
    return state._replace(weights=weights, optimizer=moments)


def learn(
    world: Solo,
    recipe: PPORecipe,
    weights: Weights,
    moments: Tree,
    rollout: Rollout,
    clock: Clock,
) -> tuple[Weights, Tree]:
    """Weights and the optimiser's memory after the gradient steps on one rollout."""
    batch = learn_from(world, recipe, weights, rollout)
    loss = jax.grad(_loss, argnums=2)

    flat, unravel = ravel_pytree(weights)  # one vector: few large operations, not many small
    scale = 1.0 - clock.progress if recipe.anneal else jnp.float32(1.0)

    def minibatch(
        carry: tuple[jax.Array, Tree], part: Batch
    ) -> tuple[tuple[jax.Array, Tree], None]:
        weights, moments = carry
        gradient, _ = ravel_pytree(loss(world, recipe, unravel(weights), part))
        steps, moments = optimizer(recipe).update(gradient, moments)
        return (weights + scale * steps, moments), None

    def epoch(carry: tuple[jax.Array, Tree], key: jax.Array) -> tuple[tuple[jax.Array, Tree], None]:
        order = jax.random.permutation(key, recipe.update_length)
        parts = jax.tree.map(lambda x: x[order].reshape(-1, recipe.batch_size, *x.shape[1:]), batch)
        carry, _ = jax.lax.scan(minibatch, carry, parts)
        return carry, None

    (flat, moments), _ = jax.lax.scan(
        epoch, (flat, moments), jax.random.split(clock.key, recipe.n_epochs)
    )
    return unravel(flat), moments


def learn_from(world: Solo, recipe: PPORecipe, weights: Weights, rollout: Rollout) -> Batch:
    """(T x E,) transitions with generalised advantages and value targets."""
    value = networks.apply(weights.critic, rollout.obs, recipe.activation)[..., 0]
    advantage = advantages(recipe, weights.critic, rollout, value)
    old = networks.log_prob(rollout.outputs, weights.log_std, rollout.action, world.action)
    batch = Batch(rollout.obs, rollout.action, old, advantage, advantage + value)
    return Batch(*(x.reshape(-1, *x.shape[2:]) for x in batch))


def _loss(world: Solo, recipe: PPORecipe, weights: Weights, batch: Batch) -> jax.Array:
    """Clipped surrogate + value_coef x squared error - entropy_coef x entropy."""
    advantage = batch.advantage
    if recipe.normalize_advantage and recipe.batch_size > 1:
        advantage = (advantage - advantage.mean()) / (advantage.std(ddof=1) + 1e-8)
    outputs = networks.apply(weights.actor, batch.obs, recipe.activation)
    value = networks.apply(weights.critic, batch.obs, recipe.activation)[..., 0]
    log_prob = networks.log_prob(outputs, weights.log_std, batch.action, world.action)
    ratio = jnp.exp(log_prob - batch.log_prob)
    near = jnp.clip(ratio, 1.0 - recipe.clip_range, 1.0 + recipe.clip_range)
    loss = -jnp.minimum(advantage * ratio, advantage * near).mean()
    loss += recipe.value_coef * jnp.square(batch.target - value).mean()
    if recipe.entropy_coef:
        bonus = networks.entropy(outputs, weights.log_std, world.action).mean()
        loss -= recipe.entropy_coef * bonus
    return loss


def optimizer(recipe: PPORecipe) -> optax.GradientTransformation:
    """Adam after clipping the norm of one policy's gradient; the step is -lr times Adam's."""
    return optax.chain(
        optax.clip_by_global_norm(recipe.max_grad_norm),
        optax.scale_by_adam(eps=recipe.adam_eps),
        optax.scale(-recipe.learning_rate),
    )
