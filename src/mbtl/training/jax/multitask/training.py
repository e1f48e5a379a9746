"""Training and evaluating multi-task policies with the loop and the evaluation of all others.

Copies of a world take turns in the contexts (`rollout`); whole episodes are each in a context drawn
for it (`episodic.learning`).

Notation (shapes): S policies (seeds), N contexts, E episodes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np
from numpy.typing import ArrayLike

from mbtl.arrays import Array
from mbtl.errors import InvalidInput
from mbtl.training.jax import loop
from mbtl.training.jax.blocks import Training
from mbtl.training.jax.episodic.episodes import actor_of
from mbtl.training.jax.episodic.recipes import TwinRecipe
from mbtl.training.jax.evaluation import evaluate
from mbtl.training.jax.multitask.table import with_place
from mbtl.training.jax.recipes import MultiTaskRecipe
from mbtl.worlds.environments import Tree
from mbtl.worlds.world import World

CHECKPOINT_EPISODES = 2
"""Per context; over a hundred contexts that is twenty times what a single-task policy plays."""


def start_multitask(
    world: World, recipe: MultiTaskRecipe | TwinRecipe, seeds: Sequence[int], params: Tree
) -> Training:
    """Trainings before their first update, e.g. as the template of `from_arrays`."""
    return loop.start(world, recipe, seeds, _copies(recipe, params, len(seeds)))


def train_multitask(
    world: World,
    recipe: MultiTaskRecipe | TwinRecipe,
    seeds: Sequence[int],
    params: Tree,
    timesteps: int,
    *,
    checkpoint_episodes: int = CHECKPOINT_EPISODES,
    **options: Any,
) -> Training:
    """Train S policies, each on all of N contexts: `loop.train`, and its `options`.

    The best checkpoint has the largest mean return over all contexts; returns of a `Training` are
    such means. `timesteps` are over all contexts together, `checkpoint_episodes` of each context.

    Raises:
        InvalidInput: there are no seeds or contexts, or a number is below 1.
        TrainingFailed: weights are no longer finite.
    """
    return loop.train(
        world,
        recipe,
        seeds,
        _copies(recipe, params, len(seeds)),
        timesteps,
        checkpoint_episodes=checkpoint_episodes * len(params.visible),
        **options,
    )


def evaluate_multitask(
    world: World,
    recipe: MultiTaskRecipe,
    weights: Any,
    params: Tree,
    seeds: Sequence[int],
    *,
    places: ArrayLike | None = None,
    on_block: Callable[[int, int], None] | None = None,
) -> Array:
    """Undiscounted returns of deterministic episodes, (S, C, E); see `evaluate`.

    `places` are (C,) positions of the contexts on the axis in steps of the training's grid, e.g.
    0.5 halfway between the first two; None where they are that grid.

    Raises:
        InvalidInput: there are no policies, contexts or episodes.
    """
    contexts, actor = _seen(recipe, params, places), actor_of(weights)
    activation = recipe.activation
    return evaluate(world, actor, contexts, seeds, activation=activation, on_block=on_block)


def _seen(
    recipe: MultiTaskRecipe | TwinRecipe, params: Tree, places: ArrayLike | None = None
) -> Tree:
    """Contexts as the networks see them: those with a vector per context need their places."""
    needs = isinstance(recipe, MultiTaskRecipe) and recipe.has_vectors
    return with_place(params, places) if needs else params


def _copies(recipe: MultiTaskRecipe | TwinRecipe, params: Tree, n_seeds: int) -> Tree:
    """(S, N, ...): all contexts for every policy."""
    if len(params.visible) == 0 or n_seeds == 0:
        raise InvalidInput(
            "multi-task training needs at least one seed and context, "
            f"got {n_seeds} and {len(params.visible)}"
        )
    seen = _seen(recipe, params)
    return jax.tree.map(lambda x: np.broadcast_to(x, (n_seeds, *np.shape(x))), seen)
