"""Which module learns by which recipe; a new algorithm is one file and one line here.

An algorithm is a module of pure functions on the state of training, vectorised by `jax.vmap`:

    init(env, recipe, seeds, params, weights) -> State      P policies, leading axis
    update(env, recipe, state, params, clock)               one policy, one update further

Its `State` holds the networks as `weights: networks.Weights`, whose `actor` is what acts. The clock
is the same for all policies: what depends on it alone is computed once for all of them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

from mbtl.training.jax import a2c, dqn, ppo
from mbtl.training.jax.clock import Clock
from mbtl.training.jax.environments import Environment, Tree
from mbtl.training.jax.multitask import round_robin
from mbtl.training.jax.recipes import A2CRecipe, DQNRecipe, MultiTaskRecipe, PPORecipe, Recipe


class Algorithm(Protocol):
    """What a module of an algorithm offers."""

    def init(
        self,
        env: Environment,
        recipe: Any,
        seeds: Sequence[int],
        params: Tree,
        weights: Any = None,
    ) -> Any:
        """All policies before their first update, leading axis; fresh unless given weights."""
        ...

    def update(
        self,
        env: Environment,
        recipe: Any,
        state: Any,
        params: Tree,
        clock: Clock,
    ) -> Any:
        """One policy after `recipe.steps_per_update` more steps."""
        ...


_MODULES: Mapping[type, Algorithm] = {
    PPORecipe: ppo,
    A2CRecipe: a2c,
    DQNRecipe: dqn,
    MultiTaskRecipe: round_robin,
}


def algorithm_of(recipe: Recipe) -> Algorithm:
    """The module that learns by this kind of recipe."""
    return _MODULES[type(recipe)]
