"""First weights of multi-task policies; they learn as `ppo` does, in contexts that take turns."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from mbtl.training.jax import networks
from mbtl.training.jax.multitask import moore, paco
from mbtl.training.jax.recipes import MultiTaskRecipe
from mbtl.worlds.environments import Tree
from mbtl.worlds.world import Solo


def first_weights(world: Solo, recipe: MultiTaskRecipe, seeds: Sequence[int], params: Tree) -> Any:
    """Fresh ones, leading axis.

    Args:
        world: the dynamics.
        recipe: hyper-parameters.
        seeds: one per policy, 32 bits.
        params: (policies, N, ...) contexts, with their places where the method wants them.
    """
    n_contexts, n_visible = params.visible.shape[1:]
    n_inputs = world.n_features + n_visible - recipe.has_vectors  # no place for the layers
    make = _FIRST[recipe.method]
    return networks.stack([make(world, recipe, seed, n_contexts, n_inputs) for seed in seeds])


def _ordinary(
    world: Solo, recipe: MultiTaskRecipe, seed: int, n_contexts: int, n_inputs: int
) -> networks.Weights:
    ppo = recipe.ppo
    return networks.init_weights(seed, n_inputs, world.action, ppo.hidden, ppo.log_std)


_FIRST: Mapping[str, Callable[[Solo, MultiTaskRecipe, int, int, int], Any]] = {
    "ppo": _ordinary,
    "paco": paco.init_weights,
    "moore": moore.init_weights,
}
