"""Records of a comparison: numbers first, tables and figures are drawn from these.

What each number means is in `mbtl.benchmark.summary`; `to_json` gives the document of `mbtl bench`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from mbtl.arrays import Array

CONFIDENCE = 0.95
RESAMPLES = 10_000


@dataclass(frozen=True)
class Run:
    """One selector on one matrix seed.

    Attributes:
        matrix: path or id as given.
        matrix_seed: position along the seed axis.
        selector: selector name.
        seed: selector seed; 0 for a deterministic selector.
        theta: slope that the selector was told, performance per grid step.
        sources: (K,) 0-based picks in order.
        performance: (K,) V_1..V_K, normalised, not clipped.
        select_seconds: total wall time of the K proposals.
    """

    matrix: str
    matrix_seed: int
    selector: str
    seed: int
    theta: float
    sources: tuple[int, ...]
    performance: Array
    select_seconds: float

    def to_json(self) -> dict[str, Any]:
        """JSON-able record."""
        return {
            "matrix": self.matrix,
            "matrix_seed": self.matrix_seed,
            "selector": self.selector,
            "seed": self.seed,
            "theta": self.theta,
            "sources": list(self.sources),
            "performance": self.performance.tolist(),
            "select_seconds": self.select_seconds,
        }


@dataclass(frozen=True, repr=False)
class Estimate:
    """A number and its 95 % interval, `low` to `high`; None where it does not exist."""

    value: float | None
    low: float | None
    high: float | None

    def __repr__(self) -> str:
        if self.value is None:
            return "none"
        interval = "" if self.low is None else f" [{self.low:.4g}, {self.high:.4g}]"
        return f"{self.value:.4g}{interval}"

    def to_json(self) -> dict[str, Any]:
        """JSON-able record."""
        return {"value": self.value, "low": self.low, "high": self.high}


@dataclass(frozen=True, repr=False)
class Trainings:
    """Number of trainings until a level is reached.

    Attributes:
        estimate: geometric mean, censored seeds as K + 1; so a lower bound where any is censored.
        censored: number of seeds that did not reach the level within K.
        per_seed: each matrix seed's number; None when censored.
    """

    estimate: Estimate
    censored: int
    per_seed: tuple[int | None, ...]

    def __repr__(self) -> str:
        seeds = ", ".join("never" if k is None else str(k) for k in self.per_seed)
        if self.censored == 0:
            return f"{self.estimate!r} (by seed: {seeds})"
        least = "" if self.estimate.value is None else f">{self.estimate.value:.4g} "
        missing = f"{self.censored} of {len(self.per_seed)} seeds"
        return f"{least}({missing} did not get there; by seed: {seeds})"

    def to_json(self) -> dict[str, Any]:
        """JSON-able record."""
        return {
            **self.estimate.to_json(),
            "censored": self.censored,
            "per_seed": list(self.per_seed),
        }


@dataclass(frozen=True)
class SelectorSummary:
    """One selector on one matrix, or pooled; `mbtl.benchmark.summary` has every formula."""

    V_K: Estimate
    V_mean: Estimate
    k_star: Trainings
    k90: Trainings
    k95: Trainings
    k99: Trainings
    minus_random_at_K: Estimate
    minus_random_mean: Estimate
    closed_at_K: Estimate
    closed_under_curve: Estimate

    def to_json(self) -> dict[str, Any]:
        """JSON-able record."""
        return {
            "V_K": self.V_K.to_json(),
            "V_mean": self.V_mean.to_json(),
            "k_star": self.k_star.to_json(),
            "k90": self.k90.to_json(),
            "k95": self.k95.to_json(),
            "k99": self.k99.to_json(),
            "minus_random": {
                "at_K": self.minus_random_at_K.to_json(),
                "mean": self.minus_random_mean.to_json(),
            },
            "closed_fraction": {
                "at_K": self.closed_at_K.to_json(),
                "under_curve": self.closed_under_curve.to_json(),
            },
        }


@dataclass(frozen=True)
class Lead:
    """How far one selector is ahead of another, > 0 where it is better.

    Attributes:
        V_K: in V after the last training.
        V_mean: in V, mean over k = 1..K.
        closed_at_K: in the closed fraction, after the last training.
        closed_under_curve: in the closed fraction, over all trainings.
        per_seed: in mean V, of each matrix seed.
    """

    V_K: Estimate
    V_mean: Estimate
    closed_at_K: Estimate
    closed_under_curve: Estimate
    per_seed: tuple[float, ...]

    @property
    def ahead(self) -> int:
        """Number of matrix seeds where it is ahead."""
        return sum(lead > 0.0 for lead in self.per_seed)

    def to_json(self) -> dict[str, Any]:
        """JSON-able record."""
        return {
            "V_K": self.V_K.to_json(),
            "V_mean": self.V_mean.to_json(),
            "closed_fraction": {
                "at_K": self.closed_at_K.to_json(),
                "under_curve": self.closed_under_curve.to_json(),
            },
            "per_seed": list(self.per_seed),
        }


@dataclass(frozen=True, repr=False)
class Difference:
    """One selector less another, paired: both saw the same matrix seeds.

    Attributes:
        selector: the one.
        against: the other.
        matrices: by matrix; intervals over its seeds, drawn anew with replacement.
        pooled: mean over the matrices; intervals over the seeds of these matrices.
        over_matrices: the same means; intervals over the matrices, which are drawn anew, too: what
            to expect on another problem of this kind. No interval with fewer than three.
    """

    selector: str
    against: str
    matrices: Mapping[str, Lead]
    pooled: Lead
    over_matrices: Lead

    def __repr__(self) -> str:
        from mbtl.benchmark.tables import difference_text  # draws these records

        return difference_text(self)

    def to_json(self) -> dict[str, Any]:
        """JSON-able record."""
        return {
            "selector": self.selector,
            "against": self.against,
            "matrices": {name: lead.to_json() for name, lead in self.matrices.items()},
            "pooled": self.pooled.to_json(),
            "over_matrices": self.over_matrices.to_json(),
        }


@dataclass(frozen=True)
class MatrixSummary:
    """One matrix: its levels and reference curves (means over seeds), and every selector.

    Attributes:
        n_seeds: number of matrix seeds S.
        independent: see `Levels`; so for the next two.
        random: (K,) expected V of Random.
        oracle: (K,) V of the Sequential Oracle.
        selectors: by selector name.
        references: V of the reference rows by name; see `mbtl.benchmark.references`.
        caveat: what must be said beside these numbers; None where there is nothing to say.
    """

    n_seeds: int
    independent: float
    oracle_transfer: float
    grand_mean: float
    random: Array
    oracle: Array
    selectors: Mapping[str, SelectorSummary]
    references: Mapping[str, float] = field(default_factory=dict)
    caveat: str | None = None

    def to_json(self) -> dict[str, Any]:
        """JSON-able record."""
        return {
            "matrix_seeds": self.n_seeds,
            "levels": {
                "independent": self.independent,
                "oracle_transfer": self.oracle_transfer,
                "grand_mean": self.grand_mean,
            },
            "references": dict(self.references),
            "caveat": self.caveat,
            "curves": {"random": self.random.tolist(), "oracle": self.oracle.tolist()},
            "selectors": {name: s.to_json() for name, s in self.selectors.items()},
        }


@dataclass(frozen=True)
class Summary:
    """All of a comparison: per matrix, and pooled over the matrices."""

    budget: int
    matrices: Mapping[str, MatrixSummary]
    pooled: Mapping[str, SelectorSummary]

    def to_json(self) -> dict[str, Any]:
        """JSON-able record."""
        return {
            "budget": self.budget,
            "interval": {
                "method": "percentile bootstrap over matrix seeds, shared by all selectors",
                "level": CONFIDENCE,
                "resamples": RESAMPLES,
            },
            "matrices": {name: m.to_json() for name, m in self.matrices.items()},
            "pooled": {name: s.to_json() for name, s in self.pooled.items()},
        }
