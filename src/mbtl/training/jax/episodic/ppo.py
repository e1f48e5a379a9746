"""Proximal policy optimisation of one policy on whole episodes, shared by agents that come and go.

The form of cmdp-spec, 6.3: a clipped surrogate with an adaptive KL penalty, a clipped value loss,
and an end of the update as soon as a minibatch is too far from the policy that played.

    loss = -mean min(r A, clip(r, 1 +- clip) A) + kl_coef KL(old, new)
           + value_coef mean max((V - R)^2, (V_old + clip(V - V_old, +- value_clip) - R)^2)
           - entropy_coef H

Only moments at which an agent decided are rows to learn from: a random `rows` of them, as most
places are empty most of the time.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import optax
from jax.flatten_util import ravel_pytree

from mbtl.training.jax import networks
from mbtl.training.jax.clock import clock_at
from mbtl.training.jax.episodic.distributions import kl, mean_of, standard
from mbtl.training.jax.episodic.episodes import Episodes
from mbtl.training.jax.episodic.recipes import EpisodicPPORecipe
from mbtl.training.jax.episodic.returns import Returns, advantages
from mbtl.training.jax.networks import Weights
from mbtl.worlds.environments import Box, Discrete, Tree

Progress = tuple[jax.Array, Tree, jax.Array, jax.Array]
"""Within an update: weights, Adam's state, whether it has gone too far, and the latest KL."""


class Batch(NamedTuple):
    """Rows to learn from, (rows, ...); `weight` is 1 where an agent decided, else 0."""

    obs: jax.Array
    outputs: jax.Array
    action: jax.Array
    log_prob: jax.Array
    advantage: jax.Array
    target: jax.Array
    value: jax.Array
    weight: jax.Array


class Memory(NamedTuple):
    """What one policy keeps between updates, beside its weights.

    Attributes:
        moments: the state of Adam.
        returns: running statistics of rewards and returns.
        kl_coef: weight of the KL penalty.
    """

    moments: Tree
    returns: Returns
    kl_coef: jax.Array


def start(recipe: EpisodicPPORecipe, weights: Weights) -> Memory:
    """Before the first update."""
    moments = _optimizer(recipe).init(ravel_pytree(weights)[0])
    return Memory(moments, Returns.empty(), jnp.float32(recipe.kl_coef))


def learn(
    action: Discrete | Box,
    recipe: EpisodicPPORecipe,
    weights: Weights,
    memory: Memory,
    lived: Episodes,
    number: jax.Array,
) -> tuple[Weights, Memory]:
    """The gradient steps of one update; arguments as in `trpo.learn`."""
    key = clock_at(number, number + 1).key
    batch, returns = _rows(action, recipe, weights, memory.returns, lived, key)
    flat, unravel = ravel_pytree(weights)
    old_log_std = weights.log_std

    def loss(flat: jax.Array, part: Batch) -> tuple[jax.Array, jax.Array]:
        new = unravel(flat)
        outputs = networks.apply(new.actor, part.obs, recipe.activation)
        apart = mean_of(kl(part.outputs, old_log_std, outputs, new.log_std, action), part.weight)
        after = networks.log_prob(outputs, new.log_std, part.action, action)
        ratio = jnp.exp(after - part.log_prob)
        near = jnp.clip(ratio, 1.0 - recipe.clip_range, 1.0 + recipe.clip_range)
        gain = jnp.minimum(ratio * part.advantage, near * part.advantage)
        value = networks.apply(new.critic, part.obs, recipe.activation)[..., 0]
        close = part.value + jnp.clip(value - part.value, -recipe.value_clip, recipe.value_clip)
        error = jnp.maximum(jnp.square(value - part.target), jnp.square(close - part.target))
        total = -mean_of(gain, part.weight) + memory.kl_coef * apart
        total += recipe.value_coef * mean_of(error, part.weight)
        spread = networks.entropy(outputs, new.log_std, action)
        total -= recipe.entropy_coef * mean_of(spread * jnp.ones_like(gain), part.weight)
        return total, apart

    gradient = jax.grad(loss, has_aux=True)

    def minibatch(carry: Progress, part: Batch) -> tuple[Progress, None]:
        flat, moments, far, _ = carry
        slope, apart = gradient(flat, part)
        far |= apart > recipe.target_kl
        steps, new = _optimizer(recipe).update(slope, moments)
        keep = partial(jax.tree.map, lambda a, b: jnp.where(far, a, b))
        return (keep(flat, flat + steps), keep(moments, new), far, apart), None

    def epoch(carry: Progress, key: jax.Array) -> tuple[Progress, None]:
        order = jax.random.permutation(key, recipe.rows)
        parts = jax.tree.map(
            lambda x: x[order].reshape(recipe.minibatches, -1, *x.shape[1:]), batch
        )
        carry, _ = jax.lax.scan(minibatch, carry, parts)
        return carry, None

    first = (flat, memory.moments, jnp.array(False), jnp.float32(0.0))
    keys = jax.random.split(key, recipe.n_epochs)
    (flat, moments, _, apart), _ = jax.lax.scan(epoch, first, keys)
    coef = memory.kl_coef * jnp.where(apart > 2.0 * recipe.target_kl, 1.5, 1.0)
    coef = coef * jnp.where(apart < 0.5 * recipe.target_kl, 0.5, 1.0)
    least = 1e-4 if recipe.kl_coef > 0.0 else 0.0
    return unravel(flat), Memory(moments, returns, jnp.clip(coef, least, 1e2))


def _rows(
    space: Discrete | Box,
    recipe: EpisodicPPORecipe,
    weights: Weights,
    returns: Returns,
    lived: Episodes,
    key: jax.Array,
) -> tuple[Batch, Returns]:
    """A random `recipe.rows` of the decisions; fewer are filled up with rows of weight 0."""
    advantage, target, returns = advantages(recipe, returns, lived)
    draw = jax.random.uniform(key, lived.acting.shape)
    found, rows = jax.lax.top_k(jnp.where(lived.acting, draw, -1.0).reshape(-1), recipe.rows)
    weight = (found >= 0.0).astype(jnp.float32)
    columns = (lived.row, lived.outputs, lived.action, advantage, target, lived.value)
    row, outputs, action, advantage, target, value = (
        x.reshape(-1, *x.shape[3:])[rows] for x in columns
    )
    obs = lived.obs[row]
    if recipe.normalize_advantage:
        advantage = standard(advantage, weight)
    log_prob = networks.log_prob(outputs, weights.log_std, action, space)
    return Batch(obs, outputs, action, log_prob, advantage, target, value, weight), returns


def _optimizer(recipe: EpisodicPPORecipe) -> optax.GradientTransformation:
    return optax.chain(
        optax.clip_by_global_norm(recipe.max_grad_norm), optax.adam(recipe.learning_rate)
    )
