"""Population: members train side by side, and who adds least copies the weights of who serves.

Population Based Training (Jaderberg et al., arXiv:1711.09846) over contexts. All members train for
a piece each and are evaluated; then the worst fifth is given up (*truncation selection*), and its
places are taken by copies of better members (*exploit*) that go on with something changed
(*explore*). Two things differ here, since what counts is V and no member's own return:

    a member is worth what V would lose without all of its policies;
    what changes is the context: a copy trains where the selector says, and begins with the weights
    of the policy that serves there.

Each piece doubles a member's length. Who has reached the end leaves a place, too, and stays in the
portfolio like everybody who ever was evaluated. Copies begin their schedules anew.

The numbers (five members, a fifth, a quarter of a whole training) were chosen beforehand; no others
were tried.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from mbtl.actions.base import Action, Extend, Policy, Start, StepProblem, Stop, Trail
from mbtl.actions.evaluation import A_TENTH, Evaluation
from mbtl.actions.fixed import next_source, selector_without
from mbtl.actions.halving import lost_without
from mbtl.actions.warm import server_of
from mbtl.errors import InvalidInput
from mbtl.selectors.contract import Selector


@dataclass(frozen=True)
class Population:
    """Extend all members but the ones that V would miss least; copy weights into their places.

    Attributes:
        size: members P; never more than there are contexts.
        truncation: share of them that is given up after each round, one member at least.
        length: index of the mark that members go to first; -3: a quarter of a whole training.
        selector: where new members train; None: halve the largest stretch without a training.
        evaluation: where each policy is evaluated.
        name: what results call it.
    """

    size: int = 5
    truncation: float = 0.2
    length: int = -3
    selector: Selector | str | None = "mbtl"
    evaluation: Evaluation = A_TENTH
    name: str = "population"

    starts_warm: ClassVar[bool] = True

    def __post_init__(self) -> None:
        if self.size < 2 or not 0.0 < self.truncation < 1.0:
            raise InvalidInput(
                "a population has two members or more, of which a share in (0, 1) is given up, got "
                f"size={self.size} and truncation={self.truncation}"
            )

    def decide(self, problem: StepProblem, trail: Trail, rng: np.random.Generator) -> Action:
        """Evaluate what was trained; extend who stays; then fill the places of who does not."""
        due = self.evaluation.next(problem, trail)
        if due is not None:
            return due
        # a round is one piece of each member, and each piece is a policy: so policies count rounds
        size = min(self.size, problem.n)
        begun = len(trail.policies) // size * size
        had = {policy.training for policy in trail.policies[begun:]}
        for j in self.staying(problem, trail, begun, size):
            if j not in had:
                return Extend(j, trail.trainings[j].length + 1)
        source = next_source(self.selector, problem, trail, rng)
        if source is None:
            return _rest(problem, trail)
        marks = range(len(problem.lengths))
        start = server_of(trail, source) if begun else None
        return Start(source, marks[max(self.length, -len(marks))], start)

    def staying(self, problem: StepProblem, trail: Trail, begun: int, size: int) -> list[int]:
        """Trainings that go on in the round that began after so many policies; none in the first.

        Members are who had a piece in the round before. What was evaluated since then plays no
        part, so all decisions of a round follow the same plan.
        """
        before = trail.policies[:begun]
        members = dict.fromkeys(policy.training for policy in before[-size:])
        worth = missed_without(problem, trail, before)
        count = max(1, round(self.truncation * size))
        gone = sorted(members, key=lambda j: (worth[j], -j))[:count]
        return [j for j in members if j not in gone and _is_open(problem, trail, j)]

    def without(self, family: str) -> Population:
        """The same with a selector that has not seen a family of matrices."""
        return replace(self, selector=selector_without(self.selector, family))


def missed_without(
    problem: StepProblem, trail: Trail, policies: tuple[Policy, ...]
) -> dict[int, tuple[float, float]]:
    """What V of the first policies of a trail would lose without each training, and its mean.

    A training counts with all its policies: its latest one is not replaced by an earlier self.

    Args:
        problem: whose weights count.
        trail: with the rows of the policies.
        policies: the first k of the trail.

    Returns:
        By training: the loss in V, and the mean performance over targets, which ranks equals.
    """
    trainings = list(dict.fromkeys(policy.training for policy in policies))
    if not trainings:
        return {}
    of = np.array([policy.training for policy in policies])
    filled, weights = trail.filled[: len(policies)], problem.selection.weights
    rows = np.array([filled[of == j].max(axis=0) for j in trainings])
    lost, mean = lost_without(rows) @ weights, rows @ weights
    return {j: (float(lost[i]), float(mean[i])) for i, j in enumerate(trainings)}


def _is_open(problem: StepProblem, trail: Trail, training: int) -> bool:
    """Whether it can go on."""
    known = trail.trainings[training]
    return not known.ended and known.length < len(problem.lengths) - 1


def _rest(problem: StepProblem, trail: Trail) -> Action:
    """Every context was begun: go on with whom V would miss most among all that can."""
    worth = missed_without(problem, trail, trail.policies)
    open_ = [j for j in worth if _is_open(problem, trail, j)]
    if not open_:
        return Stop()
    best = max(open_, key=lambda j: (worth[j], -j))
    return Extend(best, trail.trainings[best].length + 1)
