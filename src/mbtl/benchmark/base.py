"""Row sources: what the benchmark asks of a transfer matrix, whether it fits in memory or not.

Notation (shapes): N contexts, S matrix seeds, m sources of a block.
    J  (N, N)  performance of one matrix seed, axis order (source, target); larger is better
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mbtl.arrays import Array
from mbtl.selectors.base import SelectionProblem

BLOCK_BYTES = 256 * 2**20
"""Memory that a pass over a matrix may hold at once."""


@runtime_checkable
class RowSource(Protocol):
    """Gives transfer rows on request; `TransferMatrix` and the synthetic worlds are row sources."""

    @property
    def name(self) -> str:
        """What results call it."""
        ...

    @property
    def n(self) -> int:
        """Number of contexts N."""
        ...

    @property
    def n_seeds(self) -> int:
        """Number of matrix seeds S."""
        ...

    def problem(self, budget: int) -> SelectionProblem:
        """What a selector may know of it beforehand."""
        ...

    def rows(self, seed: int, sources: ArrayLike) -> Array:
        """Performance of the policies trained on `sources` (m,) on every target; (m, N).

        The same seed and source give the same row, in whatever order rows are asked for.
        """
        ...


@dataclass(frozen=True)
class Levels:
    """Reference levels of one matrix seed, in performance.

    Attributes:
        independent: one policy per context, each used at home: mean of the diagonal.
        oracle_transfer: all N policies, the best per target: no selection can exceed it.
        grand_mean: one policy trained on a random context.
    """

    independent: float
    oracle_transfer: float
    grand_mean: float


def row_blocks(
    source: RowSource, seed: int, *, block_bytes: int = BLOCK_BYTES
) -> Iterator[tuple[NDArray[np.intp], Array]]:
    """All rows in order, in blocks of bounded memory: (sources (m,), rows (m, N))."""
    size = max(1, block_bytes // (8 * source.n))
    for start in range(0, source.n, size):
        sources = np.arange(start, min(start + size, source.n))
        yield sources, source.rows(seed, sources)


def levels(source: RowSource, seed: int) -> Levels:
    """Reference levels of one matrix seed in one pass over its rows.

    Target weights count in all three; the grand mean weighs sources equally, for each is as likely.
    """
    weights = source.problem(1).weights
    best = np.full(source.n, -np.inf)
    diagonal = np.empty(source.n)
    total = np.zeros(source.n)
    for sources, rows in row_blocks(source, seed):
        best = np.maximum(best, rows.max(axis=0))
        diagonal[sources] = rows[np.arange(len(sources)), sources]
        total += rows.sum(axis=0)
    return Levels(
        independent=float(diagonal @ weights),
        oracle_transfer=float(best @ weights),
        grand_mean=float(total @ weights) / source.n,
    )
