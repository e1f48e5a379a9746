"""PPO on whole episodes of agents that come and go, in the form of cmdp-spec, 6.3.

The loss of `mbtl.engine.learners.ppo` with

    + kl_coef KL(old, new), an adaptive penalty
    max((V - R)^2, (V_old + clip(V - V_old, +- value_clip) - R)^2) in place of (V - R)^2

and an end of the update as soon as a minibatch is too far from the policy that played. Only moments
at which an agent decided are rows: a random `rows` of them, as most places are empty most of the
time.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree

from mbtl.engine.learners import networks
from mbtl.engine.learners.clock import Clock
from mbtl.engine.learners.descent import adam, standard
from mbtl.engine.learners.episodic.episodes import Episodes
from mbtl.engine.learners.episodic.returns import Memory, Returns, advantages
from mbtl.engine.learners.networks import Weights
from mbtl.engine.learners.ppo import Batch, Limits, descend
from mbtl.engine.learners.recipes import EpisodicPPORecipe
from mbtl.engine.worlds.environments import Box, Discrete


def start(recipe: EpisodicPPORecipe, weights: Weights) -> Memory:
    """Before the first update."""
    moments = adam(recipe).init(ravel_pytree(weights)[0])
    return Memory(moments, Returns.empty(), jnp.float32(recipe.kl_coef))


def learn(
    action: Discrete | Box,
    recipe: EpisodicPPORecipe,
    weights: Weights,
    memory: Memory,
    lived: Episodes,
    clock: Clock,
) -> tuple[Weights, Memory]:
    """The gradient steps of one update; arguments as in `trpo.learn`."""
    batch, returns = rows_of(action, recipe, weights, memory.returns, lived, clock.key)
    limits = Limits(weights.log_std, memory.kl_coef, recipe.target_kl, recipe.value_clip)
    rate = clock.rate
    weights, moments, apart = descend(
        action, recipe, weights, memory.moments, batch, clock.key, rate, limits
    )
    coef = memory.kl_coef * jnp.where(apart > 2.0 * recipe.target_kl, 1.5, 1.0)
    coef = coef * jnp.where(apart < 0.5 * recipe.target_kl, 0.5, 1.0)
    least = 1e-4 if recipe.kl_coef > 0.0 else 0.0
    return weights, Memory(moments, returns, jnp.clip(coef, least, 1e2))


def rows_of(
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
    draw = jnp.where(lived.acting, draw, -1.0).reshape(-1)
    few = max(0, recipe.rows - draw.size)
    found, rows = jax.lax.top_k(jnp.pad(draw, (0, few), constant_values=-1.0), recipe.rows)
    weight = (found >= 0.0).astype(jnp.float32)
    columns = (lived.row, lived.outputs, lived.action, advantage, target, lived.value)
    row, outputs, action, advantage, target, value = (
        x.reshape(-1, *x.shape[3:])[rows] for x in columns
    )
    if recipe.normalize_advantage:
        advantage = standard(advantage, weight)
    log_prob = networks.log_prob(outputs, weights.log_std, action, space)
    obs = lived.obs[row]
    return Batch(obs, action, log_prob, advantage, target, outputs, value, weight), returns
