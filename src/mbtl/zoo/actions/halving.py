"""Successive halving: many short trainings, and ever longer ones of those that look best.

ASHA (Li et al., MLSys 2020) over contexts: a training is promoted to the next rung as soon as it is
among the best 1/eta of those that reached its rung. Successive halving (Jamieson and Talwalkar,
AISTATS 2016) waits until a whole cohort is there. Hyperband (Li et al., JMLR 2018) has several
brackets, whose lowest rungs differ, and spends as much on each. All rank by one number, as they do
for hyper-parameters: the own return, or the mean over all targets.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import ClassVar, Literal

import numpy as np

from mbtl.arrays import Array
from mbtl.selectors.contract import Selector
from mbtl.zoo.actions.base import Action, Extend, Start, StepProblem, Stop, Trail
from mbtl.zoo.actions.evaluation import EVERYWHERE, Evaluation
from mbtl.zoo.actions.fixed import next_source, selector_without


@dataclass(frozen=True)
class Halving:
    """Promote the best 1 / 2**`every` of each rung.

    Attributes:
        rank: "own": the return on its own context; "mean": the mean over targets; "gain": what V
            would lose without it.
        every: marks from one rung to the next; lengths double from mark to mark, so eta = 2**every.
        selector: where to begin new trainings; "random" is the rule of all three.
        first: mark of the lowest rung; -1 is that of whole trainings.
        cohort: promote only when so many began together, and fewer on each rung; None: at once.
        brackets: so many, each beginning a rung above the one before.
        evaluation: where each policy is evaluated.
        name: what results call it.
    """

    rank: Literal["own", "mean", "gain"] = "own"
    every: int = 2
    selector: Selector | str | None = "random"
    first: int = 0
    cohort: int | None = None
    brackets: int = 1
    evaluation: Evaluation = EVERYWHERE
    name: str = "asha"

    in_parallel: ClassVar[bool] = True

    def decide(self, problem: StepProblem, trail: Trail, rng: np.random.Generator) -> Action:
        """Evaluate what was trained; else promote, from the top rung down; else begin anew."""
        due = self.evaluation.next(problem, trail)
        if due is not None:
            return due
        last = len(problem.lengths) - 1
        first = range(len(problem.lengths))[self.first]
        rungs = sorted({*range(first, last, self.every), last})
        scores, own = self._scores(problem, trail), _brackets(trail, rungs[: self.brackets])
        for bracket in rungs[: self.brackets]:
            mine = [j for j in range(len(trail.trainings)) if own.get(j) == bracket]
            group = mine[-(len(mine) % self.cohort or self.cohort) :] if self.cohort else mine
            steps = rungs[rungs.index(bracket) :]
            found = self._promoted(trail, set(group), steps, scores)
            if found is not None:
                return found
        source = next_source(self.selector, problem, trail, rng)
        if source is not None:
            spent = dict.fromkeys(rungs[: self.brackets], 0)
            for j, training in enumerate(trail.trainings):
                spent[own.get(j, rungs[0])] += training.steps
            return Start(source, min(spent, key=lambda rung: (spent[rung], rung)))
        return self._rest(trail, rungs, scores)

    def without(self, family: str) -> Halving:
        """The same with a selector that has not seen a family of matrices."""
        return replace(self, selector=selector_without(self.selector, family))

    def _promoted(
        self, trail: Trail, group: set[int], rungs: list[int], scores: Array
    ) -> Extend | None:
        """The best of a rung that has not gone on, from the top rung down."""
        for step, (low, high) in reversed(list(enumerate(pairwise(rungs)))):
            there = [
                i for i, p in enumerate(trail.policies)
                if p.training in group
                and (p.length == low or (p.length < low and trail.trainings[p.training].ended))
            ]  # fmt: skip
            if self.cohort and len(there) < self.cohort // 2 ** (self.every * step):
                continue
            best = sorted(there, key=lambda i: -scores[i])[: len(there) // 2**self.every]
            for i in best:
                training = trail.trainings[trail.policies[i].training]
                number = trail.policies[i].training
                if training.length == low and not training.ended and number not in trail.busy:
                    return Extend(number, high)
        return None

    def _rest(self, trail: Trail, rungs: list[int], scores: Array) -> Action:
        """Every context was begun: go on with the best that can."""
        for i in np.argsort(-scores, kind="stable").tolist():
            policy = trail.policies[i]
            training = trail.trainings[policy.training]
            open_ = not training.ended and policy.training not in trail.busy
            if open_ and training.length == policy.length < rungs[-1]:
                return Extend(policy.training, next(r for r in rungs if r > policy.length))
        return Stop()

    def _scores(self, problem: StepProblem, trail: Trail) -> Array:
        if not trail.policies:
            return np.empty(0)
        if self.rank == "own":
            return trail.rows[np.arange(len(trail.policies)), trail.sources]
        rows, weights = trail.filled, problem.selection.weights
        if self.rank == "mean":
            return np.asarray(rows @ weights)
        return np.asarray(lost_without(rows) @ weights)


def _brackets(trail: Trail, lowest: list[int]) -> dict[int, int]:
    """Training -> its bracket: a training is first evaluated on the rung it began on."""
    began: dict[int, int] = {}
    for policy in trail.policies:
        began[policy.training] = min(policy.length, began.get(policy.training, policy.length))
    return {j: max(rung for rung in lowest if rung <= mark) for j, mark in began.items()}


def lost_without(rows: Array) -> Array:
    """(k, N) what each target would lose without each policy."""
    if len(rows) == 1:
        return np.ones_like(rows)
    top = np.sort(rows, axis=0)[-2:]
    return np.where(rows == top[1], top[1] - top[0], 0.0)
