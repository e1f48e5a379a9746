"""Files of arrays: `.npz` without pickle, one-sentence errors, writes that are whole or absent."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbtl.errors import InvalidInput, few
from mbtl.files import read_arrays, read_json, whole_file

LONGEST_TEXT = 50_000_000
"""Characters of a record; a longer one is no record of ours."""


def read_npz(
    path: Path, wanted: Callable[[str], bool] = lambda name: True
) -> dict[str, NDArray[Any]]:
    """Arrays of a `.npz` file by name.

    Args:
        path: of the file.
        wanted: whether an array of this name is read.

    Raises:
        InvalidInput: there is no such file, it is no `.npz`, it is damaged or too large, or it
            holds pickled objects, which are never loaded.
    """
    try:
        with path.open("rb") as file:
            return read_arrays(file, wanted)
    except FileNotFoundError:
        raise InvalidInput(f"there is no file {path}; give the path of an .npz file") from None
    except IsADirectoryError:
        raise a_folder(path) from None
    except OSError as error:
        raise InvalidInput(f"{path} cannot be read ({error.strerror or error})") from error
    except ValueError as error:
        raise InvalidInput(
            f"{path} must be an .npz file of plain numbers (no pickled objects), got {error}; "
            "write it with numpy.savez(path, returns=...)"
        ) from error


def a_folder(path: Path) -> InvalidInput:
    """Build the error for a folder where one file is wanted."""
    inside = sorted(file.name for file in path.glob("*.npz"))
    fix = f"one that it holds: {few(inside)}" if inside else "the path of one, such as mine.npz"
    return InvalidInput(f"a matrix is an .npz file, and {path} is a folder; give {fix}")


def write_npz(path: Path, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write a compressed `.npz`, replacing an old one only when the new one is complete.

    Raises:
        InvalidInput: the name does not end in .npz.
        StorageError: the place cannot be written.
    """
    if path.suffix != ".npz":
        raise InvalidInput(f"a matrix file ends in .npz, got {str(path)!r}")
    assert not any(array.dtype.hasobject for array in arrays.values())
    with whole_file(path) as file:
        np.savez_compressed(file, **arrays)  # type: ignore[arg-type]


def text_array(record: Mapping[str, Any]) -> NDArray[np.str_]:
    """A JSON-able record as a 0-d text array, which `.npz` stores without pickle."""
    return np.array(json.dumps(record, sort_keys=True, ensure_ascii=False))


def read_text(array: NDArray[Any], key: str) -> dict[str, Any]:
    """The record that `text_array` stored under `key`.

    Raises:
        InvalidInput: the entry is not a JSON object, or one of absurd length.
    """
    try:
        fits = array.dtype.kind == "U" and array.dtype.itemsize <= 4 * LONGEST_TEXT
        record = read_json(str(array[()])) if fits and array.size == 1 else None
    except (ValueError, IndexError):
        record = None
    if not isinstance(record, dict):
        raise InvalidInput(f"`{key}` must hold a JSON object as text")
    return record
