"""Trainers in jax, vectorised over contexts and seeds; importing this starts jax (see `flags`).

env = CartPole()
params = stack_params(env, [derive(...) for each context], visible)
training = train(env, recipe_named("PPO", "fast"), seeds, params, timesteps=200_000)
returns = evaluate(env, training.best.actor, params, episode_noise(env, episode_seeds))
policies = export_policies(env, training.best)
"""

from __future__ import annotations

from mbtl.training.jax import flags as flags  # isort: skip  # first: it starts jax
from mbtl.training.jax.blocks import Block, Training, from_arrays, to_arrays, weights_of
from mbtl.training.jax.cartpole import CartPole
from mbtl.training.jax.environments import Environment, stack_params
from mbtl.training.jax.evaluation import episode_noise, evaluate, on_cpu
from mbtl.training.jax.export import export_policies, import_actors
from mbtl.training.jax.loop import start, train
from mbtl.training.jax.multitask.run import MultiTaskRun, multitask_settings, run_multitask
from mbtl.training.jax.multitask.training import (
    evaluate_multitask,
    start_multitask,
    train_multitask,
)
from mbtl.training.jax.pendulum import Pendulum
from mbtl.training.jax.recipes import (
    RECIPES,
    A2CRecipe,
    DQNRecipe,
    MultiTaskRecipe,
    PPORecipe,
    Recipe,
    multitask_recipe,
    recipe_named,
)
from mbtl.training.jax.references import reference_returns
from mbtl.training.jax.saving import SavedTraining

__all__ = [
    "RECIPES",
    "A2CRecipe",
    "Block",
    "CartPole",
    "DQNRecipe",
    "Environment",
    "MultiTaskRecipe",
    "MultiTaskRun",
    "PPORecipe",
    "Pendulum",
    "Recipe",
    "SavedTraining",
    "Training",
    "episode_noise",
    "evaluate",
    "evaluate_multitask",
    "export_policies",
    "from_arrays",
    "import_actors",
    "multitask_recipe",
    "multitask_settings",
    "on_cpu",
    "recipe_named",
    "reference_returns",
    "run_multitask",
    "stack_params",
    "start",
    "start_multitask",
    "to_arrays",
    "train",
    "train_multitask",
    "weights_of",
]
