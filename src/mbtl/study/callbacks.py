"""Callbacks: what a run tells the outside while it goes on. Every method may be left out."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtl.trainer import Progress

if TYPE_CHECKING:
    from mbtl.study.pick import Pick
    from mbtl.study.study import Study


class Callback:
    """Base with methods that do nothing; exceptions in a callback end the run, nothing is lost."""

    def on_pick(self, study: Study, pick: Pick) -> None:
        """A pick was asked for and its training starts."""

    def on_progress(self, study: Study, pick: Pick, progress: Progress) -> None:
        """A training reports; only trainings in this process do."""

    def on_evaluation(self, study: Study, pick: Pick) -> None:
        """Training is done, evaluation on all contexts starts."""

    def on_told(self, study: Study, pick: Pick) -> None:
        """The row of a pick was recorded."""

    def on_failed(self, study: Study, pick: Pick, reason: str) -> None:
        """A training failed, or a trained policy could not be evaluated; it was recorded."""

    def on_report(self, study: Study) -> None:
        """The policies are now evaluated on fresh seeds."""

    def on_report_failed(self, study: Study, reason: str) -> None:
        """That evaluation failed; V on fresh episodes stays unknown."""

    def on_end(self, study: Study) -> None:
        """The run ends, also by an interrupt."""
