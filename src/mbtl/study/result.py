"""What a run gave."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from mbtl.arrays import Array
from mbtl.study.closing_report import FreshValue
from mbtl.study.lines import Trainings
from mbtl.study.records import Failure

if TYPE_CHECKING:
    from mbtl.portfolio import Portfolio
    from mbtl.study.study import Study


@dataclass(frozen=True, eq=False, repr=False)
class RunResult:
    """A study when a run of it has ended.

    Attributes:
        study: that was run.
        curve: (k,) the running estimate of V after each row, performance.
        fresh: V on fresh episodes, which chose nothing: the one to tell people; None: not measured.
        trainings: all of the study, those of earlier runs too.
        failures: of the study, those of trainings ended early on purpose too.
        stop_reason: why no more is trained; None: others are still at it.
        seconds: wall time of this run.
    """

    study: Study
    curve: Array
    fresh: FreshValue | None
    trainings: Trainings
    failures: tuple[Failure, ...]
    stop_reason: str | None
    seconds: float

    @property
    def value(self) -> float:
        """V at the end, as `Study.value`: fresh if played, else the running estimate."""
        if self.fresh is not None:
            return self.fresh.value
        return float(self.curve[-1]) if len(self.curve) else float("-inf")

    def portfolio(self) -> Portfolio:
        """The trained policies with their router; see `Study.portfolio`."""
        return self.study.portfolio()

    def __repr__(self) -> str:
        where = "on fresh episodes" if self.fresh is not None else "estimated"
        failed = f", {len(self.failures)} failed" if self.failures else ""
        return (
            f"RunResult({self.study.name!r}: {len(self.curve)} trainings told{failed}, "
            f"V = {self.value:.4f} {where}, {self.seconds:.1f} s; {self.stop_reason})"
        )

    def _repr_html_(self) -> str:
        return self.trainings.html(repr(self))
