"""Where to evaluate a policy: few targets where training is cheap, more where routes hang on it."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from mbtl.selectors.targets import spread_targets
from mbtl.zoo.actions.base import Evaluate, Policy, StepProblem, Trail

LEAST = 5
"""Targets that every policy is evaluated on: its own context, and some that are spread."""


@dataclass(frozen=True)
class Evaluation:
    """Targets that are spread first, then those between which the route is not clear.

    Attributes:
        targets: evaluated first of each policy; None: all, unless `share` says otherwise.
        share: as many targets instead as cost this share of the steps of the policy's training.
        margin: with one axis, then halve the stretches between evaluated targets where the policy
            is behind the best other one by no more than this share of the range seen; None: do not.
    """

    targets: int | None = None
    share: float | None = None
    margin: float | None = None

    def next(self, problem: StepProblem, trail: Trail) -> Evaluate | None:
        """The evaluation that is due; None if there is none."""
        waiting = trail.unevaluated
        if waiting is not None:
            training = trail.trainings[waiting.training]
            count = self.count(problem, trail, training.steps)
            return Evaluate(waiting, spread_targets(problem.selection, training.source, count))
        return self.more(problem, trail, trail.policies[-1]) if trail.policies else None

    def more(self, problem: StepProblem, trail: Trail, policy: Policy) -> Evaluate | None:
        """Where a policy should be evaluated further, beside those evaluated before it."""
        if self.margin is None or not problem.selection.is_line or policy.training in trail.busy:
            return None
        between = self._contested(problem, trail, trail.policies.index(policy))
        return Evaluate(policy, between) if between else None

    def count(self, problem: StepProblem, trail: Trail, steps: int) -> int:
        """Targets of a policy that was trained for so many steps."""
        if self.share is None:
            return self.targets or problem.n
        affordable = self.share * steps / target_price(problem, trail)
        return int(np.clip(affordable, min(LEAST, problem.n), problem.n))

    def _contested(self, problem: StepProblem, trail: Trail, policy: int) -> tuple[int, ...]:
        """Middles of the stretches where this policy may serve and was not evaluated."""
        assert self.margin is not None
        row = trail.rows[policy]
        line = problem.selection.line
        order = np.argsort(line, kind="stable")
        known = [i for i in order.tolist() if np.isfinite(row[i])]
        others = trail.filled[:policy]
        if not len(others):
            return ()
        best = others.max(axis=0)
        slack = self.margin * float(np.ptp(trail.rows[np.isfinite(trail.rows)]))
        place = {target: at for at, target in enumerate(order.tolist())}
        found = []
        for left, right in pairwise(known):
            inside = order[place[left] + 1 : place[right]]
            if not len(inside):
                continue
            behind = [row[t] - best[t] for t in (left, right)]
            if max(behind) >= -slack and (row[left] != row[right] or min(behind) < slack):
                found.append(int(inside[len(inside) // 2]))
        return tuple(found)


EVERYWHERE = Evaluation()
WHERE_IT_MATTERS = Evaluation(LEAST, margin=0.0)
A_TENTH = Evaluation(share=0.1, margin=0.0)
"""At first as many targets as a tenth of the training pays for, then those that routes hang on."""


def target_price(problem: StepProblem, trail: Trail) -> float:
    """Steps that an evaluation on one target is likely to cost: the mean so far."""
    entries = int(np.isfinite(trail.rows).sum())
    longest = float(problem.horizon * problem.episodes)
    return sum(trail.evaluation_steps) / entries if entries else longest
