"""One selector less another on the same matrix seeds, with intervals.

What is hard about a matrix seed is hard for both, so it cancels in the difference, and the interval
of a difference is shorter than those of the two. Formulas and the bootstrap are those of
`mbtl.benchmark.summary`: V_K, V_mean, and closed_fraction as a ratio of means,
mean(V_a - V_b) / mean(V_orac - V_rand).

Two intervals answer two questions. Over the seeds of these matrices: would other trainings on these
very problems give the same? Over the matrices, each drawn with its seeds: what is to be expected on
another problem? The second is wider where selectors differ from problem to problem.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from mbtl.arrays import Array
from mbtl.benchmark.records import RESAMPLES, Difference, Lead
from mbtl.benchmark.summary import (
    DRAWS_SEED,
    GAIN,
    ROOM,
    V_K,
    V_MEAN,
    SeedTable,
    estimated,
    ratio,
    resampled_means,
    seed_draws,
)
from mbtl.errors import unknown_name

if TYPE_CHECKING:
    from mbtl.benchmark.comparison import Comparison

_FEWEST = 3
"""Matrices from which an interval over matrices says something."""


def difference(comparison: Comparison, selector: str, against: str) -> Difference:
    """The lead of one selector over another; see `Comparison.difference`."""
    rng = np.random.default_rng(DRAWS_SEED)  # the draws of the summary
    tables = {}
    for name, refs in comparison.references.items():
        draws, curves = seed_draws(len(refs), rng), comparison.curves[name]
        for asked in (selector, against):
            if asked not in curves:
                raise unknown_name("selector of this comparison", asked, list(curves))
        one, other = (SeedTable.of(curves[asked], refs, draws) for asked in (selector, against))
        columns = one.columns - other.columns
        columns[:, ROOM] = one.columns[:, ROOM]  # of the matrix, the same for both
        tables[name] = SeedTable(columns, (), draws)
    every = list(tables.values())
    return Difference(
        selector,
        against,
        {name: _lead([table], resampled_means([table])) for name, table in tables.items()},
        _lead(every, resampled_means(every)),
        _lead(every, _over_matrices(every)),
    )


def _lead(tables: Sequence[SeedTable], resampled: Array | None) -> Lead:
    means = np.mean([table.columns.mean(axis=0) for table in tables], axis=0)
    return Lead(
        V_K=estimated(lambda m: m[..., V_K], means, resampled),
        V_mean=estimated(lambda m: m[..., V_MEAN], means, resampled),
        closed_at_K=estimated(lambda m: _closed(m, 0), means, resampled),
        closed_under_curve=estimated(lambda m: _closed(m, 1), means, resampled),
        per_seed=tuple(float(v) for table in tables for v in table.columns[:, V_MEAN]),
    )


def _closed(means: Array, which: int) -> Array:
    return ratio(means[..., GAIN][..., which], means[..., ROOM][..., which])


def _over_matrices(tables: Sequence[SeedTable]) -> Array | None:
    """(B, F) means over matrices that are drawn with replacement, each with its seeds."""
    if len(tables) < _FEWEST:
        return None
    rng = np.random.default_rng(DRAWS_SEED)
    each = np.array(
        [
            table.columns.mean(axis=0)[None].repeat(RESAMPLES, axis=0)
            if table.draws is None
            else table.draws @ table.columns
            for table in tables
        ]
    )  # (matrices, B, F)
    drawn = rng.integers(len(tables), size=(len(tables), RESAMPLES))
    return np.asarray(each[drawn, np.arange(RESAMPLES)].mean(axis=0))
