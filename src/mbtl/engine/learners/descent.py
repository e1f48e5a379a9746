"""What gradient steps of all algorithms share: means over the rows that count, and Adam's step.

A step is one of all weights of a policy as one vector: few large operations.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import optax
from jax.flatten_util import ravel_pytree

from mbtl.engine.learners.recipes import A2CRecipe, AnyDQN, AnyPPO
from mbtl.engine.worlds.environments import Tree


def clipped(
    recipe: A2CRecipe | AnyDQN | AnyPPO, step: optax.GradientTransformation
) -> optax.GradientTransformation:
    """A step after clipping the norm of one policy's gradient, times -lr."""
    clip, rate = optax.clip_by_global_norm(recipe.max_grad_norm), optax.scale(-recipe.learning_rate)
    return optax.chain(clip, step, rate)


def adam(recipe: AnyDQN | AnyPPO) -> optax.GradientTransformation:
    """Adam, `clipped`."""
    return clipped(recipe, optax.scale_by_adam(eps=recipe.adam_eps))


def descended(
    optimizer: optax.GradientTransformation,
    weights: Tree,
    gradient: Tree,
    moments: Tree,
    scale: jax.Array,
) -> tuple[Any, Tree]:
    """Weights and the optimiser's memory after `scale` times its step."""
    flat, unravel = ravel_pytree(gradient)
    steps, moments = optimizer.update(flat, moments)
    return jax.tree.map(jnp.add, weights, unravel(scale * steps)), moments


def mean_of(x: jax.Array, weight: jax.Array) -> jax.Array:
    """Mean of `x` weighted by `weight`; 0 without any."""
    return (x * weight).sum() / jnp.maximum(weight.sum(), 1.0)


def standard(x: jax.Array, weight: jax.Array) -> jax.Array:
    """Mean 0 and standard deviation 1 over the rows that count."""
    centred = x - mean_of(x, weight)
    return centred / (jnp.sqrt(mean_of(jnp.square(centred), weight)) + 1e-8)
