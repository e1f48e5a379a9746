"""Live display of a study that is paid in steps: what runs, paused or stopped, and why."""

from __future__ import annotations

from collections.abc import Sequence
from types import TracebackType

from rich.console import Console, Group
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from mbtl.actions import Policy, StartOn
from mbtl.cli.common import LongWork
from mbtl.contexts.words import describe_set
from mbtl.study.steps.callbacks import PrintSteps
from mbtl.study.steps.prices import share_of
from mbtl.study.steps.state import UnderWay
from mbtl.study.steps.study import StepStudy
from mbtl.study.steps.summary import begun_from, condition, counted, where_of
from mbtl.trainer import Progress

_MOST = 12
"""Trainings that are shown: the latest ones."""


class StepProgress(PrintSteps):
    """A table on a terminal, and in any case a line for each piece of work, which stays."""

    def __init__(self, console: Console) -> None:
        """Nothing is shown yet."""
        super().__init__(self._print)
        self._console, self._work = console, LongWork(console)
        self._live = Live(console=console, transient=True, refresh_per_second=4)
        self._now = ""
        self._under_way: tuple[int, float] | None = None

    def __enter__(self) -> StepProgress:
        if self._console.is_terminal:
            self._live.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._live.stop()

    def on_training(self, study: StepStudy, training: int, source: int, to: int) -> None:
        """The line of a training that begins has no place in the log yet."""
        if training < len(study.state.trainings):
            where = where_of(study, training)
        else:
            *_, held = (h for h in study.state.under_way.values() if _is_of_worker(study, h))
            on = held.work.sources if isinstance(held.work, StartOn) else (source,)
            where = describe_set(study.space, on)
            if (begun := study.state.start_of(held)) is not None:
                where = f"{where}, {begun_from(study, begun)}"
        self._say(study, f"training {training + 1} ({where}) runs to {counted(to)} steps")

    def on_progress(self, study: StepStudy, training: int, progress: Progress) -> None:
        """How far it is, and its latest return."""
        self._under_way = training, progress.step
        scores = [f", return {v:.0f}" for k, v in progress.metrics.items() if "return" in k]
        self._say(
            study, f"training {training + 1}: {counted(progress.step)} steps{''.join(scores)}"
        )

    def on_trained(self, study: StepStudy, training: int) -> None:
        """A line that stays where it stands still; a mark on the way is only shown."""
        self._under_way = None
        if training < len(study.state.trainings) and study.state.work_on(training) is None:
            super().on_trained(study, training)
        self._show(study)

    def on_evaluation(self, study: StepStudy, policy: Policy, targets: Sequence[int]) -> None:
        """Which policy, on how many targets."""
        self._say(study, f"evaluating training {policy.training + 1} on {len(targets)} contexts")

    def on_evaluated(self, study: StepStudy, policy: Policy) -> None:
        """A line that stays."""
        super().on_evaluated(study, policy)
        self._show(study)

    def on_report(self, study: StepStudy) -> None:
        """The last work."""
        self._say(study, "measuring V on fresh episodes, which is not charged")

    def _say(self, study: StepStudy, now: str) -> None:
        self._now = now
        self._work.say(f"{self._spent(study)}  {now}")
        self._show(study)

    def _print(self, line: str) -> None:
        self._console.print(line, markup=False, highlight=False, soft_wrap=True)

    def _show(self, study: StepStudy) -> None:
        if not self._live.is_started:
            return
        state = study.state
        table = Table.grid(padding=(0, 2))
        every = list(range(len(state.trainings)))
        for number in every[-_MOST:]:
            course = state.trainings[number]
            kind, why = condition(study, number)
            steps = float(course.steps)
            if self._under_way is not None and self._under_way[0] == number:
                steps = max(steps, self._under_way[1])
            most = state.lengths_of(number)[-1] * share_of(state, number)
            bar = ProgressBar(most, min(steps, most), width=16)
            where = where_of(study, number)
            table.add_row(str(number + 1), Text(where), bar, counted(steps), kind, Text(why))
        prices = state.prices
        share = prices.evaluation / max(state.spent, 1.0)
        value = f", V {study.value:.4f}" if state.policies else ""
        head = Text(f"{self._spent(study)}{value}, {share:.0%} of them evaluation")
        self._live.update(Group(head, table, Text(self._now, style="dim")))


def _is_of_worker(study: StepStudy, held: UnderWay) -> bool:
    return held.lease is None or held.lease.worker == study.worker
