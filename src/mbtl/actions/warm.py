"""Warm starts: trainings from scratch and from a policy that is there take turns.

A *warm start* begins with the weights of the policy that serves the new context best so far, and
takes fewer steps. Whether that is worth more per step than a training from scratch differs from
problem to problem. So after the first training, which is from scratch, both are tried in turns;
then each pick is of the kind that gained more V per step of late.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from mbtl.actions.base import Action, Policy, Start, StepProblem, Stop, Trail
from mbtl.actions.evaluation import A_TENTH, Evaluation
from mbtl.actions.fixed import next_source, selector_without
from mbtl.selectors.contract import Selector

_ORDER = (True, False, False, True)
"""Whether a try is warm: neither kind is always first, when V is low and gains are large."""


@dataclass(frozen=True)
class Warm:
    """Trainings from scratch and warm starts, whichever gains more V per step.

    Attributes:
        scratch: index of the mark that trainings from scratch go to; -1: whole trainings.
        length: index of the mark that warm starts go to; -3: a quarter of a whole training.
        turns: tries of each kind before one is chosen, and so many of the latest of each count; 0:
            every training but the first is a warm start.
        selector: where to train next; None: halve the largest stretch without a training.
        evaluation: where each policy is evaluated.
        name: what results call it.
    """

    scratch: int = -1
    length: int = -3
    turns: int = 2
    selector: Selector | str | None = "mbtl"
    evaluation: Evaluation = A_TENTH
    name: str = "warm"

    starts_warm: ClassVar[bool] = True

    def decide(self, problem: StepProblem, trail: Trail, rng: np.random.Generator) -> Action:
        """Evaluate what was trained, else train where the selector says, warm or from scratch."""
        due = self.evaluation.next(problem, trail)
        if due is not None:
            return due
        source = next_source(self.selector, problem, trail, rng)
        if source is None:
            return Stop()
        marks = range(len(problem.lengths))
        if not trail.policies or not self.is_warm(problem, trail):
            return Start(source, marks[self.scratch])
        return Start(source, marks[max(self.length, -len(marks))], server_of(trail, source))

    def is_warm(self, problem: StepProblem, trail: Trail) -> bool:
        """Whether the next training is a warm start."""
        tried = len(trail.trainings) - 1
        if not self.turns or tried < 2 * self.turns:
            return not self.turns or _ORDER[tried % len(_ORDER)]
        worth = gains_per_step(problem, trail)[1:]
        kinds = [training.start is not None for training in trail.trainings[1:]]

        def of_late(warm: bool) -> float:
            mine = [w for w, kind in zip(worth, kinds, strict=True) if kind is warm]
            return sum(mine[-self.turns :])

        return of_late(warm=True) > of_late(warm=False)

    def without(self, family: str) -> Warm:
        """The same with a selector that has not seen a family of matrices."""
        return replace(self, selector=selector_without(self.selector, family))


def server_of(trail: Trail, source: int) -> Policy:
    """The policy that is believed best on a context; of equals the one that is best on average."""
    mean = trail.filled.mean(axis=1)
    best = max(range(len(mean)), key=lambda i: (trail.filled[i, source], mean[i]))
    return trail.policies[best]


def gains_per_step(problem: StepProblem, trail: Trail) -> list[float]:
    """By how much V rose with the policies of each training, per step of it and its evaluation.

    The first one has raised V from nothing, so its number is no gain.
    """
    value = np.maximum.accumulate(trail.filled, axis=0) @ problem.selection.weights
    rose = np.diff(value, prepend=0.0)
    gained, paid = [0.0] * len(trail.trainings), [float(t.steps) for t in trail.trainings]
    for policy, rise, steps in zip(trail.policies, rose, trail.evaluation_steps, strict=True):
        gained[policy.training] += float(rise)
        paid[policy.training] += steps
    return [gain / max(steps, 1.0) for gain, steps in zip(gained, paid, strict=True)]
