"""Live progress of a study: which pick, how far its training is, V so far, time left."""

from __future__ import annotations

import math
import os
import time

from rich.console import Console
from rich.progress import BarColumn, TaskID, TextColumn, TimeRemainingColumn
from rich.progress import Progress as Bars

from mbtl.cli.common import LongWork
from mbtl.study import Pick, Study
from mbtl.study.study import PrintProgress, estimate
from mbtl.trainers.contract import Progress


class LiveProgress(PrintProgress):
    """Two bars on a terminal; where there is none, lines: per finished pick, and per minute."""

    def __init__(self, study: Study, console: Console) -> None:
        super().__init__()
        self._console = console
        self._bars = Bars(
            TextColumn("{task.description}", markup=False),
            BarColumn(bar_width=20),
            TextColumn("{task.percentage:>3.0f}%"),
            TimeRemainingColumn(),
            TextColumn("{task.fields[note]}", markup=False),
            console=console,
            transient=True,
            speed_estimate_period=math.inf,
        )
        self._study_bar = self._bars.add_task(
            "study", total=study.spec.cost_budget or study.spec.steps or study.spec.budget, note=""
        )
        self._bars.update(self._study_bar, completed=_spent(study))
        self._pick_bars: dict[int, TaskID] = {}
        self._begun: dict[int, float] = {}
        self._shares: dict[int, float] = {}
        self._work = LongWork(console)

    def __enter__(self) -> LiveProgress:
        self._bars.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._bars.stop()

    def on_pick(self, study: Study, pick: Pick) -> None:
        """A bar for the new pick."""
        self._begun[pick.number], self._shares[pick.number] = time.monotonic(), 0.0
        if pick.number in self._pick_bars:  # it failed, and is begun again
            self._bars.remove_task(self._pick_bars[pick.number])
        label = f"pick {pick.number + 1}: {_said(study, pick)}"
        self._pick_bars[pick.number] = self._bars.add_task(label, total=1.0, note="training")
        self._update(study)

    def on_progress(self, study: Study, pick: Pick, progress: Progress) -> None:
        """Steps or episodes done, and the latest return or score."""
        share = progress.step / max(progress.total, 1)
        scores = [f"return {v:.0f}" for k, v in progress.metrics.items() if "return" in k]
        scores += [f"score {v:.2f}" for k, v in progress.metrics.items() if k == "score"]
        note = f"{progress.step:,}/{progress.total:,} {progress.unit} {' '.join(scores)}"
        self._bars.update(self._pick_bars[pick.number], completed=0.97 * share, note=note)
        self._shares[pick.number] = share
        self._update(study)
        self._work.say(f"{study.state.numbered(pick, '/')}  {_said(study, pick)}  {note}")

    def on_evaluation(self, study: Study, pick: Pick) -> None:
        """Training is done."""
        note = f"evaluating on {len(pick.targets or study.space.contexts)} contexts"
        self._bars.update(self._pick_bars[pick.number], completed=0.97, note=note)

    def on_told(self, study: Study, pick: Pick) -> None:
        """V, how long it took and why it was chosen."""
        took = time.monotonic() - self._begun[pick.number]
        head = f"{study.state.numbered(pick, '/')}  {_said(study, pick):<24}"
        self._say(f"{head}  {estimate(study)}  {took / 60:.1f} min  {pick.reason}", pick)
        self._update(study)

    def on_stuck(self, study: Study, pick: Pick, reason: str) -> None:
        """Its failure is recorded, and the process can only be ended: nothing else would be."""
        why = f"{reason}. This process ends, since it cannot go on; the same command does"
        self.on_failed(study, pick, why)
        os._exit(1)

    def _say(self, line: str, ended: Pick | None = None, style: str | None = None) -> None:
        """One line that stays; the bar of a pick that has ended goes."""
        if ended is not None:
            self._bars.remove_task(self._pick_bars.pop(ended.number))
            self._begun.pop(ended.number)
            self._shares.pop(ended.number)
        self._console.print(line, style=style, markup=False, highlight=False, soft_wrap=True)

    def _update(self, study: Study) -> None:
        note = estimate(study) if study.state.rows else ""
        under_way = sum(_price(study, number) * share for number, share in self._shares.items())
        self._bars.update(self._study_bar, completed=_spent(study) + under_way, note=note)


def _said(study: Study, pick: Pick) -> str:
    return study.state.said(study.state.picks[pick.number])


def _price(study: Study, number: int) -> float:
    """What a pick is expected to cost, in what the budget counts."""
    state = study.state
    pick = state.picks[number]
    if study.spec.cost_budget is not None:
        return state.usual_cost(pick)
    return pick.price if study.spec.steps is None else state.expected_steps(pick)


def _spent(study: Study) -> float:
    """How much of the budget is spent on what is done or failed."""
    state = study.state
    if study.spec.cost_budget is not None:
        return state.cost_answered
    whole = state.paid if study.spec.steps is None else state.bill().total
    return whole - sum(_price(study, number) for number in state.open_picks)
