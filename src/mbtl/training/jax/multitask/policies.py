"""Multi-task policies learn as `ppo` does, from copies whose contexts take turns (`rollout`)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from mbtl.training.jax import networks, ppo
from mbtl.training.jax.clock import Clock
from mbtl.training.jax.multitask import moore, paco
from mbtl.training.jax.recipes import MultiTaskRecipe
from mbtl.training.jax.rollout import State
from mbtl.worlds.environments import Tree
from mbtl.worlds.world import Solo


def init(
    world: Solo,
    recipe: MultiTaskRecipe,
    seeds: Sequence[int],
    params: Tree,
    weights: Any = None,
) -> State:
    """All policies before their first update.

    Args:
        world: the dynamics.
        recipe: hyper-parameters.
        seeds: one per policy, 32 bits; decides its whole training.
        params: (policies, N, ...) contexts, with their places where the method wants them.
        weights: to begin from, leading axis; None for fresh ones.
    """
    if weights is None:
        n_contexts, n_visible = params.visible.shape[1:]
        n_inputs = world.n_features + n_visible - recipe.has_vectors  # no place for the layers
        make = _INITIAL[recipe.method]
        each = [make(world, recipe, seed, n_contexts, n_inputs) for seed in seeds]
        weights = networks.stack(each)
    return ppo.init(world, recipe.ppo, seeds, params, weights)


def update(world: Solo, recipe: MultiTaskRecipe, state: State, params: Tree, clock: Clock) -> State:
    """One rollout and the gradient steps on it; arguments as in `ppo.update`, N contexts."""
    return ppo.update(world, recipe.ppo, state, params, clock)


def _ordinary(
    world: Solo, recipe: MultiTaskRecipe, seed: int, n_contexts: int, n_inputs: int
) -> networks.Weights:
    ppo = recipe.ppo
    return networks.init_weights(seed, n_inputs, world.action, ppo.hidden, ppo.log_std)


_INITIAL: Mapping[str, Callable[[Solo, MultiTaskRecipe, int, int, int], Any]] = {
    "ppo": _ordinary,
    "paco": paco.init_weights,
    "moore": moore.init_weights,
}
