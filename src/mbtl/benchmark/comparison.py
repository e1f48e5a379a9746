"""A whole comparison: its runs, its summary, and what people do with them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from mbtl.arrays import Array
from mbtl.benchmark.difference import difference
from mbtl.benchmark.oracle import Reference
from mbtl.benchmark.records import Difference, Run, Summary
from mbtl.errors import missing_extra


@dataclass(frozen=True, repr=False)
class Comparison:
    """Every run of a comparison, and its summary; shown, it is the table of `mbtl bench`.

    Attributes:
        results: every run; one of `random` is one order of many.
        summary: what the table shows.
        curves: matrix -> selector -> (S, K) V of each matrix seed: the mean over selector seeds,
            and Random's exact expectation over all orders.
        references: matrix -> levels and reference curves of each matrix seed.
    """

    results: tuple[Run, ...]
    summary: Summary
    curves: Mapping[str, Mapping[str, Array]]
    references: Mapping[str, Sequence[Reference]]

    def __repr__(self) -> str:
        from mbtl.benchmark.tables import comparison_text  # draws this

        return comparison_text(self)

    def to_json(self) -> dict[str, Any]:
        """The document that `mbtl bench --json` prints."""
        return {
            "results": [run.to_json() for run in self.results],
            "summary": self.summary.to_json(),
        }

    def difference(self, selector: str, against: str) -> Difference:
        """How far one selector is ahead of another on the same matrix seeds, with intervals.

        Args:
            selector: name of one that was compared.
            against: name of another.

        Raises:
            UnknownName: one of them was not compared.
        """
        return difference(self, selector, against)

    def to_frame(self) -> Any:
        """A pandas table, a line per run and training: k, the source, and V after it.

        Random is exact, as in the table: its V is the mean over all orders, and it has no source.
        The orders that were drawn are in `results`.

        Raises:
            MissingExtra: pandas is not installed.
        """
        try:
            import pandas
        except ModuleNotFoundError as error:
            raise missing_extra("pandas", "frames") from error
        lines: list[tuple[Any, ...]] = []
        for run in self.results:
            sources: Sequence[int | None] = run.sources
            values = run.performance
            if run.selector == "random":
                if run.seed > 0:
                    continue
                sources = [None] * len(sources)
                values = self.curves[run.matrix]["random"][run.matrix_seed]
            head = (run.matrix, run.matrix_seed, run.selector, run.seed)
            lines += [
                (*head, k, source, float(value))
                for k, (source, value) in enumerate(zip(sources, values, strict=True), 1)
            ]
        heads = ["matrix", "matrix_seed", "selector", "seed", "k", "source", "V"]
        return pandas.DataFrame(lines, columns=heads).astype({"source": "Int64"})

    def plot(self, matrix: str | None = None, *, ax: Any = None) -> Any:
        """V against k of every selector on one matrix; see `mbtl.plot.comparison`."""
        from mbtl.plot import comparison

        return comparison(self, matrix, ax=ax)
