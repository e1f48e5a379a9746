"""A training in a file, so that an interrupted one goes on where it was."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from mbtl.errors import MbtlError
from mbtl.files import whole_file
from mbtl.training.jax.loop import Training, from_arrays, to_arrays
from mbtl.untrusted import read_arrays

_SECONDS = 30.0
"""Between two savings, which cost a copy of all weights from the device."""


class SavedTraining:
    """The file of one training; without a path nothing is saved.

    Whoever gave the path removes the file, once what became of the training is safe.
    """

    def __init__(self, path: Path | None) -> None:
        """Nothing is read or written yet."""
        self._path, self._at = path, time.monotonic()

    def save(self, training: Training, *, now: bool = False) -> None:
        """Save it if that is due, or `now`.

        Raises:
            StorageError: the place cannot be written.
        """
        if self._path is None or not (now or time.monotonic() - self._at >= _SECONDS):
            return
        with whole_file(self._path) as file:
            np.savez(file, **to_arrays(training))  # type: ignore[arg-type]
        self._at = time.monotonic()

    def load(self, template: Callable[[], Training]) -> Training | None:
        """What was saved; None where there is nothing that fits: then it starts anew.

        Args:
            template: gives the same training before its first update.
        """
        if self._path is None or not self._path.is_file():
            return None
        try:
            with self._path.open("rb") as file:
                return from_arrays(template(), read_arrays(file))
        except (MbtlError, ValueError, OSError):
            return None
