"""Many trainings in a twin, in blocks of updates; a return here is a score."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from mbtl.errors import InvalidInput
from mbtl.seeds import Purpose, derive_seed
from mbtl.training.jax import networks
from mbtl.training.jax.blocks import (
    Block,
    Schedule,
    Training,
    beginning,
    finite_policies,
    in_blocks,
    keep_better,
)
from mbtl.training.jax.environments import Tree
from mbtl.training.jax.networks import Weights
from mbtl.training.jax.recipes import check_lengths
from mbtl.training.jax.traffic import ppo, random, trpo
from mbtl.training.jax.traffic.episodes import Acting, Actor, Episodes, record, scores
from mbtl.training.jax.traffic.recipes import EpisodicPPORecipe, TRPORecipe, TwinRecipe
from mbtl.training.jax.traffic.twin import Length, Twin

_ALGORITHMS: Mapping[type, Any] = {TRPORecipe: trpo, EpisodicPPORecipe: ppo}
"""Modules with `start(recipe, weights)` and `learn(...)`, of one policy."""

_EPISODE = 1 << 21  # stream of random numbers: seeds of training episodes


class State(NamedTuple):
    """P policies between two updates.

    Attributes:
        weights: leading axis P.
        memory: the algorithm's, leading axis P.
        seed: (P,) uint32.
    """

    weights: Weights
    memory: Tree
    seed: jax.Array


def start(
    twin: Twin,
    recipe: TwinRecipe,
    seeds: Sequence[int],
    params: Tree,
    marks: Sequence[Fraction] = (),
) -> Training:
    """Trainings before their first update; see `train`."""
    n_inputs = twin.n_features + params.visible.shape[-1]
    each = [
        networks.init_weights(
            seed, n_inputs, twin.action, recipe.hidden, recipe.log_std, recipe.critic_gain
        )
        for seed in seeds
    ]
    weights = networks.stack(each)
    memory = jax.vmap(partial(_ALGORITHMS[type(recipe)].start, recipe))(weights)
    state = State(weights, memory, jnp.asarray(np.array(seeds, dtype=np.uint32)))
    return beginning(state, len(marks))


def train(
    twin: Twin,
    recipe: TwinRecipe,
    seeds: Sequence[int],
    params: Tree,
    episodes: int,
    *,
    on_block: Callable[[Block], None] | None = None,
    checkpoint_every: int | None = None,
    checkpoint_episodes: int = 10,
    acting: Acting = "sampled",
    marks: Sequence[Fraction] = (),
    resume: Training | None = None,
) -> Training:
    """Train P policies, in one context or, where the twin can mix them, each in its own.

    Args:
        twin: the dynamics.
        recipe: hyper-parameters.
        seeds: P training seeds of 32 bits.
        params: of the context; or of P contexts, leading axis.
        episodes: per policy, rounded up to whole updates.
        on_block: called after each block, with episodes as steps.
        checkpoint_every: episodes between two evaluations, rounded up; None for 2 % of `episodes`.
        checkpoint_episodes: of an evaluation, the same at every one.
        acting: how actions are chosen there.
        marks: (L,) shares of the training at which weights are kept, `along`.
        resume: what an interrupted call had reached (given again with the same arguments).

    Returns:
        Final and best weights.

    Raises:
        InvalidInput: there are no seeds, or a number is below 1.
        TrainingFailed: weights are no longer finite.
    """
    check_lengths(episodes=episodes, checkpoint_episodes=checkpoint_episodes)
    if not seeds:
        raise InvalidInput("training takes at least one seed, got none")
    decisions = twin.decisions(params)
    test_params = _per_episode(params, checkpoint_episodes)
    params = _per_episode(params, recipe.n_episodes)
    numbers = range(checkpoint_episodes)
    tests = np.array(
        [[derive_seed(seed, Purpose.CHECKPOINT, e) for e in numbers] for seed in seeds], np.uint32
    )

    def advance(training: Training, count: int) -> tuple[Training, jax.Array]:
        training = _updates(twin, recipe, decisions, training, params, count)
        actor = actor_of(training.state)
        found = scores(twin, recipe.activation, acting, actor, tests, test_params, decisions)
        return judged(training, found.mean(axis=1))

    schedule = Schedule.of(episodes, recipe.n_episodes, checkpoint_every, marks)
    training = start(twin, recipe, seeds, params, marks) if resume is None else resume
    return in_blocks(schedule, training, advance, on_block)


def judged(training: Training, scores: jax.Array) -> tuple[Training, jax.Array]:
    """After an evaluation with mean scores (P,): `keep_better`, and whether weights are finite."""
    return keep_better(training, scores), finite_policies(training.state.weights)


def _per_episode(params: Tree, episodes: int) -> Tree:
    """Parameters of every simulation, policy by policy; those of one context serve all."""
    if params.visible.ndim == 1:
        return params
    return jax.tree.map(lambda x: jnp.repeat(jnp.asarray(x), episodes, axis=0), params)


@partial(jax.jit, static_argnums=(0, 1, 2), donate_argnums=3)
def _updates(
    twin: Twin,
    recipe: TwinRecipe,
    decisions: Length,
    training: Training,
    params: Tree,
    count: jax.Array,
) -> Training:
    def one(i: jax.Array, state: State) -> State:
        return update(twin, recipe, decisions, state, training.updates + i, params)

    state: Any = jax.lax.fori_loop(0, count, one, training.state)
    return training._replace(state=state, updates=training.updates + count)


def update(
    twin: Twin, recipe: TwinRecipe, decisions: Length, state: State, number: jax.Array, params: Tree
) -> State:
    """Live through `n_episodes` of each policy and learn from them; within a compiled program.

    Args:
        twin: the dynamics.
        recipe: hyper-parameters.
        decisions: of an episode, or beats.
        state: P policies.
        number: of the update.
        params: of one context, or of every simulation.
    """
    seeds = episode_seeds(recipe, state, number)
    lived = record(twin, recipe.activation, decisions, actor_of(state), seeds, params)
    return learnt(twin, recipe, state, number, lived)


def episode_seeds(recipe: TwinRecipe, state: State, number: jax.Array) -> jax.Array:
    """(P, `n_episodes`) seeds of the episodes of an update."""
    return random.bits(state.seed, _EPISODE, number, recipe.n_episodes).T


def actor_of(state: State) -> Actor:
    """What plays."""
    return Actor(state.weights.actor, state.weights.log_std, state.weights.critic)


def learnt(
    twin: Twin, recipe: TwinRecipe, state: State, number: jax.Array, lived: Episodes
) -> State:
    """Each policy after an update with its episodes."""
    learn = partial(_ALGORITHMS[type(recipe)].learn, twin.action, recipe)
    policies = jax.vmap(learn, in_axes=(0, 0, 0, None))
    weights, memory = policies(state.weights, state.memory, lived, number)
    return State(weights, memory, state.seed)
