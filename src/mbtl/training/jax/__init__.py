"""Trainers in jax, vectorised over contexts and seeds; importing this starts jax (see `flags`).

world = Solo(CartPole())
params = stack_params(world, [derive(...) for each context], visible)
training = train(world, recipe_named("PPO", "fast"), seeds, params, 200_000)
returns = evaluate(world, actor_of(training.best), params, episode_seeds)
policies = export_policies(world, training.best)
"""

from __future__ import annotations

from mbtl.worlds import flags as flags  # isort: skip  # first: it starts jax
from mbtl.training.jax.algorithms import recipe_named
from mbtl.training.jax.blocks import Block, Training, from_arrays, to_arrays, weights_of
from mbtl.training.jax.episodic.episodes import actor_of, import_actor
from mbtl.training.jax.episodic.learning import episodes_met
from mbtl.training.jax.evaluation import (
    evaluate,
    evaluate_multitask,
    measured,
    on_cpu,
    reference_returns,
)
from mbtl.training.jax.export import export_policies, taught
from mbtl.training.jax.loop import start, start_multitask, train, train_multitask
from mbtl.training.jax.multitask.run import (
    Judged,
    MultiTaskRun,
    multitask_settings,
    run_multitask,
)
from mbtl.training.jax.recipes import (
    MULTI_TASK,
    RECIPES,
    A2CRecipe,
    DQNRecipe,
    MultiTaskRecipe,
    PPORecipe,
    Recipe,
    multitask_recipe,
    spread_recipe,
)
from mbtl.training.jax.saving import SavedTraining
from mbtl.worlds import counted
from mbtl.worlds.cartpole import CartPole
from mbtl.worlds.environments import Box, Discrete, Environment, Step
from mbtl.worlds.hosted import hosted
from mbtl.worlds.pendulum import Pendulum
from mbtl.worlds.world import Solo, World, context_of, stack_params

__all__ = [
    "MULTI_TASK",
    "RECIPES",
    "A2CRecipe",
    "Block",
    "Box",
    "CartPole",
    "DQNRecipe",
    "Discrete",
    "Environment",
    "Judged",
    "MultiTaskRecipe",
    "MultiTaskRun",
    "PPORecipe",
    "Pendulum",
    "Recipe",
    "SavedTraining",
    "Solo",
    "Step",
    "Training",
    "World",
    "actor_of",
    "context_of",
    "counted",
    "episodes_met",
    "evaluate",
    "evaluate_multitask",
    "export_policies",
    "from_arrays",
    "hosted",
    "import_actor",
    "measured",
    "multitask_recipe",
    "multitask_settings",
    "on_cpu",
    "recipe_named",
    "reference_returns",
    "run_multitask",
    "spread_recipe",
    "stack_params",
    "start",
    "start_multitask",
    "taught",
    "to_arrays",
    "train",
    "train_multitask",
    "weights_of",
]
