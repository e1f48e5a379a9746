"""Committee: specialists and policies for all contexts take turns, until one side is ahead.

Whether one policy that is trained on all contexts beats a portfolio of specialists nobody knows
beforehand, nor how long it must be trained. So both sides are paid the same. One side is tried at
ever doubled length; each length is a training of its own, since a learning rate that begins anew
costs more V than it saves steps. A try begins once the specialists have cost as much as that side
will have then. So at any moment neither side has had less than half of all steps, but for the piece
under way: what either would reach alone costs twice its steps at most.

After each try both are compared as they were at equal steps. A side is *ahead* where V differs by
more than twice its standard error, over the contexts where the try was evaluated. Ahead at tries
that are `doublings` doublings apart, and between, it gets all steps that are left. The guarantee of
twice the steps ends there: a side that would have been better much later is given up.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from mbtl.arrays import Array
from mbtl.selectors.targets import spread_targets
from mbtl.zoo.actions.base import (
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
    Training,
    Wait,
)
from mbtl.zoo.actions.evaluation import A_TENTH, LEAST, Evaluation, target_price
from mbtl.zoo.actions.pilot import Pilot

Side = Literal["all", "specialists"]

SURE = 2.0
"""Standard errors of a lead that is none of noise."""


@dataclass(frozen=True)
class Committee:
    """Specialists in turn with one policy for all contexts, at equal steps.

    Attributes:
        specialists: the strategy that trains on one context each; it never sees the other side.
        doublings: of the length, over which one side must be ahead to get all that is left.
        evaluation: how many targets a policy for all is evaluated on.
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
        longer = self._longer(problem, trail, sides)
        winner, _ = self.decision(problem, trail, sides)
        if winner == "all":
            return longer or Stop()
        ours = sides.back(self.specialists.decide(problem, sides.ours, rng))
        if winner == "specialists" or longer is None or isinstance(ours, Evaluate):
            return ours
        then = sides.spent_on_all + self._price(problem, trail, sides, longer.length)
        return ours if sides.ours.spent < then and not isinstance(ours, Stop) else longer

    def decision(
        self, problem: StepProblem, trail: Trail, sides: Sides | None = None
    ) -> tuple[Side | None, Comparison | None]:
        """The first side that ever was ahead long enough, and when; None: none was."""
        compared = self._compared(problem, trail, sides or Sides.of(trail))
        signs = [one.sign for one in compared]
        for end in range(self.doublings, len(signs)):
            run = set(signs[end - self.doublings : end + 1])
            if run == {1}:
                return "all", compared[end]
            if run == {-1}:
                return "specialists", compared[end]
        return None, None

    def verdict(self, problem: StepProblem, trail: Trail) -> str | None:
        """Which side is ahead, by how much and at how many steps; None: nobody knows yet."""
        winner, last = self.decision(problem, trail)
        if winner is None or last is None:
            return None
        doublings = f"{self.doublings} doubling{'s' * (self.doublings != 1)} of its length"
        return {
            "all": "one policy for all is enough here: it is ahead of the specialists by "
            f"{last.lead:.3f} of V after {last.steps:,.0f} steps each, over {doublings}",
            "specialists": "specialists are ahead here: one policy for all contexts is behind by "
            f"{-last.lead:.3f} of V after {last.steps:,.0f} steps each, over {doublings}",
        }[winner]

    @property
    def starts_warm(self) -> bool:
        """As its specialists say."""
        return bool(getattr(self.specialists, "starts_warm", False))

    def without(self, family: str) -> Committee:
        """The same with specialists that have not seen a family of matrices."""
        held = getattr(self.specialists, "without", None)
        return self if held is None else replace(self, specialists=held(family))

    # ---- inside ------------------------------------------------------------------------------

    def _due(self, problem: StepProblem, trail: Trail, sides: Sides) -> Evaluate | None:
        """The evaluation of the latest policy for all, where that is missing."""
        if not sides.on_all:
            return None
        policy = trail.latest(sides.on_all[-1])
        if policy in trail.policies:
            return None
        training = trail.trainings[policy.training]
        count = self.evaluation.count(problem, trail, training.steps)
        return Evaluate(policy, spread_targets(problem.selection, training.source, count))

    def _longer(self, problem: StepProblem, trail: Trail, sides: Sides) -> StartOn | None:
        """The next try; None: it is too long for what is left, or there can be none."""
        marks, every = problem.lengths_on_all, tuple(problem.selection.sources.tolist())
        before = [trail.trainings[j].length for j in sides.on_all]
        length = max(before, default=-1) + 1
        if length >= len(marks) or len(every) < 2:
            return None
        cost = self._price(problem, trail, sides, length)
        cost += min(LEAST, problem.n) * target_price(problem, trail)
        return StartOn(every, length) if trail.spent + cost <= problem.budget else None

    def _price(self, problem: StepProblem, trail: Trail, sides: Sides, length: int) -> float:
        """Steps of a try, as those before it say; less than its mark where episodes are short."""
        share = 1.0
        if sides.on_all and (last := trail.trainings[sides.on_all[-1]]).length >= 0:
            share = min(last.steps / float(problem.lengths_on_all[last.length]), 1.0)
        return share * float(problem.lengths_on_all[length])

    def _compared(self, problem: StepProblem, trail: Trail, sides: Sides) -> list[Comparison]:
        """Both sides at equal steps, after each try."""
        cost, paid = sides.costs(problem), 0.0
        found: list[Comparison] = []
        for i, policy in enumerate(trail.policies):
            if policy.training not in sides.on_all:
                continue
            paid += trail.trainings[policy.training].steps + trail.evaluation_steps[i]
            found.append(Comparison.of(problem, trail, i, sides.ours.filled[cost <= paid], paid))
        return found


@dataclass(frozen=True)
class Comparison:
    """One policy for all against specialists, at equal steps.

    Attributes:
        steps: of each side.
        lead: of the policy for all in V.
        error: its standard error; infinite where there is no specialist yet.
    """

    steps: float
    lead: float
    error: float

    @classmethod
    def of(
        cls, problem: StepProblem, trail: Trail, policy: int, known: Array, steps: float
    ) -> Comparison:
        """Of the rows (k, N) of the specialists known then."""
        seen = np.isfinite(trail.rows[policy])
        count = int(seen.sum())
        if not len(known) or count < 2:
            return cls(steps, 0.0, np.inf)
        less = trail.filled[policy] - known.max(axis=0)
        error = float(less[seen].std(ddof=1)) / np.sqrt(count)
        return cls(steps, float(less @ problem.selection.weights), float(error))

    @property
    def sign(self) -> int:
        """1: the policy for all is ahead; -1: it is behind; 0: that may be noise, or is unknown."""
        return 0 if abs(self.lead) <= SURE * self.error else int(np.sign(self.lead))


@dataclass(frozen=True)
class Sides:
    """A trail taken apart.

    Attributes:
        ours: what the specialists brought and cost, as if they were alone.
        numbers: of their trainings in the whole trail.
        on_all: numbers of the trainings on several contexts.
        spent_on_all: steps that those and their evaluations have cost.
    """

    ours: Trail
    numbers: tuple[int, ...]
    on_all: Sequence[int]
    spent_on_all: float

    @classmethod
    def of(cls, trail: Trail) -> Sides:
        """Both sides of a trail."""
        numbers = tuple(j for j, t in enumerate(trail.trainings) if not t.on)
        on_all = tuple(j for j, t in enumerate(trail.trainings) if t.on)
        mine = [i for i, p in enumerate(trail.policies) if p.training not in on_all]
        theirs = float(sum(trail.trainings[j].steps for j in on_all))
        for policy, steps in zip(trail.policies, trail.evaluation_steps, strict=True):
            theirs += steps if policy.training in on_all else 0.0
        ours = Trail(
            trail.steps,
            tuple(_renumbered(trail.trainings[j], numbers) for j in numbers),
            tuple(
                Policy(numbers.index(trail.policies[i].training), trail.policies[i].length)
                for i in mine
            ),
            trail.rows[mine],
            tuple(trail.evaluation_steps[i] for i in mine),
            trail.spent - theirs,
        ).filled_as(trail.filled[mine])
        return cls(ours, numbers, on_all, theirs)

    def back(self, action: Action) -> Action:
        """An action of the specialists, in the numbers of the whole trail."""
        match action:
            case Extend(training, length):
                return Extend(self.numbers[training], length)
            case Evaluate(policy, targets):
                return Evaluate(Policy(self.numbers[policy.training], policy.length), targets)
            case Start(source, length, Policy(training, mark)):
                return Start(source, length, Policy(self.numbers[training], mark))
            case Start() | StartOn() | Wait() | Stop():
                return action

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


def _renumbered(training: Training, numbers: tuple[int, ...]) -> Training:
    """One of the specialists, as if they were alone."""
    if training.start is None:
        return training
    begun = training.start
    return replace(training, start=Policy(numbers.index(begun.training), begun.length))
