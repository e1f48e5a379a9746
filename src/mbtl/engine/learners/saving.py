"""Trainings in a file, so that an interrupted one goes on where it was, or another one from it.

A training on other contexts takes over all that is not of contexts: networks, the optimiser and
statistics of rewards. Where the best of evaluations was kept, its networks, for the latest may be
worth nothing. Simulations stay, and with them the replay of transitions where it is of copies.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

import jax
import numpy as np
from numpy.typing import NDArray

from mbtl.engine.learners.blocks import Training, copied, from_arrays, to_arrays
from mbtl.errors import MbtlError
from mbtl.files import read_arrays, whole_file

T = TypeVar("T")

_TAKEN = ("weights", "optimizer", "memory", "fresh")
"""Of the state of a training: what another one can begin with."""
_NOTE = "note_"
_SECONDS = 30.0
"""Between two savings, which cost a copy of all weights from the device."""


class SavedTraining:
    """The file of one training, or of several that are done together, and some `notes` along.

    Without a path nothing is saved. Whoever gave it removes the file, once what became of the
    trainings is safe. Notes are numbers by name, which `load` finds again.
    """

    def __init__(self, path: Path | None) -> None:
        self._path, self._at = path, time.monotonic()
        self.notes: dict[str, int] = {}

    def save(self, training: Training, *, done: bool = False) -> None:
        """Save it, if it is done or that is due.

        Raises:
            StorageError: the place cannot be written.
        """
        if self._path is None or not (done or time.monotonic() - self._at >= _SECONDS):
            return
        with whole_file(self._path) as file:
            notes = {_NOTE + name: np.int64(number) for name, number in self.notes.items()}
            np.savez(file, **to_arrays(training), **notes)  # type: ignore[arg-type]
        self._at = time.monotonic()

    def inherited(self, begun: Training, *, best: bool) -> tuple[Training, int] | None:
        """`begun`, a training before its first update, with what another one here had learnt.

        With it the updates that the other one had done; its notes are found. None where there is
        nothing that fits. `best`: its policy was the best of its evaluations, if it had any.
        """

        def inheriting(arrays: dict[str, NDArray[Any]]) -> tuple[Training, int]:
            fields = _taken(begun.state)
            given = {n: from_arrays(own, arrays, f".state.{n}") for n, own in fields.items()}
            if best and np.isfinite(from_arrays(begun.best_return, arrays, ".best_return")).all():
                given["weights"] = from_arrays(begun.best, arrays, ".best")
            return _begun_with(begun, given), int(arrays[".updates"])

        return self._read(inheriting)

    def load(self, template: Callable[[], Training]) -> Training | None:
        """What was saved; None where there is nothing that fits: then it starts anew.

        The template gives the same training before its first update.
        """
        return self._read(lambda arrays: from_arrays(template(), arrays))

    def _read(self, made_of: Callable[[dict[str, NDArray[Any]]], T]) -> T | None:
        if self._path is None:
            return None
        try:
            with self._path.open("rb") as file:
                arrays = read_arrays(file)
            found = made_of(arrays)
            noted = (name for name in arrays if name.startswith(_NOTE))
            self.notes = {name.removeprefix(_NOTE): int(arrays[name]) for name in noted}
            return found
        except (MbtlError, ValueError, OSError):
            return None


def taking_over(training: Training, parent: Training, which: Sequence[int]) -> Training:
    """Trainings before their first update, with networks, optimiser and statistics of others.

    Args:
        training: P, as `start` gives them.
        parent: trunks to begin from.
        which: (P,) one of them for each.
    """
    index = np.asarray(which)
    theirs = _taken(parent.state)
    if np.isfinite(parent.best_return).all():
        theirs["weights"] = parent.best
    given = jax.tree.map(lambda x: x[index], theirs)
    return _begun_with(training, given)


def _taken(state: Any) -> dict[str, Any]:
    return {name: getattr(state, name) for name in _TAKEN if name in state._fields}


def _begun_with(training: Training, given: dict[str, Any]) -> Training:
    if getattr(training.state, "target", ()):
        given["target"] = given["weights"].actor
    state = copied(training.state._replace(**given))
    return training._replace(state=state, best=copied(state.weights))
