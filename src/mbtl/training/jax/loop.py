"""Many trainings at once: contexts and seeds are one axis of P policies."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from fractions import Fraction
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from mbtl.errors import InvalidInput
from mbtl.seeds import Purpose, derive_seed
from mbtl.training.jax.algorithms import algorithm_of
from mbtl.training.jax.blocks import (
    Block,
    Schedule,
    Training,
    beginning,
    finite_policies,
    in_blocks,
    keep_better,
)
from mbtl.training.jax.clock import clock_at
from mbtl.training.jax.environments import Environment, Tree
from mbtl.training.jax.evaluation import episode_noise, own_returns
from mbtl.training.jax.networks import Weights
from mbtl.training.jax.recipes import Recipe, check_lengths


def start(
    env: Environment,
    recipe: Recipe,
    seeds: Sequence[int],
    params: Tree,
    weights: Weights | None = None,
    marks: Sequence[Fraction] = (),
) -> Training:
    """Trainings before their first update; arguments as in `train`.

    Raises:
        InvalidInput: there is not one seed per context, or weights of another shape.
    """
    n_contexts = len(params.visible)
    if len(seeds) != n_contexts or not seeds:
        raise InvalidInput(
            f"training takes one seed per context (repeat contexts for more seeds), "
            f"got {len(seeds)} seeds and {n_contexts} contexts"
        )
    params, init = _float32(params), algorithm_of(recipe).init
    state = init(env, recipe, seeds, params)
    if weights is not None:
        state = init(env, recipe, seeds, params, _fitting(weights, state.weights))
    return beginning(state, len(marks))


def train(
    env: Environment,
    recipe: Recipe,
    seeds: Sequence[int],
    params: Tree,
    timesteps: int,
    *,
    on_block: Callable[[Block], None] | None = None,
    checkpoint_every: int | None = None,
    checkpoint_episodes: int = 10,
    only_best: bool = False,
    weights: Weights | None = None,
    marks: Sequence[Fraction] = (),
    resume: Training | None = None,
) -> Training:
    """Train one policy per (context, seed), all of them together.

    A policy depends on its own seed and context, on the recipe and on `timesteps`; not on the
    others. (Another number of policies is another program, whose rounding may differ.)

    Args:
        env: the dynamics.
        recipe: hyper-parameters.
        seeds: P training seeds of 32 bits.
        params: P contexts, leading axis; repeat a context to train it with several seeds. With a
            `MultiTaskRecipe` (P, N, ...): each policy has a set of N contexts of its own, repeated
            where it is smaller, whose episodes take turns.
        timesteps: environment steps per policy, rounded up to whole updates.
        on_block: called after each block.
        checkpoint_every: environment steps between two evaluations of each policy on its own
            contexts, rounded up to whole updates; None for 2 % of `timesteps`.
        checkpoint_episodes: deterministic episodes of an evaluation, the same at every one; of N
            contexts each plays as many of them.
        only_best: end as soon as the best evaluation of every policy is the largest return there
            is (`env.max_return`): the best weights, the earliest of equals, cannot change any more.
        weights: P networks to begin from, e.g. `best` of trainings on other contexts; the optimiser
            knows nothing of their past, and they are no checkpoint themselves. None for fresh ones.
        marks: (L,) shares of the training at which weights are kept, `along`; where it ends early,
            those of its end stand for all that were to come.
        resume: what an interrupted call had reached (given again with the same arguments).

    Returns:
        Final and best weights.

    Raises:
        InvalidInput: seeds and contexts or weights do not match, a number is below 1, or N contexts
            cannot share the checkpoint's episodes evenly.
        TrainingFailed: weights are no longer finite.
    """
    check_lengths(timesteps=timesteps, checkpoint_episodes=checkpoint_episodes)
    shared_by = params.visible.shape[1] if params.visible.ndim == 3 else 1
    if checkpoint_episodes % shared_by:
        raise InvalidInput(
            f"checkpoint_episodes must be a multiple of the {shared_by} contexts of each policy, "
            f"got {checkpoint_episodes}"
        )
    schedule = Schedule.of(timesteps, recipe.steps_per_update, checkpoint_every, marks)
    params = _float32(params)
    noise = np.stack([_checkpoint_noise(env, seed, checkpoint_episodes) for seed in seeds])

    def advance(training: Training, count: int) -> tuple[Training, jax.Array]:
        block: tuple[Training, jax.Array] = _run_block(
            env, recipe, training, params, noise, count, schedule.total
        )
        return block

    def nothing_to_gain(training: Training) -> bool:
        return only_best and _at_most(env, training)

    training = start(env, recipe, seeds, params, weights, marks) if resume is None else resume
    return in_blocks(schedule, training, advance, on_block, nothing_to_gain)


@partial(jax.jit, static_argnums=(0, 1), donate_argnums=2)
def _run_block(
    env: Environment,
    recipe: Recipe,
    training: Training,
    params: Tree,
    noise: jax.Array,
    count: jax.Array,
    total: jax.Array,
) -> tuple[Training, jax.Array]:
    """`count` updates, then an evaluation; also (P,) whether all weights are finite."""

    def one(i: jax.Array, state: Any) -> Any:
        update = partial(algorithm_of(recipe).update, env, recipe)
        every = jax.vmap(update, in_axes=(0, 0, None))
        return every(state, params, clock_at(training.updates + i, total))

    state = jax.lax.fori_loop(0, count, one, training.state)
    latest = own_returns(env, recipe.activation, state.weights.actor, params, noise).mean(axis=1)
    training = training._replace(state=state, updates=training.updates + count)
    return keep_better(training, latest), finite_policies(state.weights)


def _fitting(weights: Weights, fresh: Weights) -> Weights:
    """A copy, since the training takes over its memory."""
    given, needed = ([np.shape(x) for x in jax.tree.leaves(w)] for w in (weights, fresh))
    if given != needed:
        raise InvalidInput(
            f"weights to begin from must have the shapes of this recipe and number of policies, "
            f"{needed}, got {given}"
        )
    copy: Weights = jax.tree.map(lambda x: jnp.array(x, jnp.float32), weights)
    return copy


def _at_most(env: Environment, training: Training) -> bool:
    if env.max_return is None:
        return False
    return bool((np.asarray(training.best_return) >= env.max_return).all())


def _checkpoint_noise(env: Environment, seed: int, episodes: int) -> NDArray[np.float32]:
    return episode_noise(env, [derive_seed(seed, Purpose.CHECKPOINT, e) for e in range(episodes)])


def _float32(params: Tree) -> Tree:
    return jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), params)
