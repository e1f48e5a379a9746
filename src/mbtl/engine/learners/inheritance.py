"""What a training on other contexts takes over from another: all that is not of its contexts.

Networks, the optimiser and statistics of rewards go along. Simulations stay, and with them the
replay of transitions where it is of copies.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from mbtl.engine.learners.blocks import Training
from mbtl.errors import StorageError

_TAKEN = ("weights", "optimizer", "memory", "fresh")
"""Of the state of a training: what another one can begin with."""


def taking_over(training: Training, parent: Training, which: Sequence[int]) -> Training:
    """Trainings before their first update, with networks, optimiser and statistics of others.

    What belongs to the parents' contexts stays there: their simulations, and their replay where it
    is of copies.

    Args:
        training: P, as `start` gives them.
        parent: trunks to begin from.
        which: (P,) one of them for each.
    """
    index = np.asarray(which)
    names = _taken(training.state)
    given = {n: jax.tree.map(lambda x: x[index], getattr(parent.state, n)) for n in names}
    return _begun_with(training, given)


def inheriting(training: Training, arrays: Mapping[str, NDArray[Any]]) -> tuple[Training, int]:
    """The same from the saved arrays of one parent, whatever contexts that was trained on.

    Returns:
        The trainings, and the updates that the parent had done.

    Raises:
        StorageError: they belong to another recipe.
    """
    given, first = {}, 0
    for name, part in zip(training.state._fields, training.state, strict=True):
        leaves, structure = jax.tree.flatten(part)
        if name == "fresh":  # behind the simulations, of which others have another number
            given[name] = jax.tree.map(jnp.zeros_like, part)
        elif name in _taken(training.state):
            found = [arrays.get(f"leaf_{first + i}") for i in range(len(leaves))]
            fits = [
                x is not None and x.shape == y.shape for x, y in zip(found, leaves, strict=True)
            ]
            if not all(fits):
                raise StorageError(
                    f"what a training inherits must fit its recipe, and `{name}` does not; begin "
                    "with the weights"
                )
            given[name] = jax.tree.unflatten(structure, [jnp.asarray(x) for x in found])
        first += len(leaves)
    last = sum(name.startswith("leaf_") for name in arrays) - 1  # the last field of a `Training`
    return _begun_with(training, given), int(arrays[f"leaf_{last}"])


def _taken(state: Any) -> list[str]:
    return [name for name in _TAKEN if name in state._fields]


def _begun_with(training: Training, given: dict[str, Any]) -> Training:
    if "target" in training.state._fields:
        given["target"] = given["weights"].actor
    state = jax.tree.map(jnp.copy, training.state._replace(**given))
    return training._replace(state=state, best=jax.tree.map(jnp.copy, state.weights))
