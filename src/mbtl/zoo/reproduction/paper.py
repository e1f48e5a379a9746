"""What the paper printed: its two tables, and which values it calls the best.

Published are means and standard deviations over three trials at K = 15.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mbtl.arrays import Array
from mbtl.zoo.benchmark.comparison import CONFIDENCE, Estimate
from mbtl.zoo.benchmark.shipped import data_folder

METHODS = (
    "independent",
    "multitask",
    "random",
    "greedy",
    "mbtl",
    "sequential_oracle",
    "oracle_transfer",
    "one_policy",
)
"""Columns in the paper's order; the last two are ours: all N policies without selection, and one
policy for all contexts that was trained as long as K of them."""

COMPARED = METHODS[:5]
"""Those that need no knowledge of the whole matrix; the best of them is marked."""

HEADS = {
    "independent": "Independent",
    "multitask": "Multi-task",
    "random": "Random",
    "greedy": "Greedy",
    "mbtl": "MBTL",
    "sequential_oracle": "Sequential Oracle",
    "oracle_transfer": "Oracle Transfer",
    "one_policy": "Multi-task, K units",
}

TRIALS = 3
_TRAFFIC = ("signal", "eco", "ring", "ramp")
_ROUNDING = 1e-12


@dataclass(frozen=True)
class Value:
    """Mean and standard deviation over seeds, performance; None of one seed."""

    mean: float
    std: float | None

    @classmethod
    def of(cls, seeds: Array) -> Value:
        """With n - 1, as the paper."""
        return cls(float(seeds.mean()), float(seeds.std(ddof=1)) if len(seeds) > 1 else None)

    def to_json(self) -> dict[str, float | None]:
        """JSON-able record."""
        return {"mean": self.mean, "std": self.std}


@dataclass(frozen=True)
class Published:
    """A line of the paper's tables.

    Attributes:
        values: by method.
        k_star: per trial, trainings until MBTL reaches the better of Independent and Multi-task.
        n: contexts N.
        marked: what the paper sets in bold.
    """

    values: Mapping[str, Value]
    k_star: tuple[int, ...]
    n: int
    marked: frozenset[str]

    @property
    def mean_k_star(self) -> float:
        """Mean over the trials, rounded as printed."""
        return round(float(np.mean(self.k_star)), 2)

    @property
    def efficiency(self) -> float:
        """N over the mean k*."""
        return self.n / float(np.mean(self.k_star))


def published() -> dict[str, Published]:
    """The paper's lines by CMDP, in its order."""
    file = data_folder() / "published.csv"
    table = {}
    with file.open(newline="", encoding="utf-8") as lines:
        for row in csv.DictReader(lines):
            values = {
                method: Value(float(row[f"{method}_mean"]), float(row[f"{method}_std"]))
                for method in METHODS
                if f"{method}_mean" in row
            }
            stars = tuple(int(k) for k in row["k_star_seeds"].strip("[]").split())
            marked = frozenset(row["best_marked_in_paper"].split("|"))
            table[row["cmdp"]] = Published(values, stars, int(row["N"]), marked)
    return table


def domain_of(cmdp: str) -> str:
    """The table that a CMDP stands in: "traffic" or "control"."""
    return "traffic" if cmdp.startswith(_TRAFFIC) else "control"


def marked(values: Mapping[str, Value], n_seeds: int) -> frozenset[str]:
    """Methods of the paper's tables that are the best within significance.

    Those are the highest mean and every other that is no farther from it than the sum of the
    two standard errors. Of one seed only equal values tie. The paper does not say its rule; this
    one marks what the paper marks on 20 of its 22 lines. Seeds are not told, so they are not
    paired; ours are (`marked_in_pairs`).
    """
    there = {m: values[m] for m in COMPARED if m in values}
    if not there:
        return frozenset()
    best = max(there, key=lambda m: there[m].mean)
    return frozenset(m for m in there if m == best or _ties(there[m], there[best], n_seeds))


def marked_in_pairs(per_seed: Mapping[str, Array]) -> frozenset[str]:
    """Methods that are the best, seed by seed: by at most the standard error of the differences.

    Args:
        per_seed: (S,) by method; methods of other seeds are compared by their own errors.
    """
    there = {m: per_seed[m] for m in COMPARED if m in per_seed}
    if not there:
        return frozenset()
    best = max(there, key=lambda m: there[m].mean())
    return frozenset(m for m in there if _level(there[best], there[m]))


def _level(best: Array, one: Array) -> bool:
    if len(best) != len(one) or len(best) == 1:
        return _ties(Value.of(one), Value.of(best), min(len(one), len(best)))
    lead = best - one
    return bool(lead.mean() <= lead.std(ddof=1) / math.sqrt(len(lead)) + _ROUNDING)


def _ties(one: Value, best: Value, n: int) -> bool:
    errors = 0.0 if one.std is None or best.std is None else (one.std + best.std) / math.sqrt(n)
    return best.mean - one.mean <= errors + _ROUNDING


# ---- statistics over many CMDPs and few seeds: the interquartile mean and its bootstrap ------
#
# Agarwal et al. (NeurIPS 2021): the mean of the middle half of all runs, which one odd CMDP cannot
# move, with a bootstrap that draws seeds within each CMDP.
#
# Notation (shapes): T CMDPs (tasks) with S_t seeds each.


RESAMPLES = 2000
_SEED = 20240604


def interquartile_mean(scores: Array) -> Array:
    """Mean of the middle half of the values along the last axis.

    A quarter of the values, rounded down, is cut from each end.
    """
    ordered = np.sort(np.asarray(scores, dtype=np.float64), axis=-1)
    cut = ordered.shape[-1] // 4
    return np.asarray(ordered[..., cut : ordered.shape[-1] - cut].mean(axis=-1))


def pooled(scores: Sequence[Array]) -> Estimate:
    """Interquartile mean of all runs of all CMDPs, with its bootstrap interval.

    Of one seed there is none: it leaves the scatter unknown.

    Args:
        scores: (S_t,) per CMDP.
    """
    value = float(interquartile_mean(np.concatenate(scores)))
    drawn = interquartile_mean(_resampled(scores))
    return _interval(value, drawn, scores)


def pooled_mean(scores: Sequence[Array]) -> Estimate:
    """Mean over CMDPs of their means over seeds, with its bootstrap interval."""
    value = float(np.mean([s.mean() for s in scores]))
    sizes = np.cumsum([len(s) for s in scores])[:-1]
    parts = np.split(_resampled(scores), sizes, axis=1)
    drawn = np.mean([part.mean(axis=1) for part in parts], axis=0)
    return _interval(value, drawn, scores)


def probability_of_improvement(ours: Sequence[Array], theirs: Sequence[Array]) -> float:
    """Chance that a run of ours is better than theirs on the same CMDP and seed; ties count half.

    Where there are other numbers of seeds, than any of theirs on the same CMDP.
    """

    def wins(a: Array, b: Array) -> float:
        a = a if len(a) == len(b) else a[:, None]
        return float(np.mean((a > b) + 0.5 * (a == b)))

    return float(np.mean([wins(a, b) for a, b in zip(ours, theirs, strict=True)]))


def _resampled(scores: Sequence[Array]) -> Array:
    """(B, sum S_t): seeds drawn with replacement within each CMDP."""
    rng = np.random.default_rng(_SEED)
    return np.hstack([s[rng.integers(len(s), size=(RESAMPLES, len(s)))] for s in scores])


def _interval(value: float, drawn: Array, scores: Sequence[Array]) -> Estimate:
    if min(len(s) for s in scores) < 2:
        return Estimate(value, None, None)
    tail = (1.0 - CONFIDENCE) / 2.0
    low, high = np.quantile(drawn, [tail, 1.0 - tail])
    return Estimate(value, float(low), float(high))
