"""Gradient steps of one policy, on all its weights as one vector: few large operations."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import optax
from jax.flatten_util import ravel_pytree

from mbtl.training.jax.episodic.recipes import EpisodicPPORecipe
from mbtl.training.jax.recipes import DQNRecipe, PPORecipe
from mbtl.worlds.environments import Tree


def adam(recipe: PPORecipe | DQNRecipe | EpisodicPPORecipe) -> optax.GradientTransformation:
    """Adam after clipping the norm of one policy's gradient; the step is -lr times Adam's."""
    return optax.chain(
        optax.clip_by_global_norm(recipe.max_grad_norm),
        optax.scale_by_adam(eps=recipe.adam_eps),
        optax.scale(-recipe.learning_rate),
    )


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
