"""Many trainings at once, in blocks of updates with an evaluation after each.

Contexts and seeds are one axis of P policies. Everything that decides the future is in `Training`,
so a run that is stopped after a block goes on from it with the same result as if it had not been.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike, NDArray

from mbtl.errors import InvalidInput, StorageError, TrainingFailed
from mbtl.seeds import Purpose, derive_seed
from mbtl.training.jax.algorithms import algorithm_of
from mbtl.training.jax.clock import clock_at
from mbtl.training.jax.environments import Environment, Tree
from mbtl.training.jax.evaluation import episode_noise, own_returns
from mbtl.training.jax.networks import Weights
from mbtl.training.jax.recipes import Recipe, check_lengths

BLOCKS = 50
"""Evaluations per training unless told otherwise: one every 2 % of the steps."""


class Training(NamedTuple):
    """P trainings between two blocks.

    Attributes:
        state: the algorithm's; `state.weights` are the latest ones.
        best: weights of the best evaluation so far, the earliest of equals.
        best_return: (P,) mean return of that evaluation; optimistic, being a maximum.
        latest_return: (P,) mean return of the last evaluation.
        updates: updates done.
    """

    state: Any
    best: Weights
    best_return: jax.Array
    latest_return: jax.Array
    updates: jax.Array


class Block(NamedTuple):
    """What `on_block` is told.

    Attributes:
        steps: environment steps done, per policy.
        total: environment steps planned, per policy.
        training: everything, e.g. to save it with `to_arrays`. Read it before returning: its
            memory is used again by the next block.
    """

    steps: int
    total: int
    training: Training


def start(
    env: Environment,
    recipe: Recipe,
    seeds: Sequence[int],
    params: Tree,
    weights: Weights | None = None,
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
    return Training(
        state,
        jax.tree.map(jnp.copy, state.weights),
        jnp.full(n_contexts, -jnp.inf, dtype=jnp.float32),
        jnp.full(n_contexts, -jnp.inf, dtype=jnp.float32),
        jnp.int32(0),
    )


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
    every = checkpoint_every or math.ceil(timesteps / BLOCKS)
    per_update = recipe.steps_per_update
    total, block = math.ceil(timesteps / per_update), math.ceil(every / per_update)
    params = _float32(params)
    noise = np.stack([_checkpoint_noise(env, seed, checkpoint_episodes) for seed in seeds])
    training = start(env, recipe, seeds, params, weights) if resume is None else resume
    done = int(training.updates)
    while done < total and not (only_best and _nothing_to_gain(env, training)):
        count = min(block, total - done)
        training, finite = _run_block(env, recipe, training, params, noise, count, total)
        done += count
        check_finite(finite, done * per_update)
        if on_block is not None:
            on_block(Block(done * per_update, total * per_update, training))
    return training


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


@partial(jax.jit)
def keep_better(training: Training, latest: jax.Array) -> Training:
    """After an evaluation with mean returns `latest`, (P,): weights better than the best so far."""
    better = latest > training.best_return

    def keep(new: jax.Array, old: jax.Array) -> jax.Array:
        return jnp.where(better.reshape(-1, *[1] * (new.ndim - 1)), new, old)

    return training._replace(
        best=jax.tree.map(keep, training.state.weights, training.best),
        best_return=jnp.where(better, latest, training.best_return),
        latest_return=latest,
    )


def finite_policies(weights: Tree) -> jax.Array:
    """(P,) whether all weights of a policy are finite."""
    each = [jnp.isfinite(x.reshape(len(x), -1)).all(axis=1) for x in jax.tree.leaves(weights)]
    return jnp.stack(each).all(axis=0)


def to_arrays(training: Training) -> dict[str, NDArray[Any]]:
    """Plain arrays to be saved, e.g. with `numpy.savez`."""
    return {f"leaf_{i}": np.asarray(x) for i, x in enumerate(jax.tree.leaves(training))}


def from_arrays(template: Training, arrays: Mapping[str, NDArray[Any]]) -> Training:
    """What `to_arrays` took apart.

    Args:
        template: what `start` gives for the same arguments.
        arrays: as saved.

    Raises:
        StorageError: the arrays belong to other arguments.
    """
    leaves, structure = jax.tree.flatten(template)
    try:
        loaded = [np.asarray(arrays[f"leaf_{i}"]) for i in range(len(leaves))]
    except KeyError as error:
        raise StorageError(
            f"a saved training must hold {error}, which is missing; start anew"
        ) from error
    for old, new in zip(leaves, loaded, strict=True):
        if old.shape != new.shape or old.dtype != new.dtype:
            raise StorageError(
                f"a saved training must fit its recipe and contexts, got {new.dtype}{new.shape} "
                f"where {old.dtype}{old.shape} belongs; start anew"
            )
    restored: Training = jax.tree.unflatten(structure, [jnp.asarray(x) for x in loaded])
    return restored


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


def _nothing_to_gain(env: Environment, training: Training) -> bool:
    if env.max_return is None:
        return False
    return bool((np.asarray(training.best_return) >= env.max_return).all())


def _checkpoint_noise(env: Environment, seed: int, episodes: int) -> NDArray[np.float32]:
    return episode_noise(env, [derive_seed(seed, Purpose.CHECKPOINT, e) for e in range(episodes)])


def _float32(params: Tree) -> Tree:
    return jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), params)


def check_finite(finite: ArrayLike, step: int) -> None:
    """Refuse to go on with weights that are lost.

    Raises:
        TrainingFailed: one of the (P,) policies has weights that are not finite.
    """
    finite = np.asarray(finite)
    if not finite.all():
        bad = np.flatnonzero(~finite)
        raise TrainingFailed(
            f"training must keep finite weights, got NaN or infinity by step {step} in policies "
            f"{', '.join(map(str, bad[:10]))} ({len(bad)} in all); lower the learning rate, or "
            "check the contexts"
        )
