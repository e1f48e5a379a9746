"""The transfer matrix as a picture: every policy on every target."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mbtl.errors import InvalidInput
from mbtl.plot.style import axes_for, dress, edges, number, positions, styled


@styled
def matrix(
    matrix: Any, seed: int | None = None, *, picks: Sequence[int] = (), ax: Any = None
) -> Any:
    """Performance of every policy (down the side) on every target (along the bottom).

    On one axis both sides are drawn in its unit, logarithmically if it is logarithmic; with more
    axes they are context indices. Where only some contexts are sources, the cells of the others
    belong to the nearest one.

    Args:
        matrix: a `mbtl.TransferMatrix`: (S, M, N) returns, M sources, N targets.
        seed: matrix seed; None: the mean over all.
        picks: sources to mark, in the order they were trained.
        ax: axes to draw on; None: new ones.

    Raises:
        InvalidInput: it is the name of a file or of a matrix.
    """
    if isinstance(matrix, (str, Path)):
        file = str(matrix).endswith(".npz")
        opened = f"{'TransferMatrix.load' if file else 'load_matrix'}({str(matrix)!r})"
        raise InvalidInput(
            f"matrix must be a TransferMatrix, got {str(matrix)!r}; open it first: "
            f"mbtl.plot.matrix(mbtl.{opened})"
        )
    ax = axes_for(ax, 4.6, 3.9)
    sources = matrix.trained
    line = matrix.space.d == 1 and matrix.space.unit.shape[1] == 1
    axis = matrix.space.axes[0]
    x = np.arange(matrix.n, dtype=np.float64)
    if line:
        x = positions(axis, matrix.space.values(axis.name))
    down, across = np.argsort(x[sources]), np.argsort(x)
    sides = [edges(axis if line else None, x[of]) for of in (across, sources[down])]
    table = matrix.shown(seed)[np.ix_(down, across)]
    mesh = ax.pcolormesh(*sides, table, rasterized=True)
    ax.figure.colorbar(mesh, ax=ax, label="performance")
    if line:
        dress(ax, axis, "x")
        dress(ax, axis, "y")
    ax.set_xlabel(f"target: {axis.label if line else 'context index'}")
    ax.set_ylabel(f"source: {axis.label if line else 'context index'}")
    many = seed is None and matrix.n_seeds > 1
    which = f"mean of {matrix.n_seeds} seeds" if many else f"seed {seed or 0}"
    ax.set_title(f"{matrix.name}, {which}")
    number(ax, dict(enumerate(x[list(picks)])), side="right", line="white")
    return ax
