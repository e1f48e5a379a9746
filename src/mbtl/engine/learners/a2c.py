"""Advantage actor-critic of one policy, written to be vectorised over many with `jax.vmap`.

State in, state out, as in `ppo`: short rollouts, one gradient step on each with every transition
seen once, RMSprop. Semantics are those of Stable-Baselines3. An update is many rollouts, so that
random numbers are drawn for all of them together.
"""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
import optax

from mbtl.engine.learners import networks
from mbtl.engine.learners.clock import Clock
from mbtl.engine.learners.descent import clipped, descended
from mbtl.engine.learners.networks import Weights
from mbtl.engine.learners.recipes import A2CRecipe
from mbtl.engine.learners.rollout import Noise, Rollout, State, advantages, draw, play, start
from mbtl.engine.worlds.environments import Tree
from mbtl.engine.worlds.world import Solo


def update(world: Solo, recipe: A2CRecipe, state: State, params: Tree, clock: Clock) -> State:
    """`recipe.rollouts_per_update` rollouts with a gradient step on each."""
    shape = (recipe.rollouts_per_update, recipe.n_steps, recipe.n_envs)
    key, noise = draw(world, state.key, shape)
    rate = clock.rate

    def one(state: State, drawn: Noise) -> tuple[State, None]:
        state, rollout = play(world, recipe, state, params, drawn)
        return learn(world, recipe, state, rollout, rate), None

    state, _ = jax.lax.scan(one, state._replace(key=key), noise)
    return state


def learn(
    world: Solo, recipe: A2CRecipe, state: State, rollout: Rollout, scale: jax.Array
) -> State:
    """One gradient step, `scale` times the recipe's learning rate."""
    gradient = jax.grad(loss, argnums=2)(world, recipe, state.weights, rollout)
    weights, moments = descended(optimizer(recipe), state.weights, gradient, state.optimizer, scale)
    return state._replace(weights=weights, optimizer=moments)


def loss(world: Solo, recipe: A2CRecipe, weights: Weights, rollout: Rollout) -> jax.Array:
    """-A log pi(a|s) + value_coef x (A + V(s)_old - V(s))^2 - entropy_coef x entropy, on average.

    The advantage A and the target A + V_old are constants of the gradient.
    """
    outputs = networks.apply(weights.actor, rollout.obs, recipe.activation)
    value = networks.apply(weights.critic, rollout.obs, recipe.activation)[..., 0]
    advantage = jax.lax.stop_gradient(advantages(recipe, weights.critic, rollout, value))
    target = advantage + jax.lax.stop_gradient(value)
    if recipe.normalize_advantage:
        advantage = (advantage - advantage.mean()) / (advantage.std(ddof=1) + 1e-8)
    log_prob = networks.log_prob(outputs, weights.log_std, rollout.action, world.action)
    total = -(advantage * log_prob).mean()
    total += recipe.value_coef * jnp.square(target - value).mean()
    if recipe.entropy_coef:
        spread = networks.entropy(outputs, weights.log_std, world.action)
        total -= recipe.entropy_coef * spread.mean()
    return total


def optimizer(recipe: A2CRecipe) -> optax.GradientTransformation:
    """RMSprop, `clipped`.

    square <- decay square + (1 - decay) g^2, and the step is
        -lr g / (sqrt(square) + eps), square from 0 on      as in PyTorch
        -lr g / sqrt(square + eps),   square from 1 on      as in TensorFlow: smaller, steadier
    """
    tensorflow = recipe.rms_like_tensorflow
    first = 1.0 if tensorflow else 0.0
    rms = optax.scale_by_rms(recipe.rms_decay, recipe.rms_eps, first, eps_in_sqrt=tensorflow)
    return clipped(recipe, rms)


init = partial(start, optimizer)
