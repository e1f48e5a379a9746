"""Training in blocks of updates with an evaluation after each, whatever is trained.

All that decides the future is in a `Training`, so a run that is stopped after a block goes on from
it with the same result as if it had not been.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, NamedTuple, TypeVar, cast

import jax
import jax.numpy as jnp
import numpy as np
from jax.tree_util import keystr
from numpy.typing import NDArray

from mbtl.engine.learners.networks import Weights
from mbtl.engine.worlds.environments import Tree
from mbtl.errors import StorageError, TrainingFailed

T = TypeVar("T")

BLOCKS = 50
"""Evaluations per training unless told otherwise: one every 2 % of it."""


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
    """What `on_block` is told: environment steps per policy, done and planned, and everything.

    Read the training before returning: its memory is used again by the next block.
    """

    steps: int
    total: int
    training: Training


class Schedule(NamedTuple):
    """When what happens, in updates.

    Attributes:
        total: of the whole training.
        every: between two evaluations.
        unit: environment steps or episodes of an update.
    """

    total: int
    every: int
    unit: int

    @classmethod
    def of(cls, length: int, unit: int, every: int | None = None) -> Schedule:
        """From steps or episodes, rounded up to whole updates; `every` None: each 2 % of them."""
        every = every or math.ceil(length / BLOCKS)
        return cls(math.ceil(length / unit), math.ceil(every / unit), unit)


def beginning(state: Any) -> Training:
    """Before the first update."""
    weights = state.weights
    nothing = jnp.full(len(weights.log_std), -jnp.inf, dtype=jnp.float32)
    best = jax.tree.map(jnp.copy, weights)
    return Training(state, best, nothing, jnp.copy(nothing), jnp.int32(0))


def in_blocks(
    schedule: Schedule,
    training: Training,
    learn: Callable[[Training, int], Training],
    judge: Callable[[Training], Training] | None,
    on_block: Callable[[Block], None] | None = None,
    nothing_to_gain: Callable[[Training], bool] = lambda training: False,
) -> Training:
    """Learn and be judged in turns, and keep the best weights.

    Args:
        schedule: when.
        training: from which to go on.
        learn: training, number of updates -> training after them, maybe in the same memory.
        judge: training -> training after an evaluation and `keep_better`; None: nobody judges.
        on_block: told after each judgement, and once where nothing is left to do.
        nothing_to_gain: whether to end before the last update.

    Raises:
        TrainingFailed: weights are no longer finite.
    """
    done, planned = int(training.updates), schedule.total * schedule.unit
    over = done >= schedule.total or nothing_to_gain(training)
    if over and on_block is not None:  # it went on from its end
        on_block(Block(done * schedule.unit, planned, training))
    while not over:
        end = min(done - done % schedule.every + schedule.every, schedule.total)
        training, done = learn(training, end - done), end
        if judge is not None:
            training = judge(training)
        check_finite(training.state.weights, done * schedule.unit)
        if on_block is not None:
            on_block(Block(done * schedule.unit, planned, training))
        over = done == schedule.total or nothing_to_gain(training)
    return training


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


def check_finite(weights: Tree, step: int) -> None:
    """Refuse to go on with weights that are lost.

    Raises:
        TrainingFailed: one of the (P,) policies has weights that are not finite.
    """
    each = [jnp.isfinite(x.reshape(len(x), -1)).all(axis=1) for x in jax.tree.leaves(weights)]
    finite = np.asarray(jnp.stack(each).all(axis=0))
    if not finite.all():
        bad = np.flatnonzero(~finite)
        raise TrainingFailed(
            f"training must keep finite weights, got NaN or infinity by step {step} in policies "
            f"{', '.join(map(str, bad[:10]))} ({len(bad)} in all); lower the learning rate, or "
            "check the contexts"
        )


def to_arrays(training: Training) -> dict[str, NDArray[Any]]:
    """Plain arrays by their places, to be saved, e.g. with `numpy.savez`."""
    leaves = jax.tree_util.tree_leaves_with_path(training)
    return {keystr(place): np.asarray(x) for place, x in leaves}


def from_arrays(template: T, arrays: Mapping[str, NDArray[Any]], within: str = "") -> T:
    """What `to_arrays` took apart; the template is a beginning with the same arguments.

    Args:
        template: of the training, or of a part of it.
        arrays: of a training.
        within: where the part is, e.g. ".state.weights".

    Raises:
        StorageError: the arrays belong to other arguments.
    """
    leaves, structure = jax.tree_util.tree_flatten_with_path(template)
    found = []
    for place, old in leaves:
        name = within + keystr(place)
        if name not in arrays:
            raise StorageError(f"a saved training must hold {name}; start anew")
        new = np.asarray(arrays[name])
        if old.shape != new.shape or old.dtype != new.dtype:
            raise StorageError(
                f"a saved training must fit its recipe and contexts, got {new.dtype}{new.shape} "
                f"where {old.dtype}{old.shape} belongs; start anew"
            )
        found.append(jnp.asarray(new))
    return cast(T, jax.tree.unflatten(structure, found))
