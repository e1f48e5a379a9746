"""Pilot: the first training goes to its end, and says how long the others should be.

Where a training reaches most of what it is worth long before its end, shorter ones on more contexts
are worth more; where it does not, they are worth little. The weights that the first training, on
the middle context, had on the way are evaluated from the end backwards, while they are worth nearly
as much. The others go to the shortest such length; then those that V would miss most go on.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from mbtl.selectors.contract import Selector
from mbtl.zoo.actions.base import (
    Action,
    Evaluate,
    Extend,
    Policy,
    Start,
    StepProblem,
    Stop,
    Trail,
    Wait,
)
from mbtl.zoo.actions.evaluation import WHERE_IT_MATTERS, Evaluation
from mbtl.zoo.actions.fixed import next_source, selector_without
from mbtl.zoo.actions.halving import lost_without


@dataclass(frozen=True)
class Pilot:
    """Learn the length from the first training; promote one of `promote` by what V would lose.

    Attributes:
        enough: share of the pilot's gain, over its first mark, that a length should reach.
        promote: of so many trainings at a length one goes on to the next mark; 0: none does.
        selector: where to train next; None: halve the largest stretch without a training.
        evaluation: where each policy is evaluated.
        name: what results call it.
    """

    enough: float = 0.9
    promote: int = 2
    selector: Selector | str | None = None
    evaluation: Evaluation = WHERE_IT_MATTERS
    name: str = "pilot"

    in_parallel: ClassVar[bool] = True

    def decide(self, problem: StepProblem, trail: Trail, rng: np.random.Generator) -> Action:
        """Evaluate what was trained, watch the pilot, then train as long as it says."""
        due = self.evaluation.next(problem, trail)
        if due is not None:
            return due
        last = len(problem.lengths) - 1
        if (not trail.trainings and trail.under_way) or 0 in trail.busy:
            return Wait()  # the others are as long as the first one says
        if not trail.trainings:
            source = next_source(self.selector, problem, trail, rng)
            return Stop() if source is None else Start(source, last)
        pilot = trail.trainings[0]
        if pilot.length < last and not pilot.ended:  # the budget had ended, and was raised
            return Extend(0, last)
        length, watched = self._length(problem, trail)
        if watched is not None:
            targets = np.flatnonzero(np.isfinite(trail.rows[0])).tolist()
            return Evaluate(Policy(0, watched), tuple(targets))
        better = self._promoted(trail, length, last)
        if better is not None:
            return better
        source = next_source(self.selector, problem, trail, rng)
        if source is None:
            return self._promoted(trail, 0, last, least=1) or Stop()
        return Start(source, length)

    def without(self, family: str) -> Pilot:
        """The same with a selector that has not seen a family of matrices."""
        return replace(self, selector=selector_without(self.selector, family))

    def _length(self, problem: StepProblem, trail: Trail) -> tuple[int, int | None]:
        """The mark that others go to, as far as it is known; the pilot's mark to evaluate next."""
        last, pilot = len(problem.lengths) - 1, trail.trainings[0]
        end = int(np.searchsorted(problem.lengths, pilot.steps)) if pilot.ended else last
        rows = {p.length: row for p, row in zip(trail.policies, trail.filled, strict=True)
                if p.training == 0}  # fmt: skip
        if end == 0:
            return last, None
        if 0 not in rows:
            return last, 0
        weights = problem.selection.weights
        first, whole = (float(rows[mark] @ weights) for mark in (0, last))
        length = last
        for mark in range(end - 1, 0, -1):
            if mark not in rows:
                return length, mark
            if float(rows[mark] @ weights) - first < self.enough * (whole - first):
                return length, None
            length = mark
        return length, None

    def _promoted(
        self, trail: Trail, length: int, last: int, least: int | None = None
    ) -> Extend | None:
        """The training whose row V would miss most, where one is due to go on."""
        if not self.promote:
            return None
        missed = lost_without(trail.filled).mean(axis=1)
        sent = {a.training: a.length for a in trail.under_way if isinstance(a, Extend)}
        for mark in range(last - 1, length - 1, -1):
            reached = [j for j, t in enumerate(trail.trainings) if j and (t.length >= mark)]
            beyond = [j for j in reached if max(trail.trainings[j].length, sent.get(j, 0)) > mark]
            due = least or len(reached) // self.promote - len(beyond)
            waiting = [
                (missed[i], -i, p.training) for i, p in enumerate(trail.policies)
                if p.training and p.length == mark == trail.trainings[p.training].length
                and not trail.trainings[p.training].ended and p.training not in trail.busy
            ]  # fmt: skip
            if waiting and due > 0:
                return Extend(max(waiting)[2], mark + 1)
        return None
