"""Fixed length: every training goes to the same mark, on the contexts that a selector picks."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from mbtl.history import History
from mbtl.selectors.base import Exhausted, nearest_distance
from mbtl.selectors.contract import Selector
from mbtl.selectors.registry import get_selector
from mbtl.zoo.actions.base import Action, Start, StepProblem, Stop, Trail
from mbtl.zoo.actions.evaluation import EVERYWHERE, Evaluation


@dataclass(frozen=True)
class FixedLength:
    """One length for all.

    Attributes:
        selector: where to train next; None: halve the largest stretch without a training.
        length: index of the mark; -1: whole trainings.
        evaluation: where each policy is evaluated.
        name: what results call it.
    """

    selector: Selector | str | None = None
    length: int = -1
    evaluation: Evaluation = EVERYWHERE
    name: str = "fixed"

    in_parallel: ClassVar[bool] = True

    def decide(self, problem: StepProblem, trail: Trail, rng: np.random.Generator) -> Action:
        """Evaluate what was trained, else train where the selector says."""
        due = self.evaluation.next(problem, trail)
        if due is not None:
            return due
        source = next_source(self.selector, problem, trail, rng)
        length = range(len(problem.lengths))[self.length]
        return Stop() if source is None else Start(source, length)

    def without(self, family: str) -> FixedLength:
        """The same with a selector that has not seen a family of matrices."""
        return replace(self, selector=selector_without(self.selector, family))


def next_source(
    selector: Selector | str | None, problem: StepProblem, trail: Trail, rng: np.random.Generator
) -> int | None:
    """Where a selector would train next, each training being its latest policy that has a row."""
    begun = trail.begun
    if selector is None:
        return halfway(problem, begun)
    latest: dict[int, int] = {}
    for i, policy in enumerate(trail.policies):
        if policy.length >= trail.policies[latest.get(policy.training, i)].length:
            latest[policy.training] = i
    rows = trail.filled[list(latest.values())]
    sources = tuple(trail.trainings[j].source for j in latest)
    pending = tuple(s for s in dict.fromkeys(begun) if s not in sources)
    history = History(problem.n, sources, rows, pending=pending)
    try:
        return get_selector(selector).propose(problem.selection, history, rng).source
    except Exhausted:
        return None


def halfway(problem: StepProblem, begun: list[int]) -> int | None:
    """The context farthest from all that were begun; the middle first; None if none is left."""
    open_sources = np.setdiff1d(problem.selection.sources, begun)
    if not len(open_sources):
        return None
    steps = problem.selection.steps
    if not begun:
        middle = (steps.min(axis=0) + steps.max(axis=0)) / 2.0
        distance = -np.linalg.norm(steps[open_sources] - middle, axis=1)
    else:
        distance = nearest_distance(steps[open_sources], steps[begun])
    return int(open_sources[distance.argmax()])


def selector_without(selector: Selector | str | None, family: str) -> Selector | None:
    """A selector as it would be had it never seen a family; see `benchmark.compare.held_out`."""
    if selector is None:
        return None
    found = get_selector(selector)
    without = getattr(found, "without", None)
    held: Selector = found if without is None else without(family)
    return held
