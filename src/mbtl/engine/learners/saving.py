"""Trainings in a file, so that an interrupted one goes on where it was."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from mbtl.engine.learners.blocks import Training, from_arrays, to_arrays
from mbtl.engine.learners.inheritance import inheriting
from mbtl.errors import MbtlError
from mbtl.files import read_arrays, whole_file

T = TypeVar("T")

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

    def inherited(self, begun: Training) -> tuple[Training, int] | None:
        """`begun`, a training before its first update, with what another one here had learnt.

        With it the updates that the other one had done; its notes are found. None where there is
        nothing that fits.
        """
        return self._read(lambda arrays: inheriting(begun, arrays))

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
