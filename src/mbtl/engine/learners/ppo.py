"""Proximal policy optimisation of one policy, written to be vectorised over many with `jax.vmap`.

    loss = -mean min(r A, clip(r, 1 +- clip) A) + value_coef mean (V - R)^2 - entropy_coef H

Rows of copies of a world that start again one by one (`rollout`) are learnt from as in
Stable-Baselines3 (advantage normalisation per minibatch, bootstrap at truncation, no clipping of
values), so its recipe gives its learning curves. Those of whole episodes (`episodic.ppo`) bound the
steps further, see `Limits`.

Notation (shapes of one policy): T steps, E environment copies, o observation.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree

from mbtl.engine.learners import networks
from mbtl.engine.learners.clock import Clock
from mbtl.engine.learners.descent import adam, mean_of
from mbtl.engine.learners.networks import Weights
from mbtl.engine.learners.recipes import AnyPPO, PPORecipe
from mbtl.engine.learners.rollout import Rollout, State, advantages, draw, play, start
from mbtl.engine.learners.units import Units
from mbtl.engine.worlds.environments import Box, Discrete, Tree
from mbtl.engine.worlds.world import Solo


class Batch(NamedTuple):
    """Rows to learn from, one leading axis; the last three are known of whole episodes only.

    Attributes:
        obs: what was seen.
        action: integers, or (..., d), not clipped.
        log_prob: of the policy that played.
        advantage: of the action.
        target: of the critic.
        outputs: of the actor that played.
        value: of the critic that watched.
        weight: 1 where an agent decided, else 0.
    """

    obs: jax.Array
    action: jax.Array
    log_prob: jax.Array
    advantage: jax.Array
    target: jax.Array
    outputs: jax.Array | None = None
    value: jax.Array | None = None
    weight: jax.Array | None = None


class Limits(NamedTuple):
    """What bounds the steps of an update on whole episodes, beside the clip of the ratio.

    Attributes:
        log_std: of the policy that played.
        kl_coef: weight of the penalty.
        target_kl: the update ends when a minibatch is farther than this.
        value_clip: largest move of a value.
    """

    log_std: jax.Array
    kl_coef: jax.Array
    target_kl: float
    value_clip: float


Progress = tuple[jax.Array, Tree, jax.Array, jax.Array]
"""Within an update: weights, Adam's state, whether it has gone too far, and the latest KL."""


def init(
    world: Solo, recipe: PPORecipe, seeds: Sequence[int], params: Tree, weights: Any = None
) -> State:
    """As `rollout.start`; from standardised observations the fresh networks are told apart."""
    state = start(adam, world, recipe, seeds, params, weights)
    if not recipe.standardize:
        return state
    fresh = weights is None, weights is None or not weights.critic
    return state._replace(fresh=jnp.tile(jnp.array(fresh), (len(seeds), 1)))


def update(world: Solo, recipe: PPORecipe, state: State, params: Tree, clock: Clock) -> State:
    """One rollout and the gradient steps on it.

    The clock's key gives the order of the minibatches, one for all policies: sorting apart for each
    would cost a tenth of the training.
    """
    key, noise = draw(world, state.key, (recipe.n_steps, recipe.n_envs))
    state, rollout = play(world, recipe, state._replace(key=key), params, noise)
    how = learn_in_units if recipe.standardize else learn
    return how(world, recipe, state, rollout, clock)


def learn_in_units(
    world: Solo, recipe: PPORecipe, state: State, rollout: Rollout, clock: Clock
) -> State:
    """As `learn`, from standardised observations; see `units`.

    Fresh networks are meant for those, too. A fresh actor becomes another policy by that, so its
    first rollout only shows the units, and nothing is learnt from it.
    """
    units, weights, fresh = Units.of(rollout.obs), state.weights, state.fresh
    obs, after = map(units.measured, (rollout.obs, rollout.after))
    rollout = rollout._replace(obs=obs, after=after)
    each = zip(fresh, (weights.actor, weights.critic), strict=True)
    actor, critic = (either(new, network, units.entered(network)) for new, network in each)
    entered = state._replace(weights=weights._replace(actor=actor, critic=critic))
    learnt: State = either(fresh[0], entered, learn(world, recipe, entered, rollout, clock))
    weights = learnt.weights
    weights = weights._replace(actor=units.left(weights.actor), critic=units.left(weights.critic))
    return learnt._replace(weights=weights, fresh=jnp.zeros_like(fresh))


def either(first: jax.Array, one: Any, other: Any) -> Any:
    """The one tree, or the other."""
    return jax.tree.map(partial(jnp.where, first), one, other)


def learn(world: Solo, recipe: PPORecipe, state: State, rollout: Rollout, clock: Clock) -> State:
    """After the gradient steps on (T x E,) transitions with advantages and value targets."""
    weights, moments = state.weights, state.optimizer
    value = networks.apply(weights.critic, rollout.obs, recipe.activation)[..., 0]
    advantage = advantages(recipe, weights.critic, rollout, value)
    old = networks.log_prob(rollout.outputs, weights.log_std, rollout.action, world.action)
    rows = (rollout.obs, rollout.action, old, advantage, advantage + value)
    batch, rate = Batch(*(x.reshape(-1, *x.shape[2:]) for x in rows)), clock.rate
    weights, moments, _ = descend(world.action, recipe, weights, moments, batch, clock.key, rate)
    return state._replace(weights=weights, optimizer=moments)


def descend(
    space: Discrete | Box,
    recipe: AnyPPO,
    weights: Weights,
    moments: Tree,
    batch: Batch,
    key: jax.Array,
    scale: jax.Array,
    limits: Limits | None = None,
) -> tuple[Weights, Tree, jax.Array]:
    """Weights, the optimiser's memory and the last KL after all passes over the rows.

    `key` decides the order of the rows, `scale` times the learning rate is that of the steps.
    """
    flat, unravel = ravel_pytree(weights)  # one vector: few large operations, not many small
    gradient = jax.grad(partial(loss, space, recipe), has_aux=True)

    def minibatch(carry: Progress, part: Batch) -> tuple[Progress, None]:
        flat, moments, far, _ = carry
        slope, apart = gradient(unravel(flat), part, limits)
        steps, new = adam(recipe).update(ravel_pytree(slope)[0], moments)
        stepped = (flat + scale * steps, new)
        if limits is not None:
            far |= apart > limits.target_kl
            stepped = jax.tree.map(lambda a, b: jnp.where(far, a, b), (flat, moments), stepped)
        return (*stepped, far, apart), None

    def epoch(carry: Progress, key: jax.Array) -> tuple[Progress, None]:
        order = jax.random.permutation(key, len(batch.obs))
        parts = jax.tree.map(lambda x: x[order].reshape(-1, recipe.batch_size, *x.shape[1:]), batch)
        carry, _ = jax.lax.scan(minibatch, carry, parts)
        return carry, None

    first = (flat, moments, jnp.array(False), jnp.float32(0.0))
    keys = jax.random.split(key, recipe.n_epochs)
    (flat, moments, _, apart), _ = jax.lax.scan(epoch, first, keys)
    return unravel(flat), moments, apart


def loss(
    space: Discrete | Box,
    recipe: AnyPPO,
    weights: Weights,
    batch: Batch,
    limits: Limits | None = None,
) -> tuple[jax.Array, jax.Array]:
    """What is made small, and the mean KL(old, new); 0 where it is no limit."""
    advantage, apart = batch.advantage, jnp.float32(0.0)
    mean: Callable[[jax.Array], jax.Array] = jnp.mean
    if batch.weight is not None:
        mean = partial(mean_of, weight=batch.weight)
    elif recipe.normalize_advantage and recipe.batch_size > 1:
        advantage = (advantage - advantage.mean()) / (advantage.std(ddof=1) + 1e-8)
    outputs = networks.apply(weights.actor, batch.obs, recipe.activation)
    value = networks.apply(weights.critic, batch.obs, recipe.activation)[..., 0]
    error = jnp.square(batch.target - value)
    if limits is not None:  # in this order and form, which decide the last bit of kept policies
        apart = mean(networks.kl(batch.outputs, limits.log_std, outputs, weights.log_std, space))
        close = batch.value + jnp.clip(value - batch.value, -limits.value_clip, limits.value_clip)
        error = jnp.maximum(jnp.square(value - batch.target), jnp.square(close - batch.target))
    after = networks.log_prob(outputs, weights.log_std, batch.action, space)
    ratio = jnp.exp(after - batch.log_prob)
    near = jnp.clip(ratio, 1.0 - recipe.clip_range, 1.0 + recipe.clip_range)
    total = -mean(jnp.minimum(advantage * ratio, advantage * near))
    if limits is not None:
        total += limits.kl_coef * apart
    total += recipe.value_coef * mean(error)
    if recipe.entropy_coef:
        spread = networks.entropy(outputs, weights.log_std, space)
        total -= recipe.entropy_coef * mean(spread)
    return total, apart
