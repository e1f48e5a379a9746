"""Trainings in a file, so that an interrupted one goes on where it was."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from mbtl.engine.learners.blocks import Training, from_arrays, to_arrays
from mbtl.engine.learners.inheritance import inheriting
from mbtl.errors import MbtlError
from mbtl.files import whole_file
from mbtl.untrusted import read_arrays

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

    def inherited(self, begun: Training) -> Training | None:
        """`begun`, a training before its first update, with what another one here had learnt.

        None where there is nothing that fits.
        """
        if self._path is None:
            return None
        try:
            with self._path.open("rb") as file:
                return inheriting(begun, read_arrays(file))
        except (MbtlError, ValueError, OSError):
            return None

    def load(self, template: Callable[[], Training]) -> Training | None:
        """What was saved; None where there is nothing that fits: then it starts anew.

        The template gives the same training before its first update.
        """
        if self._path is None:
            return None
        try:
            with self._path.open("rb") as file:
                arrays = read_arrays(file)
            found = from_arrays(template(), arrays)
            noted = (name for name in arrays if name.startswith(_NOTE))
            self.notes = {name.removeprefix(_NOTE): int(arrays[name]) for name in noted}
            return found
        except (MbtlError, ValueError, OSError):
            return None
