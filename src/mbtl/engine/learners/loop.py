"""Many trainings at once, in any world: contexts and seeds are one axis of P policies."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, cast

import jax
import numpy as np

from mbtl.engine.learners import algorithms, blocks
from mbtl.engine.learners.algorithms import AnyRecipe
from mbtl.engine.learners.blocks import Block, Training
from mbtl.engine.learners.clock import Pace, clock_at
from mbtl.engine.learners.episodic.episodes import Acting, actor_of
from mbtl.engine.learners.evaluation import own_measures
from mbtl.engine.learners.networks import Weights
from mbtl.engine.learners.recipes import check_lengths
from mbtl.engine.learners.saving import SavedTraining
from mbtl.engine.worlds.environments import Length, Tree
from mbtl.engine.worlds.world import World, in_a_row
from mbtl.errors import InvalidInput
from mbtl.seeds import checkpoint_seeds

BLOCKS = 50
"""Evaluations per training unless told otherwise: one every 2 % of it."""


def start(
    world: World,
    recipe: AnyRecipe,
    seeds: Sequence[int],
    params: Tree,
    weights: Weights | None = None,
) -> Training:
    """Trainings before their first update; arguments as in `train`.

    Raises:
        InvalidInput: there is not one seed per context, or weights of another shape.
    """
    n_contexts = len(params.visible) if params.visible.ndim > 1 else len(seeds)
    if len(seeds) != n_contexts or not seeds:
        raise InvalidInput(
            f"training takes one seed per context (repeat contexts for more seeds), "
            f"got {len(seeds)} seeds and {n_contexts} contexts"
        )
    init = partial(algorithms.init, world, recipe, seeds, jax.device_put(params))
    state = init()
    if weights is not None:
        state = init(_fitting(weights, state.weights))
    return blocks.beginning(state)


def train(
    world: World,
    recipe: AnyRecipe,
    seeds: Sequence[int],
    params: Tree,
    length: int,
    *,
    on_block: Callable[[Block], None] | None = None,
    checkpoint_every: int | None = None,
    checkpoint_episodes: int = 10,
    acting: Acting = "mean",
    only_best: bool = False,
    weights: Weights | None = None,
    resume: Training | None = None,
    saved: SavedTraining | None = None,
    judging: bool = True,
    pace: Pace | None = None,
    contexts: Sequence[Any] = (),
) -> Training:
    """Train one policy per (context, seed), all of them together.

    A policy depends on its own seed and context, on the recipe and on `length`; not on the
    others. (Another number of policies is another program, whose rounding may differ.)

    Args:
        world: the dynamics.
        recipe: hyper-parameters.
        seeds: P training seeds of 32 bits.
        params: P contexts, leading axis; repeat a context to train it with several seeds. Of one
            context, without that axis, where the world cannot mix them. With a `MultiTaskRecipe`
            (P, N, ...): each policy has a set of N contexts of its own, repeated where it is
            smaller, whose episodes take turns.
        length: environment steps per policy, or episodes where the recipe counts those; rounded up
            to whole updates.
        on_block: called after each block.
        checkpoint_every: as much of it between two evaluations of each policy on its own contexts,
            rounded up to whole updates; None for 2 % of `length`.
        checkpoint_episodes: of an evaluation, the same at every one; of N contexts each plays as
            many of them.
        acting: how actions are chosen there.
        only_best: end as soon as the best evaluation of every policy is the largest return there
            is (`world.max_return`): the best weights, the earliest of equals, cannot change any
            more.
        weights: P networks to begin from, e.g. `best` of trainings on other contexts; the optimiser
            knows nothing of their past, and they are no checkpoint themselves. Without a critic,
            (), that is fresh; None: all are.
        resume: what an interrupted call had reached (given again with the same arguments).
        saved: file to go on from, and to save the training in now and then and at the end; where
            states mean nothing in another process (`storable`), only at the end.
        judging: evaluate on the way. Without, `best` and its returns mean nothing.
        pace: what schedules follow; None: `length`, where the recipe's rate falls at all.
        contexts: P of them, for the words of an error; (): not known.

    Returns:
        Final and best weights.

    Raises:
        InvalidInput: seeds and contexts or weights do not match, a number is below 1, or N contexts
            cannot share the checkpoint's episodes evenly.
        TrainingFailed: weights are no longer finite.
    """
    check_lengths(**{recipe.unit: length, "checkpoint_episodes": checkpoint_episodes})
    shared_by = params.visible.shape[1] if params.visible.ndim == 3 else 1
    if checkpoint_episodes % shared_by:
        raise InvalidInput(
            f"checkpoint_episodes must be a multiple of the {shared_by} contexts of each policy, "
            f"got {checkpoint_episodes}"
        )
    unit = recipe.update_length
    total = math.ceil(length / unit)
    every = math.ceil((checkpoint_every or math.ceil(length / BLOCKS)) / unit)
    if pace is None:
        pace = (Pace.falling if recipe.anneal else Pace.endless)(total)
    decisions = world.decisions(in_a_row(params))
    params = jax.device_put(params)
    best = world.max_return if only_best else None
    tests = np.array([checkpoint_seeds(seed, checkpoint_episodes) for seed in seeds], np.uint32)

    def is_over(training: Training) -> bool:
        nothing_to_gain = best is not None and (np.asarray(training.best_return) >= best).all()
        return bool(training.updates >= total or nothing_to_gain)

    def tell(training: Training) -> None:
        if on_block is not None:
            on_block(Block(int(training.updates) * unit, total * unit, training))

    fresh = partial(start, world, recipe, seeds, params, weights)
    if resume is None and saved is not None:
        resume = saved.load(fresh)
    training = fresh() if resume is None else resume
    if is_over(training):  # it goes on from its end
        tell(training)
    while not is_over(training):
        done = int(training.updates)
        count = min(done - done % every + every, total) - done
        training = _updates(world, recipe, decisions, training, params, count, pace)
        if judging:
            actor = actor_of(training.state.weights)
            found = own_measures(world, recipe.activation, acting, actor, tests, params)["score"]
            training = blocks.keep_better(training, found.mean(axis=1))
        blocks.check_finite(training.state.weights, (done + count) * unit, contexts)
        tell(training)
        if saved is not None and getattr(world, "storable", True):
            saved.save(training)
    if saved is not None:
        saved.save(training, done=True)
    return training


def in_sets(recipe: AnyRecipe, params: Tree, n_contexts: int) -> Tree:
    """Parameters of P x N contexts, set by set, as P trainings take them; of N = 1: as given.

    Networks with a vector per context see its place among them as one more feature.
    """
    if n_contexts == 1:
        return params
    count = len(params.visible) // n_contexts  # not -1: what is empty has any number of rows
    every = jax.tree.map(lambda x: np.reshape(x, (count, n_contexts, *np.shape(x)[1:])), params)
    if not getattr(recipe, "has_vectors", False):
        return every
    places = np.broadcast_to(np.arange(n_contexts)[:, None], (count, n_contexts, 1))
    return every._replace(visible=np.concatenate([every.visible, places], axis=-1))


@partial(jax.jit, static_argnums=(0, 1, 2), donate_argnums=3)
def _updates(
    world: World,
    recipe: AnyRecipe,
    decisions: Length,
    training: Training,
    params: Tree,
    count: jax.Array,
    pace: Pace,
) -> Training:
    def one(i: jax.Array, state: Any) -> Any:
        clock = clock_at(training.updates + i, pace)
        return algorithms.update(world, recipe, decisions, state, params, clock)

    state = jax.lax.fori_loop(0, count, one, training.state)
    return training._replace(state=state, updates=training.updates + count)


def _fitting(weights: Weights, fresh: Weights) -> Weights:
    """A copy, since the training takes over its memory."""
    fresh = fresh if weights.critic else fresh._replace(critic=())
    given, needed = ([np.shape(x) for x in jax.tree.leaves(w)] for w in (weights, fresh))
    if given != needed:
        raise InvalidInput(
            f"weights to begin from must have the shapes of this recipe and number of policies, "
            f"{needed}, got {given}"
        )
    return cast(Weights, blocks.copied(weights))
