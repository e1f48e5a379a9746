"""Trainings in a file, so that an interrupted one goes on where it was."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbtl.errors import MbtlError
from mbtl.files import whole_file
from mbtl.training.jax.blocks import Training, from_arrays, to_arrays
from mbtl.untrusted import read_arrays

_SECONDS = 30.0
"""Between two savings, which cost a copy of all weights from the device."""


class SavedTraining:
    """The file of one training, or of several that are done one after the other.

    Without a path nothing is saved. Whoever gave it removes the file, once what became of the
    trainings is safe.
    """

    def __init__(self, path: Path | None) -> None:
        """Nothing is written yet."""
        self._path, self._at = path, time.monotonic()
        self._others = {} if path is None else _read(path)

    def save(self, training: Training, *, number: int = 0, done: bool = False) -> None:
        """Save it beside those that are done, if that is due.

        Args:
            training: as it is.
            number: which one, of several.
            done: it is, hence due, and stays in the file beside those that follow.

        Raises:
            StorageError: the place cannot be written.
        """
        if self._path is None or not (done or time.monotonic() - self._at >= _SECONDS):
            return
        own = {_prefix(number) + name: array for name, array in to_arrays(training).items()}
        with whole_file(self._path) as file:
            np.savez(file, **self._others, **own)  # type: ignore[arg-type]
        self._others |= own if done else {}
        self._at = time.monotonic()

    def load(self, template: Callable[[], Training], *, number: int = 0) -> Training | None:
        """What was saved; None where there is nothing that fits: then it starts anew.

        Args:
            template: gives the same training before its first update.
            number: as it was saved.
        """
        before = _prefix(number)
        mine = [name for name in self._others if name.startswith(f"{before}leaf_")]
        own = {name.removeprefix(before): self._others.pop(name) for name in mine}
        try:
            return from_arrays(template(), own) if own else None
        except MbtlError:
            return None


def _prefix(number: int) -> str:
    return f"{number}_" if number else ""


def _read(path: Path) -> dict[str, NDArray[Any]]:
    """All that a file holds; nothing where it is missing or damaged."""
    try:
        with path.open("rb") as file:
            return read_arrays(file)
    except (ValueError, OSError):
        return {}
