"""Committee: specialists and one policy for all contexts take turns, until one side is ahead.

Whether one policy that is trained on all contexts beats a portfolio of specialists nobody knows
beforehand. So both are paid the same: the policy for all goes on to its next mark, twice the steps,
once the specialists have cost as much as it will have then. At any moment neither side has had less
than half of all steps, but for the piece under way; so what either would reach alone costs twice
its steps at most.

At each mark both are compared as they were at equal steps. A side is *ahead* where V differs by
more than twice its standard error, over the contexts where the policy for all was evaluated. Ahead
at marks that are `doublings` doublings apart, and between, it gets all steps that are left. The
guarantee of twice the steps ends there: a side that would have been better much later is given up.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from mbtl.actions.base import (
    Action,
    Evaluate,
    Extend,
    Policy,
    Start,
    StartOn,
    StepProblem,
    Stop,
    Strategy,
    Trail,
)
from mbtl.actions.evaluation import A_TENTH, Evaluation
from mbtl.actions.pilot import Pilot
from mbtl.selectors.targets import spread_targets

Side = Literal["all", "specialists"]

SURE = 2.0
"""Standard errors of a lead that is none of noise."""


@dataclass(frozen=True)
class Committee:
    """Specialists in turn with one policy for all contexts, at equal steps.

    Attributes:
        specialists: the strategy that trains on one context each; it never sees the other side.
        doublings: of the steps, over which one side must be ahead to get all that are left.
        evaluation: how many targets the policy for all is evaluated on.
        name: what results call it.
    """

    specialists: Strategy = field(default_factory=lambda: Pilot(selector="mbtl"))
    doublings: int = 2
    evaluation: Evaluation = A_TENTH
    name: str = "committee"

    trains_on_all: ClassVar[bool] = True

    def decide(self, problem: StepProblem, trail: Trail, rng: np.random.Generator) -> Action:
        """Evaluate what was trained, then let the side go on whose turn it is."""
        sides = Sides.of(trail)
        due = self._due(problem, trail, sides)
        if due is not None:
            return due
        further = self._further(problem, trail, sides)
        winner = self._winner(problem, trail, sides)
        if winner == "all":
            return further or Stop()
        ours = sides.back(self.specialists.decide(problem, sides.ours, rng))
        if winner == "specialists" or further is None or isinstance(ours, Evaluate):
            return ours
        price = float(problem.lengths_on_all[further.length]) + sides.evaluation(trail)
        behind = sides.ours.spent < price
        return ours if behind and not isinstance(ours, Stop) else further

    def verdict(self, problem: StepProblem, trail: Trail) -> str | None:
        """Which side is ahead, and by how much at how many steps; None: nobody knows yet."""
        sides = Sides.of(trail)
        winner = self._winner(problem, trail, sides)
        if winner is None:
            return None
        marks = [m for m in self._compared(problem, trail, sides) if np.isfinite(m.lead)]
        last = marks[-1]
        said = {
            "all": "one policy for all is enough here: it is ahead of the specialists",
            "specialists": "specialists are ahead here: one policy for all contexts is behind",
        }[winner]
        return (
            f"{said} by {abs(last.lead):.3f} of V at {last.steps:,.0f} steps each, and was so over "
            f"{self.doublings} doubling{'s' * (self.doublings > 1)} of the steps"
        )

    def without(self, family: str) -> Committee:
        """The same with specialists that have not seen a family of matrices."""
        held = getattr(self.specialists, "without", None)
        return self if held is None else replace(self, specialists=held(family))

    # ---- inside ------------------------------------------------------------------------------

    def _due(self, problem: StepProblem, trail: Trail, sides: Sides) -> Evaluate | None:
        """The evaluation of the policy for all at its last mark, where that is missing."""
        if sides.on_all is None:
            return None
        policy = trail.latest(sides.on_all)
        if policy in trail.policies:
            return None
        training = trail.trainings[sides.on_all]
        count = self.evaluation.count(problem, trail, training.steps)
        return Evaluate(policy, spread_targets(problem.selection, training.source, count))

    def _further(self, problem: StepProblem, trail: Trail, sides: Sides) -> StartOn | Extend | None:
        """The policy for all to its next mark; None: there is none."""
        marks = problem.lengths_on_all
        if sides.on_all is None:
            every = tuple(problem.selection.sources.tolist())
            return StartOn(every, 0) if len(marks) and len(every) > 1 else None
        training = trail.trainings[sides.on_all]
        if training.ended or training.length + 1 >= len(marks):
            return None
        return Extend(sides.on_all, training.length + 1)

    def _winner(self, problem: StepProblem, trail: Trail, sides: Sides) -> Side | None:
        """The side that is ahead long enough, the first that ever was; None: none is."""
        signs = [mark.sign for mark in self._compared(problem, trail, sides)]
        for end in range(self.doublings, len(signs)):
            run = set(signs[end - self.doublings : end + 1])
            if run == {1}:
                return "all"
            if run == {-1}:
                return "specialists"
        return None

    def _compared(self, problem: StepProblem, trail: Trail, sides: Sides) -> list[Comparison]:
        """Both sides at equal steps, at each mark of the policy for all that they have reached."""
        found: list[Comparison] = []
        if sides.on_all is None:
            return found
        cost, paid = sides.costs(problem), 0.0
        for i, policy in enumerate(trail.policies):
            if policy.training != sides.on_all:
                continue
            paid += trail.evaluation_steps[i]
            steps = float(problem.lengths_on_all[policy.length]) + paid
            if sides.ours.spent < float(problem.lengths_on_all[policy.length]):
                break  # the specialists ran out of contexts, or of steps
            known = sides.ours.filled[cost <= steps * (1.0 + 1e-9)]
            found.append(Comparison.of(problem, trail, i, known, steps))
        return found


@dataclass(frozen=True)
class Comparison:
    """One policy for all against specialists, at equal steps.

    Attributes:
        steps: of each side.
        lead: of the policy for all in V; infinite where there is no specialist yet.
        error: its standard error.
    """

    steps: float
    lead: float
    error: float

    @classmethod
    def of(
        cls, problem: StepProblem, trail: Trail, policy: int, known: NDArray[np.float64],
        steps: float,
    ) -> Comparison:  # fmt: skip
        """Of the rows (k, N) of the specialists known then."""
        if not len(known):
            return cls(steps, np.inf, np.inf)
        less = trail.filled[policy] - known.max(axis=0)
        seen = np.isfinite(trail.rows[policy])
        count = int(seen.sum())
        error = float(less[seen].std(ddof=1)) / np.sqrt(count) if count > 1 else np.inf
        return cls(steps, float(less @ problem.selection.weights), float(error))

    @property
    def sign(self) -> int:
        """1: the policy for all is ahead; -1: it is behind; 0: that may be noise, or is unknown."""
        if not np.isfinite(self.error) or abs(self.lead) <= SURE * self.error:
            return 0
        return int(np.sign(self.lead))


@dataclass(frozen=True)
class Sides:
    """A trail taken apart.

    Attributes:
        ours: what the specialists brought and cost, as if they were alone.
        numbers: of their trainings in the whole trail.
        on_all: number of the training on several contexts; None: it was not begun.
    """

    ours: Trail
    numbers: tuple[int, ...]
    on_all: int | None

    @classmethod
    def of(cls, trail: Trail) -> Sides:
        """Both sides of a trail."""
        numbers = tuple(j for j, t in enumerate(trail.trainings) if not t.on)
        others = [j for j, t in enumerate(trail.trainings) if t.on]
        mine = [i for i, p in enumerate(trail.policies) if p.training in numbers]
        evaluated = {i: trail.evaluation_steps[i] for i in range(len(trail.policies))}
        theirs = float(sum(trail.trainings[j].steps for j in others))
        theirs += sum(steps for i, steps in evaluated.items() if i not in mine)
        ours = Trail(
            trail.steps,
            tuple(trail.trainings[j] for j in numbers),
            tuple(
                Policy(numbers.index(trail.policies[i].training), trail.policies[i].length)
                for i in mine
            ),
            trail.rows[mine],
            tuple(evaluated[i] for i in mine),
            trail.spent - theirs,
        ).filled_as(trail.filled[mine])
        return cls(ours, numbers, others[0] if others else None)

    def back(self, action: Action) -> Action:
        """An action of the specialists, in the numbers of the whole trail."""
        match action:
            case Extend(training, length):
                return Extend(self.numbers[training], length)
            case Evaluate(policy, targets):
                return Evaluate(Policy(self.numbers[policy.training], policy.length), targets)
            case Start() | StartOn() | Stop():
                return action

    def evaluation(self, trail: Trail) -> float:
        """Steps that evaluations of the policy for all have cost."""
        paid = zip(trail.policies, trail.evaluation_steps, strict=True)
        return sum(steps for policy, steps in paid if policy.training == self.on_all)

    def costs(self, problem: StepProblem) -> NDArray[np.float64]:
        """(k,) steps that the specialists had cost when each of their policies was known."""
        trained: dict[int, int] = {}
        paid, found = 0.0, []
        for policy, steps in zip(self.ours.policies, self.ours.evaluation_steps, strict=True):
            done = self.ours.trainings[policy.training].steps
            length = min(int(problem.lengths[policy.length]), done)
            trained[policy.training] = max(trained.get(policy.training, 0), length)
            paid += steps
            found.append(paid + sum(trained.values()))
        return np.array(found)
