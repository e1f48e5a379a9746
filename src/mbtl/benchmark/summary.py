"""Summary of a comparison: what each selector reached, with intervals over matrix seeds.

Notation (shapes): one matrix with S seeds, K trainings.
    V        (S, K)  generalisation performance; a selector run with several selector seeds enters
                     with the mean of its curves, `random` with its exact expectation
    V_rand   (S, K)  Random's exact expectation      V_orac  (S, K)  Sequential Oracle

Per matrix seed, then averaged over the seeds of a matrix:
    V_K      V at k = K                              V_mean  mean of V over k = 1..K
    k_star   first k with V >= Independent (the multi-task value is no part of a matrix)
    k90      first k with V >= grand mean + 0.90 (Oracle Transfer - grand mean); k95, k99 alike
Averages of k are geometric means. A level not reached within K is *censored*: the seed shows None,
enters the geometric mean as K + 1, and is counted; with `censored` > 0 the value therefore is a
lower bound, and with every seed censored it is None.

    minus_random     V - V_rand, at K and as mean over k
    closed_fraction  mean(V - V_rand) / mean(V_orac - V_rand), at K and under the curve (k = 1..K):
                     a ratio of means over seeds, never a mean of ratios; None if nobody can gain

*Pooled* values average these per-matrix means over the matrices, each matrix counting once: V_K and
V_mean arithmetically, k geometrically, closed_fraction as the ratio of the two pooled means.

Intervals: 95 % percentile bootstrap. Seeds are the unit: the S seeds of each matrix are drawn with
replacement, within that matrix, and all selectors share the draws, so differences are paired. One
seed gives no interval, alone or in a pool. With three seeds the bootstrap knows only ten samples,
and its intervals are too short; they show the scatter between seeds, not a tested claim.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mbtl.arrays import Array
from mbtl.benchmark.oracle import Reference
from mbtl.benchmark.records import (
    CONFIDENCE,
    RESAMPLES,
    Estimate,
    MatrixSummary,
    SelectorSummary,
    Summary,
    Trainings,
)
from mbtl.objective import k_star

SHARES = (0.90, 0.95, 0.99)
DRAWS_SEED = 20240604
_TIE = 1e-12

# Columns of the per-seed table; every statistic is a function of their means.
V_K, V_MEAN, LOG_K, GAIN, ROOM = 0, 1, slice(2, 6), slice(6, 8), slice(8, 10)


def summarise(
    curves: Mapping[str, Mapping[str, Array]],
    references: Mapping[str, Sequence[Reference]],
    caveats: Mapping[str, str | None] | None = None,
) -> Summary:
    """Summarise the curves of several selectors on several matrices.

    Args:
        curves: matrix name -> selector name -> (S, K) V; the same selectors for every matrix.
        references: matrix name -> one reference per matrix seed.
        caveats: matrix name -> what must be said beside its numbers.
    """
    rng = np.random.default_rng(DRAWS_SEED)
    draws = {name: seed_draws(len(refs), rng) for name, refs in references.items()}
    tables: dict[str, list[SeedTable]] = {}
    matrices = {}
    for name, refs in references.items():
        selectors = {}
        for selector, values in curves[name].items():
            table = SeedTable.of(values, refs, draws[name])
            tables.setdefault(selector, []).append(table)
            selectors[selector] = _summary([table])
        matrices[name] = _matrix_summary(refs, selectors, (caveats or {}).get(name))
    budget = len(next(iter(references.values()))[0].random)
    return Summary(budget, matrices, {name: _summary(group) for name, group in tables.items()})


@dataclass(frozen=True)
class SeedTable:
    """Per-seed columns of one selector on one matrix, and the shared bootstrap draws."""

    columns: Array  # (S, F)
    reached: tuple[tuple[int | None, ...], ...]  # per level, per seed
    draws: Array | None  # (B, S) shares of each seed, rows sum to 1

    @classmethod
    def of(cls, values: Array, refs: Sequence[Reference], draws: Array | None) -> SeedTable:
        """The columns of (S, K) V."""
        budget = values.shape[1]
        by_seed = [_reached(curve, ref) for curve, ref in zip(values, refs, strict=True)]
        reached = tuple(zip(*by_seed, strict=True))
        trainings = np.array([[budget + 1 if k is None else k for k in row] for row in reached])
        random = np.array([ref.random for ref in refs])
        gain, room = values - random, np.array([ref.oracle.curve for ref in refs]) - random
        columns = np.column_stack(
            [
                values[:, -1],
                values.mean(axis=1),
                np.log(trainings).T,
                gain[:, -1],
                gain.mean(axis=1),
                room[:, -1],
                room.mean(axis=1),
            ]
        )
        return cls(columns, reached, draws)


def trainings_to(curve: Array, low: float, high: float) -> list[int | None]:
    """Trainings until (K,) V has gone each of `SHARES` of the way from `low` to `high`."""
    return [k_star(curve, low + share * (high - low) - _TIE) for share in SHARES]


def _reached(curve: Array, ref: Reference) -> list[int | None]:
    """k_star, k90, k95, k99 of one seed."""
    low, high = ref.levels.grand_mean, ref.levels.oracle_transfer
    return [k_star(curve, ref.levels.independent - _TIE), *trainings_to(curve, low, high)]


def seed_draws(n_seeds: int, rng: np.random.Generator) -> Array | None:
    """(B, S) shares of each seed in B draws with replacement; None of a single seed."""
    if n_seeds == 1:
        return None
    counts = rng.multinomial(n_seeds, np.full(n_seeds, 1.0 / n_seeds), size=RESAMPLES)
    return np.asarray(counts / n_seeds)


def _summary(tables: Sequence[SeedTable]) -> SelectorSummary:
    """The statistics of one selector over one or more matrices."""
    means = np.mean([table.columns.mean(axis=0) for table in tables], axis=0)
    resampled = resampled_means(tables)

    def estimate(statistic: Any) -> Estimate:
        return estimated(statistic, means, resampled)

    def trainings(q: int) -> Trainings:
        per_seed = tuple(k for table in tables for k in table.reached[q])
        censored = sum(k is None for k in per_seed)
        if censored == len(per_seed):
            return Trainings(Estimate(None, None, None), censored, per_seed)
        return Trainings(estimate(lambda m: np.exp(m[..., LOG_K][..., q])), censored, per_seed)

    return SelectorSummary(
        V_K=estimate(lambda m: m[..., V_K]),
        V_mean=estimate(lambda m: m[..., V_MEAN]),
        k_star=trainings(0),
        k90=trainings(1),
        k95=trainings(2),
        k99=trainings(3),
        minus_random_at_K=estimate(lambda m: m[..., GAIN][..., 0]),
        minus_random_mean=estimate(lambda m: m[..., GAIN][..., 1]),
        closed_at_K=estimate(lambda m: ratio(m[..., GAIN][..., 0], m[..., ROOM][..., 0])),
        closed_under_curve=estimate(lambda m: ratio(m[..., GAIN][..., 1], m[..., ROOM][..., 1])),
    )


def estimated(statistic: Any, means: Array, resampled: Array | None) -> Estimate:
    """A function of the (F,) means, with its interval by the (B, F) resampled ones."""
    value = float(statistic(means))
    low = high = None
    if resampled is not None:
        spread = np.asarray(statistic(resampled))
        spread = spread[np.isfinite(spread)]
        if spread.size:
            tail = (1.0 - CONFIDENCE) / 2.0
            low, high = (float(q) for q in np.quantile(spread, [tail, 1.0 - tail]))
    return Estimate(value, low, high) if np.isfinite(value) else Estimate(None, None, None)


def resampled_means(tables: Sequence[SeedTable]) -> Array | None:
    """(B, F) means under the bootstrap; None if a matrix has one seed, whose scatter is unknown."""
    parts = []
    for table in tables:
        if table.draws is None:
            return None
        parts.append(table.draws @ table.columns)
    return np.asarray(np.mean(parts, axis=0))


def ratio(gain: Array, room: Array) -> Array:
    """Gain / room; NaN where there is no room."""
    some = np.abs(room) > _TIE
    return np.where(some, gain / np.where(some, room, 1.0), np.nan)


def _matrix_summary(
    refs: Sequence[Reference], selectors: Mapping[str, SelectorSummary], caveat: str | None
) -> MatrixSummary:
    return MatrixSummary(
        n_seeds=len(refs),
        independent=float(np.mean([ref.levels.independent for ref in refs])),
        oracle_transfer=float(np.mean([ref.levels.oracle_transfer for ref in refs])),
        grand_mean=float(np.mean([ref.levels.grand_mean for ref in refs])),
        random=np.mean([ref.random for ref in refs], axis=0),
        oracle=np.mean([ref.oracle.curve for ref in refs], axis=0),
        selectors=selectors,
        references={key: float(np.mean([ref.rows[key] for ref in refs])) for key in refs[0].rows},
        caveat=caveat,
    )
