"""Policies that learn from whole episodes, in which agents come and go."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from mbtl.engine.learners import networks
from mbtl.engine.learners.clock import Clock
from mbtl.engine.learners.episodic import dqn, ppo, trpo
from mbtl.engine.learners.episodic.episodes import actor_of, record
from mbtl.engine.learners.networks import Weights
from mbtl.engine.learners.recipes import (
    EpisodicActorCritic,
    EpisodicDQNRecipe,
    EpisodicPPORecipe,
    TRPORecipe,
    TwinRecipe,
)
from mbtl.engine.worlds import random
from mbtl.engine.worlds.environments import Length, Tree
from mbtl.engine.worlds.world import World, of_simulations
from mbtl.errors import InvalidInput

_ALGORITHMS: Mapping[type, Any] = {TRPORecipe: trpo, EpisodicPPORecipe: ppo, EpisodicDQNRecipe: dqn}
"""Modules with `start(recipe, weights)` and `learn(...)`, of one policy."""

# streams of random numbers: seeds of training episodes, and their contexts where there are several
_EPISODE, _CONTEXT = 1 << 21, 1 << 22


class State(NamedTuple):
    """P policies between two updates, leading axis; the memory is the algorithm's."""

    weights: Weights
    memory: Tree
    seed: jax.Array


def init(
    world: World, recipe: TwinRecipe, seeds: Sequence[int], params: Tree, weights: Any = None
) -> State:
    """P policies before their first update; fresh unless given weights."""
    weights = networks.begun(weights, partial(_fresh, world, recipe, seeds, params))
    start = jax.vmap(partial(_ALGORITHMS[type(recipe)].start, recipe))
    memory = jax.jit(start)(weights)  # one program, not one for every array
    return State(weights, memory, jnp.asarray(np.array(seeds, dtype=np.uint32)))


def _fresh(world: World, recipe: TwinRecipe, seeds: Sequence[int], params: Tree) -> list[Weights]:
    """Policies that act as the recipe's `begin` says; what else they see is not looked at.

    Raises:
        InvalidInput: this world has no such rule, or for other networks.
    """
    each = networks.fresh(world, recipe, seeds, params)
    if not isinstance(recipe, EpisodicActorCritic) or not recipe.begin:
        return each
    if not hasattr(world, "rule"):
        raise InvalidInput(
            f"begin={recipe.begin!r} needs a world that knows rules, got {type(world).__name__}"
        )
    (matrix, bias), *rest = world.rule(recipe.begin)
    more = len(each[0].actor[0][0]) - len(matrix)
    actor = ((np.pad(matrix, ((0, more), (0, 0))), bias), *rest)
    shapes = [[np.shape(x) for x in jax.tree.leaves(net)] for net in (actor, each[0].actor)]
    if shapes[0] != shapes[1] or recipe.activation != "tanh":
        raise InvalidInput(
            f"the rule {recipe.begin!r} is a network of tanh with layers {shapes[0]}, got a recipe "
            f"for {recipe.activation} with {shapes[1]}"
        )
    return [one._replace(actor=actor) for one in each]


def update(
    world: World, recipe: TwinRecipe, decisions: Length, state: State, params: Tree, clock: Clock
) -> State:
    """Live through `n_episodes` of each policy and learn from them; args as `algorithms.update`."""
    seeds = random.bits(state.seed, _EPISODE, clock.number, recipe.n_episodes).T
    if params.visible.ndim == 3:
        met = contexts_met(state.seed, clock.number, params.visible.shape[1], recipe.n_episodes)
        params = jax.tree.map(lambda x: jax.vmap(jnp.take, (0, 0, None))(x, met, 0), params)
    every = of_simulations(params, recipe.n_episodes)
    actor = actor_of(state.weights)
    how: dict[str, Any] = {"hold": recipe.hold}
    if isinstance(recipe, EpisodicDQNRecipe):
        how["chosen"] = partial(dqn.explored, recipe, clock.progress)
    lived = record(world, recipe.activation, decisions, actor, seeds, every, **how)
    learn = partial(_ALGORITHMS[type(recipe)].learn, world.action, recipe)
    policies = jax.vmap(learn, in_axes=(0, 0, 0, None))
    weights, memory = policies(state.weights, state.memory, lived, clock)
    return State(weights, memory, state.seed)


def contexts_met(seed: jax.Array, number: jax.Array, contexts: int, count: int) -> jax.Array:
    """(P, count) of N contexts in which policies are in an update, one for each of their episodes.

    They are drawn uniformly, without repetition while there are any.
    """
    rounds = math.ceil(count / contexts)
    draw = random.bits(seed, _CONTEXT, number, rounds * contexts).T
    return draw.reshape(-1, rounds, contexts).argsort(axis=-1).reshape(len(seed), -1)[:, :count]


def episodes_met(seed: int, updates: int, contexts: int, count: int) -> NDArray[np.int64]:
    """(N,) episodes that a training has lived through in each of N contexts (`contexts_met`)."""
    return np.asarray(_met(np.array([seed], np.uint32), updates, contexts, count))


@partial(jax.jit, static_argnums=(2, 3))
def _met(seed: jax.Array, updates: jax.Array, contexts: int, count: int) -> jax.Array:
    def further(number: jax.Array, met: jax.Array) -> jax.Array:
        return met.at[contexts_met(seed, number, contexts, count)].add(1)

    return jax.lax.fori_loop(0, updates, further, jnp.zeros(contexts, jnp.int32))
