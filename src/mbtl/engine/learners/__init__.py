"""Trainers in jax, vectorised over contexts and seeds; importing this starts jax (see `flags`).

world = Solo(CartPole())
params = stack_params(world, [derive(...) for each context], visible)
training = train(world, recipe_named("PPO", "fast"), seeds, params, 200_000)
returns = evaluate(world, actor_of(training.best), params, episode_seeds)
policies = export_policies(world, training.best)
"""

from __future__ import annotations

from mbtl.engine.worlds import flags as flags  # isort: skip  # first: it starts jax
from mbtl.engine.learners.algorithms import recipe_named
from mbtl.engine.learners.blocks import Block, from_arrays, to_arrays
from mbtl.engine.learners.episodic.episodes import Actor, actor_of, import_actor
from mbtl.engine.learners.episodic.learning import episodes_met
from mbtl.engine.learners.evaluation import evaluate, joined, measured, on_cpu, taken
from mbtl.engine.learners.export import export_policies, taught
from mbtl.engine.learners.growing import Growing, stage
from mbtl.engine.learners.loop import in_sets, start, train
from mbtl.engine.learners.recipes import (
    A2CRecipe,
    DQNRecipe,
    MultiTaskRecipe,
    PPORecipe,
    as_wide_as,
    multitask_recipe,
    of_several,
    own_recipe,
)
from mbtl.engine.learners.saving import SavedTraining, taking_over

__all__ = [
    "A2CRecipe",
    "Actor",
    "Block",
    "DQNRecipe",
    "Growing",
    "MultiTaskRecipe",
    "PPORecipe",
    "SavedTraining",
    "actor_of",
    "as_wide_as",
    "episodes_met",
    "evaluate",
    "export_policies",
    "from_arrays",
    "import_actor",
    "in_sets",
    "joined",
    "measured",
    "multitask_recipe",
    "of_several",
    "on_cpu",
    "own_recipe",
    "recipe_named",
    "stage",
    "start",
    "taken",
    "taking_over",
    "taught",
    "to_arrays",
    "train",
]
