"""What a training is between two blocks of updates, whatever is trained.

All that decides the future is in a `Training`, so a run that is stopped after a block goes on from
it with the same result as if it had not been.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple, TypeVar, cast

import jax
import jax.numpy as jnp
import numpy as np
from jax.tree_util import keystr
from numpy.typing import NDArray

from mbtl.engine.learners.networks import Weights
from mbtl.engine.worlds.environments import Tree
from mbtl.errors import StorageError, TrainingFailed, few

T = TypeVar("T")


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


def beginning(state: Any) -> Training:
    """Before the first update."""
    nothing = jnp.full(len(state.weights.log_std), -jnp.inf, dtype=jnp.float32)
    best, latest = copied((state.weights, nothing))
    return Training(state, best, nothing, latest, jnp.int32(0))


@partial(jax.jit)
def copied(tree: T) -> T:
    """The same in memory of its own, as blocks of updates take over what they are given."""
    return cast(T, jax.tree.map(jnp.copy, tree))


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


def check_finite(weights: Tree, step: int, contexts: Sequence[Any] = ()) -> None:
    """Refuse to go on with weights that are lost, and say of which contexts where those are told.

    Raises:
        TrainingFailed: one of the (P,) policies has weights that are not finite.
    """
    finite = np.asarray(_finite(weights))
    if not finite.all():
        bad = np.flatnonzero(~finite)
        names = [f"of {contexts[i]}" if contexts else str(i) for i in bad.tolist()]
        which = f" in policies {few(names, 10)} ({len(bad)} in all)" * (len(finite) > 1)
        raise TrainingFailed(
            f"training must keep finite weights, got NaN or infinity by step {step}{which}; check "
            "that rewards and observations are finite in all contexts, or lower the learning rate"
        )


@partial(jax.jit)
def _finite(weights: Tree) -> jax.Array:
    """(P,) whether all weights of a policy are numbers."""
    each = [jnp.isfinite(x.reshape(len(x), -1)).all(axis=1) for x in jax.tree.leaves(weights)]
    return jnp.stack(each).all(axis=0)


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
        found.append(new)
    return cast(T, jax.device_put(jax.tree.unflatten(structure, found)))
