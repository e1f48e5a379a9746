"""A strategy whose trainings after the first begin with the policy that serves their context."""

from dataclasses import dataclass
from typing import ClassVar

from mbtl.actions import Start, Stop
from mbtl.actions.evaluation import A_TENTH, Evaluation
from mbtl.actions.fixed import next_source


@dataclass(frozen=True)
class Warm:
    """`length` is the index of the mark that they go to; the first goes to the last one."""

    length: int = 1
    evaluation: Evaluation = A_TENTH
    name: str = "warm"
    starts_warm: ClassVar[bool] = True

    def decide(self, problem, trail, rng):
        due = self.evaluation.next(problem, trail)
        if due is not None:
            return due
        source = next_source(None, problem, trail, rng)
        if source is None:
            return Stop()
        last = len(problem.lengths) - 1
        if not trail.policies:
            return Start(source, last)
        best = trail.policies[trail.filled[:, source].argmax()]
        return Start(source, min(self.length, last), best)


NAMED = {"warm": Warm()}
"""For programs, which are told a strategy by its name."""
