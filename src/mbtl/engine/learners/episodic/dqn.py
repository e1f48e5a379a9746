"""Deep Q-learning on whole episodes of agents that come and go, in the form of cmdp-spec, 5.

Episodes are played epsilon-greedily, their decisions enter a ring, and then minibatches of all that
is in it are learnt from, by the loss of `learners.dqn`. What an agent was shown after its last
decision is not known: where a time limit cuts its life off, that decision is left out.

From the spec differ, as in our recipes for SUMO: a target network, the Huber loss, clipped
gradients, and lives that end.

Notation (shapes): D decisions, E episodes, A agents, f features; N decisions in the ring, G
minibatches of B.
"""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree

from mbtl.engine.learners.clock import Clock
from mbtl.engine.learners.descent import adam
from mbtl.engine.learners.dqn import descend, fallen, unpacked
from mbtl.engine.learners.episodic.episodes import Episodes
from mbtl.engine.learners.episodic.returns import Memory, Returns
from mbtl.engine.learners.networks import Network, Weights
from mbtl.engine.learners.recipes import EpisodicDQNRecipe
from mbtl.engine.worlds.environments import Box, Discrete, Tree


def start(recipe: EpisodicDQNRecipe, weights: Weights) -> Memory:
    """Before the first update."""
    moments = adam(recipe).init(ravel_pytree(weights.actor)[0])
    width = 2 * len(weights.actor[0][0]) + 3
    ring = jnp.zeros((recipe.buffer_size, width))
    return Memory(moments, Returns.empty(), replay=ring, kept=jnp.int32(0))


def explored(recipe: EpisodicDQNRecipe, progress: jax.Array, values: jax.Array) -> jax.Array:
    """(..., n) action values -> logits of epsilon-greedy choices after a share of the training."""
    epsilon = fallen(recipe, progress / recipe.exploration_fraction)
    n = values.shape[-1]
    greedy = jax.nn.one_hot(jnp.argmax(values, axis=-1), n)
    return jnp.log(epsilon / n + (1.0 - epsilon) * greedy)


def learn(
    action: Discrete | Box,
    recipe: EpisodicDQNRecipe,
    weights: Weights,
    memory: Memory,
    lived: Episodes,
    clock: Clock,
) -> tuple[Weights, Memory]:
    """The gradient steps of one update; arguments as in `trpo.learn`."""
    returns = memory.returns.updated(recipe, lived)
    replay, kept = entered(memory, lived)
    filled, learnt = jnp.minimum(kept, recipe.buffer_size), kept > 0
    draw = jax.random.uniform(clock.key, (recipe.gradient_steps, recipe.batch_size))
    rate, target = clock.rate, weights.actor

    def one(carry: tuple[Network, Tree], draw: jax.Array) -> tuple[tuple[Network, Tree], None]:
        batch = unpacked(replay[jnp.floor(draw * filled).astype(jnp.int32)])
        batch = batch._replace(reward=returns.scaled(recipe, batch.reward))
        return descend(recipe, target, batch, rate, *carry), None

    before = (target, memory.moments)
    after, _ = jax.lax.scan(one, before, draw)
    network, moments = jax.tree.map(partial(jnp.where, learnt), after, before)
    whole = jnp.where(jnp.isfinite(lived.score).all(), 1.0, jnp.nan)  # a simulation may be lost
    network = jax.tree.map(lambda x: x * whole, network)
    return weights._replace(actor=network), Memory(moments, returns, replay=replay, kept=kept)


def entered(memory: Memory, lived: Episodes) -> tuple[jax.Array, jax.Array]:
    """The ring with the decisions of (D, E, A) agents that are known to their end, and its count.

    The oldest make room.
    """
    obs = lived.obs[lived.row]
    after = jnp.concatenate([obs[1:], obs[-1:]])
    goes_on = jnp.concatenate([lived.acting[1:], jnp.zeros_like(lived.acting[:1])])
    done = lived.done.at[-1].set(lived.done[-1] | ~lived.last_acting)
    known = lived.acting & (done | goes_on)
    scalars = jnp.stack([lived.action, lived.reward, done], axis=-1)
    rows = jnp.concatenate([obs, after, scalars], axis=-1).reshape(known.size, -1)
    size, rank = len(memory.replay), jnp.cumsum(known)
    latest = known.reshape(-1) & (rank > rank[-1] - size)
    place = jnp.where(latest, (memory.kept + rank - 1) % size, size)
    return memory.replay.at[place].set(rows, mode="drop"), memory.kept + rank[-1]
