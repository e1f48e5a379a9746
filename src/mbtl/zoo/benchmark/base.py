"""Row sources: what the benchmark asks of a transfer matrix, whether it fits in memory or not.

A matrix may hold every policy twice, on two disjoint halves of its evaluation episodes. What
chooses sees one half (`rows`); what is shown is of the other (`fresh_rows`), on which nothing was
chosen: the best of many noisy numbers looks better than it is.

Contexts on which nobody was trained are targets only; a selector knows which (`problem`).

Notation (shapes): N contexts, M of them sources, S matrix seeds, K trainings, m sources or targets
of a block.
    J  (M, N)  performance of one matrix seed, axis order (source, target); larger is better
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from mbtl.arrays import Array, Indices
from mbtl.errors import InvalidInput
from mbtl.objective import value_curve
from mbtl.plain import whole
from mbtl.routing import rank, routed, routes
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

        What a selector may see, and what chooses the policy of each target. The same seed and
        source give the same row, in whatever order rows are asked for.
        """
        ...

    def fresh_rows(self, seed: int, sources: ArrayLike) -> Array:
        """The same policies on other evaluation episodes, of which every number shown is; (m, N).

        The same numbers as `rows` unless `measures_apart`.
        """
        ...

    @property
    def measures_apart(self) -> bool:
        """Whether `fresh_rows` are of other episodes than `rows`."""
        ...


@dataclass(frozen=True)
class Levels:
    """Reference levels of one matrix seed, in performance on fresh episodes.

    Attributes:
        independent: one policy per context, each used at home; mean over the M sources.
        oracle_transfer: all M policies, each target served by the best one that was seen.
        grand_mean: one policy trained on a random context.
    """

    independent: float
    oracle_transfer: float
    grand_mean: float


def checked_seed(seed: int, n_seeds: int) -> int:
    """The index of a matrix seed.

    Raises:
        InvalidInput: there is none of it.
    """
    if not 0 <= whole("seed", seed) < n_seeds:
        raise InvalidInput(f"seeds run from 0 to {n_seeds - 1}, got {seed}")
    return seed


def row_blocks(
    source: RowSource, seed: int, *, block_bytes: int = BLOCK_BYTES
) -> Iterator[tuple[Indices, Array]]:
    """All rows in order, in blocks of bounded memory: (sources (m,), rows (m, N))."""
    size = max(1, block_bytes // (8 * source.n))
    everyone = source.problem(1).sources
    for start in range(0, len(everyone), size):
        sources = everyone[start : start + size]
        yield sources, source.rows(seed, sources)


def ranked_blocks(
    source: RowSource, seed: int, *, block_bytes: int = BLOCK_BYTES
) -> Iterator[tuple[slice, Array]]:
    """Per target all M policies from the last that would serve it to the first, in blocks.

    They are ordered by what was seen, with the ties of `mbtl.routing`; the values are fresh. A
    column needs all rows, so a matrix that does not fit in memory is read once per block.

    Returns:
        (targets, values (m, M)) of each block.
    """
    n, apart, problem = source.n, source.measures_apart, source.problem(1)
    everyone, steps = problem.sources, problem.steps
    homes = steps[everyone]
    width = max(1, min(n, block_bytes // (8 * n * (1 + apart))))
    for start in range(0, n, width):
        targets = slice(start, min(start + width, n))
        seen = np.empty(
            (targets.stop - start, len(everyone))
        )  # target-major: each sort runs along memory
        fresh = np.empty_like(seen) if apart else seen
        for sources, rows in row_blocks(source, seed, block_bytes=block_bytes // 4):
            among = np.searchsorted(everyone, sources)
            seen[:, among] = rows[:, targets].T
            if apart:
                fresh[:, among] = source.fresh_rows(seed, sources)[:, targets].T
        if apart:
            for column, values, target in zip(seen, fresh, steps[targets], strict=True):
                distance = np.linalg.norm(homes - target, axis=1)
                values[:] = values[rank(column, distance, everyone)[::-1]]
        else:  # policies that tie have the same value
            seen.sort(axis=1)
        yield targets, fresh


def levels(source: RowSource, seed: int) -> Levels:
    """Reference levels of one matrix seed.

    Target weights count in all three; the grand mean weighs sources equally, for each is as likely.
    """
    weights, everyone = source.problem(1).weights, source.problem(1).sources
    home = weights if len(everyone) == source.n else weights / weights[everyone].sum()
    best = np.full(source.n, -np.inf)
    diagonal = np.zeros(source.n)
    total = np.zeros(source.n)
    for sources, seen in row_blocks(source, seed):
        rows = source.fresh_rows(seed, sources) if source.measures_apart else seen
        best = np.maximum(best, rows.max(axis=0))
        diagonal[sources] = rows[np.arange(len(sources)), sources]
        total += rows.sum(axis=0)
    if source.measures_apart:  # the best one that was seen, not the best one there is
        for targets, ranked in ranked_blocks(source, seed):
            best[targets] = ranked[:, -1]
    return Levels(
        independent=float(diagonal @ home),
        oracle_transfer=float(best @ weights),
        grand_mean=float(total @ weights) / len(everyone),
    )


def measured_curve(source: RowSource, seed: int, sources: Sequence[int]) -> Array:
    """V on fresh episodes after each of the trainings on `sources` (K,), routed by what was seen.

    It can fall: a policy that looked better on the episodes seen may be worse.

    Returns:
        (K,) V_1..V_K.
    """
    problem, rows = source.problem(1), source.rows(seed, sources)
    if not source.measures_apart:
        return value_curve(rows, problem.weights)
    served = routed(source.fresh_rows(seed, sources), routes(rows, sources, problem.steps))
    return np.asarray(served @ problem.weights)
