"""Records of a comparison: numbers first, tables and figures are drawn from these.

What each number means is in `mbtl.benchmark.summary`; `to_json` gives the document of `mbtl bench`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from mbtl.arrays import Array
from mbtl.errors import missing_extra

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


@dataclass(frozen=True)
class Estimate:
    """A number and its interval; None where it does not exist."""

    value: float | None
    low: float | None
    high: float | None

    def to_json(self) -> dict[str, Any]:
        """JSON-able record."""
        return {"value": self.value, "low": self.low, "high": self.high}


@dataclass(frozen=True)
class Trainings:
    """Number of trainings until a level is reached.

    Attributes:
        estimate: geometric mean, censored seeds as K + 1.
        censored: number of seeds that did not reach the level within K.
        per_seed: each seed's number; None when censored.
    """

    estimate: Estimate
    censored: int
    per_seed: tuple[int | None, ...]

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


@dataclass(frozen=True, repr=False)
class Comparison:
    """Every run of a comparison, and its summary; shown, it is the table of `mbtl bench`."""

    results: tuple[Run, ...]
    summary: Summary

    def __repr__(self) -> str:
        from mbtl.benchmark.tables import comparison_text  # draws these records

        return comparison_text(self)

    def to_json(self) -> dict[str, Any]:
        """The document that `mbtl bench --json` prints."""
        return {
            "results": [run.to_json() for run in self.results],
            "summary": self.summary.to_json(),
        }

    def to_frame(self) -> Any:
        """A pandas table, a line per run and training: k, the source, and V after it.

        A run of `random` is one order; the tables show Random's exact expectation.

        Raises:
            MissingExtra: pandas is not installed.
        """
        try:
            import pandas
        except ModuleNotFoundError as error:
            raise missing_extra("pandas", "frames") from error
        lines = [
            (run.matrix, run.matrix_seed, run.selector, run.seed, k, source, float(value))
            for run in self.results
            for k, (source, value) in enumerate(zip(run.sources, run.performance, strict=True), 1)
        ]
        heads = ["matrix", "matrix_seed", "selector", "seed", "k", "source", "V"]
        return pandas.DataFrame(lines, columns=heads)

    def plot(self, matrix: str | None = None, *, ax: Any = None) -> Any:
        """V against k of every selector on one matrix; see `mbtl.plot.comparison`."""
        from mbtl.plot import comparison

        return comparison(self, matrix, ax=ax)
