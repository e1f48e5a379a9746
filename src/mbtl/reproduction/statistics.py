"""Statistics over many CMDPs and few seeds: the interquartile mean and its bootstrap.

Agarwal et al. (NeurIPS 2021): the mean of the middle half of all runs, which one odd CMDP cannot
move, with a bootstrap that draws seeds within each CMDP.

Notation (shapes): T CMDPs (tasks) with S_t seeds each.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mbtl.arrays import Array

RESAMPLES = 2000
CONFIDENCE = 0.95
_SEED = 20240604


@dataclass(frozen=True)
class Interval:
    """A value and its 95 % bootstrap interval; None where one seed leaves the scatter unknown."""

    value: float
    low: float | None
    high: float | None

    def to_json(self) -> dict[str, float | None]:
        """JSON-able record."""
        return {"value": self.value, "low": self.low, "high": self.high}


def interquartile_mean(scores: Array) -> Array:
    """Mean of the middle half of the values along the last axis.

    A quarter of the values, rounded down, is cut from each end.
    """
    ordered = np.sort(np.asarray(scores, dtype=np.float64), axis=-1)
    cut = ordered.shape[-1] // 4
    return np.asarray(ordered[..., cut : ordered.shape[-1] - cut].mean(axis=-1))


def pooled(scores: Sequence[Array]) -> Interval:
    """Interquartile mean of all runs of all CMDPs, with its bootstrap interval.

    Args:
        scores: (S_t,) per CMDP.
    """
    value = float(interquartile_mean(np.concatenate(scores)))
    drawn = interquartile_mean(_resampled(scores))
    return _interval(value, drawn, scores)


def pooled_mean(scores: Sequence[Array]) -> Interval:
    """Mean over CMDPs of their means over seeds, with its bootstrap interval."""
    value = float(np.mean([s.mean() for s in scores]))
    sizes = np.cumsum([len(s) for s in scores])[:-1]
    parts = np.split(_resampled(scores), sizes, axis=1)
    drawn = np.mean([part.mean(axis=1) for part in parts], axis=0)
    return _interval(value, drawn, scores)


def probability_of_improvement(ours: Sequence[Array], theirs: Sequence[Array]) -> float:
    """Chance that a run of ours is better than one of theirs on the same CMDP; ties count half."""
    return float(
        np.mean(
            [
                np.mean((a[:, None] > b) + 0.5 * (a[:, None] == b))
                for a, b in zip(ours, theirs, strict=True)
            ]
        )
    )


def _resampled(scores: Sequence[Array]) -> Array:
    """(B, sum S_t): seeds drawn with replacement within each CMDP."""
    rng = np.random.default_rng(_SEED)
    return np.hstack([s[rng.integers(len(s), size=(RESAMPLES, len(s)))] for s in scores])


def _interval(value: float, drawn: Array, scores: Sequence[Array]) -> Interval:
    if min(len(s) for s in scores) < 2:
        return Interval(value, None, None)
    tail = (1.0 - CONFIDENCE) / 2.0
    low, high = np.quantile(drawn, [tail, 1.0 - tail])
    return Interval(value, float(low), float(high))
