"""Callbacks: what a run tells the outside while it goes on. Every method may be left out."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

import numpy as np

from mbtl.errors import missing_extra
from mbtl.faults import say
from mbtl.study.database import database_file, shown
from mbtl.trainers.contract import Progress, Trainer

if TYPE_CHECKING:
    from mbtl.study.closing_report import ReportPlan
    from mbtl.study.records import Pick
    from mbtl.study.study import Study


_LEAST_FREEDOM = 10
"""Degrees of freedom, of contexts and their episodes, below which an interval says little."""


class Callback:
    """Base with methods that do nothing.

    `study.stop(reason)` in any of them ends the run when what is under way is told; raising
    `TrainingPruned` in `on_progress` ends that training alone. Other exceptions end the run at
    once, and nothing is lost.
    """

    def on_shared(self, study: Study, others: Sequence[str]) -> None:
        """The run begins while other processes work on the same study; they share its picks."""

    def on_note(self, study: Study, words: str) -> None:
        """A sentence that people should read."""

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

    def on_pruned(self, study: Study, pick: Pick, reason: str) -> None:
        """A training was ended early on purpose; who does not tell it apart hears of a failure."""
        self.on_failed(study, pick, reason)

    def on_lost(self, study: Study, pick: Pick) -> None:
        """A pick was taken over or taken away; its training counts for nothing."""

    def on_stuck(self, study: Study, pick: Pick, reason: str) -> None:
        """A training did not end at its time limit, and counts as failed. From another thread.

        This process can do nothing more until its native code returns: what is worth having is to
        be saved here, or the process ended.
        """

    def on_waiting(self, study: Study, others: Sequence[str]) -> None:
        """Nothing is left to do but what others are at; the run waits for them, or does it."""

    def on_report(self, study: Study, plan: ReportPlan) -> None:
        """The policies are now evaluated on fresh seeds, as often as the plan says."""

    def on_report_failed(self, study: Study, reason: str) -> None:
        """That evaluation failed; V on fresh episodes stays unknown."""

    def on_end(self, study: Study) -> None:
        """The run ends, also by an interrupt."""


class PrintProgress(Callback):
    """A line per pick, for people.

    `pick 3 of 5: gravity = 7.5 m/s2, V = 0.8312 +- 0.0140, estimated (gain 0.0210)`

    Args:
        file: to print to; None: standard error, as it is at that moment.
    """

    def __init__(self, file: TextIO | None = None) -> None:
        self._file = file

    def on_shared(self, study: Study, others: Sequence[str]) -> None:
        """Who else works here."""
        self._say(shared_words(others), style="yellow")

    def on_note(self, study: Study, words: str) -> None:
        """The sentence."""
        self._say(words)

    def on_told(self, study: Study, pick: Pick) -> None:
        """V, and what the new policy added to it."""
        curve = study.curve
        gain = f" (gain {curve[-1] - curve[-2]:.4f})" if len(curve) > 1 else ""
        self._say(f"{where(study, pick)}, {estimate(study)}{gain}", pick)

    def on_failed(self, study: Study, pick: Pick, reason: str) -> None:
        """Why there is no V."""
        self._say(f"{where(study, pick)} failed: {reason}", pick, "red")

    def on_pruned(self, study: Study, pick: Pick, reason: str) -> None:
        """Why there is no V, and that it is meant so."""
        self._say(f"{where(study, pick)} was ended early: {reason}", pick, "yellow")

    def on_lost(self, study: Study, pick: Pick) -> None:
        """That the work was for nothing."""
        self._say(f"{where(study, pick)} was taken over by somebody else", pick, "yellow")

    def on_stuck(self, study: Study, pick: Pick, reason: str) -> None:
        """Why nothing happens, and what helps."""
        self._say(
            f"{where(study, pick)} failed: {reason}; end this process and run again to go on: "
            "worker processes (Workers(2)) would be killed"
        )

    def on_waiting(self, study: Study, others: Sequence[str]) -> None:
        """Why nothing happens."""
        self._say(waiting_words(study, others))

    def on_report(self, study: Study, plan: ReportPlan) -> None:
        """How much is evaluated."""
        self._say(f"measuring V on fresh episodes: {plan}")

    def on_report_failed(self, study: Study, reason: str) -> None:
        """Why V stays an estimate."""
        self._say(f"V on fresh episodes could not be measured: {reason}", style="red")

    def _say(self, line: str, ended: Pick | None = None, style: str | None = None) -> None:
        """One line; of a pick that has ended, where it says so."""
        say(line, sys.stderr if self._file is None else self._file)


class TensorBoardCallback(Callback):
    """TensorBoard for a study: the metrics of each training, and some numbers per pick.

    These are `study/V`, the running estimate, `study/V_margin`, half its 95 % interval where it is
    known, `study/source` and `study/training_performance`.

    Args:
        folder: where TensorBoard looks.

    Raises:
        MissingExtra: tensorboard is not installed.
    """

    def __init__(self, folder: Path) -> None:
        try:
            from torch.utils.tensorboard import SummaryWriter
        except ModuleNotFoundError as error:
            raise missing_extra("tensorboard", "train") from error
        self._writer: Any = SummaryWriter(str(folder / "study"))

    def on_progress(self, study: Study, pick: Pick, progress: Progress) -> None:
        """Metrics of one training, under its source."""
        with suppress(OSError):  # of a full disk, as below: pictures are not worth the study
            for name, value in progress.metrics.items():
                self._writer.add_scalar(f"source-{pick.source:04d}/{name}", value, progress.step)

    def on_told(self, study: Study, pick: Pick) -> None:
        """One point per pick."""
        k = len(study.state.rows)
        now = study.routing.value
        own = float(study.history.training_performance[-1])
        with suppress(OSError):
            self._writer.add_scalar("study/V", now.value, k)
            if study.routing.noise_is_known:
                self._writer.add_scalar("study/V_margin", now.margin, k)
            self._writer.add_scalar("study/source", pick.source, k)
            self._writer.add_scalar("study/training_performance", own, k)
            self._writer.flush()

    def on_end(self, study: Study) -> None:
        """Close the file."""
        with suppress(OSError):
            self._writer.close()


def where(study: Study, pick: Pick) -> str:
    """A pick for people, who count from 1: "pick 3 of 5: gravity = 7.5 m/s2"."""
    return f"{numbered(study, pick)}: {said(study, pick)}"


def numbered(study: Study, pick: Pick, of: str = " of ") -> str:
    """Which pick it is: "pick 3 of 5", or "pick 3, 2.5 of 4 units" where they differ in price."""
    spec = study.spec
    if spec.steps is None and not spec.any_training:
        return f"pick {pick.number + 1}{of}{spec.budget}"
    return f"pick {pick.number + 1}, {study.state.spent_words()}"


def said(study: Study, pick: Pick) -> str:
    """What is trained, from what and how long; see `StudyState.said`."""
    return study.state.said(study.state.picks[pick.number])


def estimate(study: Study) -> str:
    """V while a study runs, in words, with half its 95 % interval: "V = 0.8312 +- 0.0140"."""
    now = study.routing.value
    bar = f" +- {now.margin:.4f}" if now.margin > 0.0 else ""
    return f"V = {now.value:.4f}{bar}, estimated"


def few_episodes(study: Study, trainer: Trainer) -> str | None:
    """That few episodes say little of chance; None: they say enough, or it was said.

    It is said before the first training where the trainer knows how many it plays (its attribute
    `eval_episodes`), and else after that.
    """
    rows, episodes = study.state.rows, getattr(trainer, "eval_episodes", None)
    contexts = study.spec.eval_targets or study.space.n
    if len(rows) != (1 if episodes is None else 0):
        return None
    if episodes is None:
        episodes, contexts = rows[0].episodes, int(np.isfinite(rows[0].returns).sum())
    if (episodes - 1) * contexts >= _LEAST_FREEDOM:
        return None
    if episodes == 1:
        return "one episode per context says nothing of chance: play 2 or more to know V's error"
    return f"{episodes} episodes of so few contexts say little of chance: play more"


def shared_words(others: Sequence[str]) -> str:
    """That other workers are at a study, in a sentence."""
    works = "works" if len(others) == 1 else "work"
    return f"{', '.join(others)} {works} on this study, too: joining, each trains other picks"


def waiting_words(study: Study, others: Sequence[str]) -> str:
    """What a run waits for, and how not to wait for a worker of whose end nobody would know."""
    said = f"waiting for the last trainings of {', '.join(others)}"
    unknown = [one for one in others if not study.presence.is_known(one)]
    if not unknown:
        return said
    return (
        f"{said}; if {unknown[0]} has ended, `mbtl study release {place_words(study)} {unknown[0]}`"
        " hands them out at once, and else its silence is waited for"
    )


def place_words(study: Study) -> str:
    """What names a stored study on the command line."""
    url = getattr(study.log, "url", "")
    file = database_file(url)
    if file is None:
        return f"{shlex.quote(shown(url))} --name {shlex.quote(study.name)}"
    return shlex.quote(str(file.parent if file.name == "study.db" else file))
