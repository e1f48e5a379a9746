"""Who is told what happens in a run that is paid in steps."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from mbtl.actions import Policy
from mbtl.faults import say
from mbtl.study.callbacks import waiting_words
from mbtl.study.steps.summary import counted, training_words
from mbtl.trainer import Progress

if TYPE_CHECKING:
    from mbtl.study.steps.study import StepStudy


class StepCallback:
    """Told what happens in a run; override what you need."""

    def on_training(self, study: StepStudy, training: int, source: int, to: int) -> None:
        """A training begins, or goes on, towards so many steps."""

    def on_progress(self, study: StepStudy, training: int, progress: Progress) -> None:
        """It reports."""

    def on_trained(self, study: StepStudy, training: int) -> None:
        """It has passed a mark, ended, or failed."""

    def on_evaluation(self, study: StepStudy, policy: Policy, targets: Sequence[int]) -> None:
        """A policy is about to be evaluated."""

    def on_evaluated(self, study: StepStudy, policy: Policy) -> None:
        """It was."""

    def on_waiting(self, study: StepStudy) -> None:
        """Others are at work, and nothing can be decided before that has brought something."""

    def on_report(self, study: StepStudy) -> None:
        """V is about to be measured on fresh episodes."""

    def on_end(self, study: StepStudy) -> None:
        """The run is over."""


class PrintSteps(StepCallback):
    """A line per piece of work."""

    def __init__(self, write: Callable[[str], Any] | None = None) -> None:
        """`write` takes a line; None: to standard error."""
        self._write = write or (lambda line: say(line, sys.stderr))

    def on_trained(self, study: StepStudy, training: int) -> None:
        """Which, how far, and why it stands."""
        if training < len(study.state.trainings):
            self._write(f"{self._spent(study)}  {training_words(study, training)}")

    def on_evaluated(self, study: StepStudy, policy: Policy) -> None:
        """Where, and V by it."""
        row = study.state.returns[study.state.policies.index(policy)]
        _, mark = study.state.trainings[policy.training].at(policy.length)
        self._write(
            f"{self._spent(study)}  training {policy.training + 1} at {counted(mark.steps)} steps, "
            f"evaluated on {int(np.isfinite(row).sum())} contexts: V {study.value:.4f}"
        )

    def on_waiting(self, study: StepStudy) -> None:
        """For whom."""
        others = sorted({lease.worker for lease in study.leases})
        self._write(f"{self._spent(study)}  {waiting_words(study, others)}")

    def on_end(self, study: StepStudy) -> None:
        """Why no more is done."""
        if study.state.stopped:
            self._write(f"{self._spent(study)}  {study.state.stopped}")

    @staticmethod
    def _spent(study: StepStudy) -> str:
        return f"{counted(study.state.spent):>6} of {counted(study.spec.budget)} steps"
