"""Transfer matrices of others: one `.npy` of returns (source, target) per seed.

SD-MBTL publishes its data so: N x N float arrays, contexts in C order of a full grid, the scale of
all seeds together from 0 to 1. `LAYOUTS` has the grids that its scripts write; for other files of
the kind the axes are given.

Notation (shapes): N contexts, S files.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from mbtl.benchmark.matrix import TransferMatrix
from mbtl.contexts import ContextSpace, Linear
from mbtl.errors import InvalidInput, unknown_name
from mbtl.objective import Bounds

Grid = Mapping[str, Sequence[float]]
"""Axis -> its values, the axis of the slowest change first."""


def _times(nominal: float, first: int, last: int) -> tuple[float, ...]:
    """Fifths of a nominal value."""
    return tuple(round(nominal * k / 5, 10) for k in range(first, last + 1))


LAYOUTS: Mapping[str, Grid] = MappingProxyType(
    {
        "sd-mbtl-cartpole": {
            "masspole": _times(0.1, 1, 10),
            "masscart": _times(1.0, 1, 10),
            "length": _times(0.5, 2, 10),
        },
        "sd-mbtl-walker": {
            "friction": _times(2.5, 1, 8),
            "scale": _times(30.0, 1, 8),
            "gravity": _times(10.0, 1, 8),
        },
    }
)
"""Grids by name: follow-up-sd-mbtl, 3.1, in the order of its scripts' numbering."""


def import_npy(
    files: Sequence[str | Path],
    grid: str | Grid,
    *,
    bounds: Bounds | tuple[float, float] | None = None,
    name: str = "imported",
) -> TransferMatrix:
    """Stack the seeds of a matrix.

    Args:
        files: one per seed, each (N, N) returns, axes (source, target).
        grid: name of a layout, or the values of each axis, the slowest first; N of them together.
        bounds: returns of performance 0 and 1; default: the smallest and largest of all files.
        name: what results call it.

    Raises:
        UnknownName: no such layout.
        InvalidInput: a file is no such array, holds NaN, or does not fit the grid.
    """
    if isinstance(grid, str):
        if grid not in LAYOUTS:
            raise unknown_name("layout", grid, LAYOUTS)
        grid = LAYOUTS[grid]
    if not files:
        raise InvalidInput("an import needs one or more .npy files, got none")
    space = ContextSpace.grid(
        {Linear(axis, min(values), max(values)): list(values) for axis, values in grid.items()}
    )
    parts = [_read(Path(file), space.n) for file in files]
    return TransferMatrix.of(
        np.stack(parts),
        space=space,
        bounds=bounds,
        name=name,
        provenance={"seeds": [{"imported": Path(file).name} for file in files]},
    )


def _read(path: Path, n: int) -> NDArray[np.float64]:
    try:
        array = np.load(path, allow_pickle=False)
    except FileNotFoundError:
        raise InvalidInput(f"there is no file {path}; give the path of an .npy file") from None
    except (OSError, ValueError, EOFError) as error:
        raise InvalidInput(
            f"{path} must be an .npy file of numbers (no pickled objects), got {error}"
        ) from error
    if not isinstance(array, np.ndarray) or array.dtype.kind not in "fiu":
        raise InvalidInput(f"{path} must be one array of numbers, as numpy.save writes it")
    if array.shape != (n, n):
        raise InvalidInput(
            f"{path} must have shape (source, target) {(n, n)}, one row per point of the grid, got "
            f"{array.shape}; name the axes of this file"
        )
    bad = int(np.count_nonzero(~np.isfinite(array)))
    if bad:
        where = np.argwhere(~np.isfinite(array))[0].tolist()
        raise InvalidInput(
            f"{path} holds {bad} NaN or infinite of {array.size}, the first at [source {where[0]}, "
            f"target {where[1]}]; those pairs were never evaluated: fill them in, or leave the "
            "file out"
        )
    return array.astype(np.float64)
