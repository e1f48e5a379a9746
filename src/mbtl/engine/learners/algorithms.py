"""Which module learns by which recipe; a new algorithm is one file and one line here.

An algorithm is a module of pure functions. Those that learn from copies which start again
(`rollout`) are of one policy, vectorised by `jax.vmap`:

    init(world, recipe, seeds, params, weights) -> State      P policies, leading axis
    update(world, recipe, state, params, clock)               one policy, one update further

Multi-task policies are other networks that learn by the same PPO. Those that learn from whole
episodes (`episodic.learning`), in which agents come and go:

    start(recipe, weights) -> Memory                                    of one policy
    learn(action, recipe, weights, memory, lived, clock)               likewise

The state holds the networks as `weights`, whose `actor` is what acts. The clock is the same for all
policies: what depends on it alone is computed once for all of them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import jax

from mbtl.engine.learners import a2c, dqn, networks, ppo, recipes
from mbtl.engine.learners.clock import Clock
from mbtl.engine.learners.episodic import learning
from mbtl.engine.learners.multitask import moore, paco
from mbtl.engine.worlds.environments import Length, Tree
from mbtl.engine.worlds.world import Solo, World
from mbtl.errors import InvalidInput, check_known

AnyRecipe = recipes.Recipe | recipes.TwinRecipe

_WITH_COPIES: Mapping[type, Any] = {
    recipes.PPORecipe: ppo,
    recipes.MultiTaskRecipe: ppo,
    recipes.A2CRecipe: a2c,
    recipes.DQNRecipe: dqn,
}
_WITH_VECTORS: Mapping[str, Any] = {"paco": paco, "moore": moore}


def recipe_named(algorithm: str, name: str, unit: str = "timesteps") -> AnyRecipe:
    """The recipe called `name`: of `RECIPES[algorithm]`, or by episodes of `TWIN_RECIPES`.

    Raises:
        UnknownName: there is none.
    """
    known: Mapping[str, Mapping[str, AnyRecipe]]
    known = recipes.TWIN_RECIPES if unit == "episodes" else recipes.RECIPES
    check_known("algorithm with recipes", algorithm, known)
    check_known(f"{algorithm} recipe", name, known[algorithm])
    return known[algorithm][name]


def init(
    world: World, recipe: AnyRecipe, seeds: Sequence[int], params: Tree, weights: Any = None
) -> Any:
    """P policies before their first update, leading axis; fresh unless given weights.

    Raises:
        InvalidInput: this world cannot start single simulations again.
    """
    if isinstance(recipe, recipes.TwinRecipe):
        return learning.init(world, recipe, seeds, params, weights)
    if not isinstance(world, Solo):
        raise InvalidInput(
            f"{type(recipe).__name__} needs simulations that start again one by one, got "
            f"{type(world).__name__}; learn from whole episodes, e.g. by TRPORecipe"
        )
    if isinstance(recipe, recipes.MultiTaskRecipe) and recipe.has_vectors and weights is None:
        n_contexts, n_visible = params.visible.shape[1:]
        shapes = n_contexts, world.n_features + n_visible - 1  # no place for the layers
        make = _WITH_VECTORS[recipe.method].init_weights
        weights = networks.stack([make(world, recipe, seed, *shapes) for seed in seeds])
    return _WITH_COPIES[type(recipe)].init(world, recipe, seeds, params, weights)


def update(
    world: World, recipe: AnyRecipe, decisions: Length, state: Any, params: Tree, clock: Clock
) -> Any:
    """P policies after `recipe.update_length` more steps or episodes.

    World, recipe and `decisions`, of an episode at most or in beats, are static. Parameters are of
    one context, (P, ...), or of N for each policy, (P, N, ...).
    """
    if isinstance(recipe, recipes.TwinRecipe):
        return learning.update(world, recipe, decisions, state, params, clock)
    each = partial(_WITH_COPIES[type(recipe)].update, world, recipe)
    return jax.vmap(each, in_axes=(0, 0, None))(state, params, clock)
