"""The contract of strategies that count steps: a problem and what was paid for in, an action out.

A selector says on what to train next. A strategy also says how long, when to go on, where to
evaluate, and when to stop. It sees nothing but what its own actions brought: no curve, no matrix.
It keeps no state between calls.

A training passes marks: lengths at which its weights are kept. The weights at a mark are a
*policy*, and every policy that was evaluated somewhere is a member of the portfolio, so that
nothing is lost by stopping early.

Notation (shapes): N contexts, L lengths, k policies evaluated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from mbtl.arrays import Array
from mbtl.errors import InvalidInput
from mbtl.selectors.base import SelectionProblem


@dataclass(frozen=True)
class Policy:
    """The weights of a training at a mark.

    Attributes:
        training: number of the training, from 0 in the order of their starts.
        length: index of the mark in the lengths of the problem.
    """

    training: int
    length: int


@dataclass(frozen=True)
class Start:
    """Begin a training on a context and go to a mark.

    Attributes:
        source: context index.
        length: index of the mark.
        start: the policy whose weights it begins with (a *warm start*); None: from scratch.
    """

    source: int
    length: int
    start: Policy | None = None


@dataclass(frozen=True)
class StartOn:
    """Begin one training on several contexts, its episodes spread over them, and go to a mark.

    Schedules reach their end there. One that is extended later begins them anew at each mark.

    Attributes:
        sources: context indices, two or more.
        length: index of the mark, among those of a training on several contexts.
    """

    sources: tuple[int, ...]
    length: int


@dataclass(frozen=True)
class Extend:
    """Go on with a training to a later mark.

    Attributes:
        training: which.
        length: index of the mark.
    """

    training: int
    length: int


@dataclass(frozen=True)
class Evaluate:
    """Run a policy on some targets, as many episodes on each as the problem says.

    Attributes:
        policy: which.
        targets: context indices; those where it has been evaluated cost nothing again.
    """

    policy: Policy
    targets: tuple[int, ...]


@dataclass(frozen=True)
class Wait:
    """Nothing is to be decided before what others are at has brought something."""


@dataclass(frozen=True)
class Stop:
    """Nothing more is worth its steps."""


Action = Start | StartOn | Extend | Evaluate | Wait | Stop


@dataclass(frozen=True)
class StepProblem:
    """What a strategy may know before any training.

    Attributes:
        selection: contexts, weights and theta, as selectors know them.
        lengths: (L,) environment steps at the marks of a training, rising; the last is a whole one.
        budget: environment steps, all in.
        episodes: of a policy on a target it is evaluated on.
        horizon: most steps of an episode.
        lengths_on_all: (A,) the same marks of a training on several contexts; none: there can be no
            such training.
    """

    selection: SelectionProblem
    lengths: NDArray[np.int64]
    budget: float
    episodes: int
    horizon: int
    lengths_on_all: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, dtype=np.int64))

    def __post_init__(self) -> None:
        for marks in (self.lengths, self.lengths_on_all):
            if marks.ndim != 1 or (np.diff(marks) <= 0).any():
                raise InvalidInput(f"lengths must be numbers of steps that rise, got {marks}")
        if not len(self.lengths):
            raise InvalidInput("a training needs a length, got none; give one or more")
        if not (self.budget > 0 and self.episodes >= 1 and self.horizon >= 1):
            raise InvalidInput(
                "budget, episodes and horizon must be positive, got "
                f"{self.budget}, {self.episodes} and {self.horizon}"
            )

    @property
    def n(self) -> int:
        """Number of contexts N."""
        return self.selection.n


@dataclass(frozen=True)
class Training:
    """How far a training has come.

    Attributes:
        source: context trained on.
        length: index of the last mark passed.
        steps: environment steps done.
        ended: it has nothing left to gain on its own context; longer would be the same policy.
        on: contexts of a training on several, of which `source` is the middle one; else none.
        start: the policy whose weights it began with; None: from scratch.
    """

    source: int
    length: int
    steps: int
    ended: bool = False
    on: tuple[int, ...] = ()
    start: Policy | None = None


@dataclass(frozen=True)
class Trail:
    """What was done so far, and what it brought: all that a strategy may see.

    Attributes:
        steps: (N, D) grid steps of the contexts.
        trainings: in the order of their starts.
        policies: (k,) those evaluated somewhere, in the order of their first evaluations.
        rows: (k, N) performance, NaN where not evaluated.
        evaluation_steps: (k,) environment steps of their evaluations.
        spent: environment steps, all in.
        under_way: actions that others are at; none where one worker does all. A training that has
            passed a mark on its first way is among `trainings`, too, with length -1.
    """

    steps: Array
    trainings: tuple[Training, ...] = ()
    policies: tuple[Policy, ...] = ()
    rows: Array = field(default_factory=lambda: np.empty((0, 0)))
    evaluation_steps: tuple[float, ...] = ()
    spent: float = 0.0
    under_way: tuple[Action, ...] = ()

    def __post_init__(self) -> None:
        if not self.policies:
            object.__setattr__(self, "rows", np.empty((0, self.n)))
        if self.rows.shape != (len(self.policies), self.n):
            raise InvalidInput(
                f"rows must have shape {(len(self.policies), self.n)}, one per policy, "
                f"got {self.rows.shape}"
            )

    @property
    def n(self) -> int:
        """Number of contexts N."""
        return len(self.steps)

    @cached_property
    def sources(self) -> NDArray[np.intp]:
        """(k,) contexts that the policies were trained on."""
        return np.array([self.trainings[p.training].source for p in self.policies], dtype=np.intp)

    @property
    def unevaluated(self) -> Policy | None:
        """A policy at the last mark of its training that has not been evaluated anywhere.

        Others may be at none of those.
        """
        known = {(p.training, p.length) for p in self.policies}
        for j in reversed(range(len(self.trainings))):
            if (j, self.trainings[j].length) not in known and j not in self.busy:
                return self.latest(j)
        return None

    @cached_property
    def busy(self) -> frozenset[int]:
        """Trainings that others go on with, or evaluate."""
        found = {j for j, training in enumerate(self.trainings) if training.length < 0}
        for action in self.under_way:
            if isinstance(action, Extend):
                found.add(action.training)
            elif isinstance(action, Evaluate):
                found.add(action.policy.training)
        return frozenset(found)

    @property
    def begun(self) -> list[int]:
        """Sources of all trainings, also of those under way."""
        others = [action.source for action in self.under_way if isinstance(action, Start)]
        return [training.source for training in self.trainings] + others

    def latest(self, training: int) -> Policy:
        """The policy at the last mark that a training has passed."""
        return Policy(training, self.trainings[training].length)

    @cached_property
    def filled(self) -> Array:
        """(k, N) rows where an entry not evaluated is believed; see `filled_rows`."""
        return filled_rows(self.rows, self.steps)

    def with_training(self, training: int, now: Training, cost: float) -> Trail:
        """After a training was begun or continued."""
        before = self.trainings
        after = (*before[:training], now, *before[training + 1 :])
        return replace(self, trainings=after, spent=self.spent + cost).filled_as(self.filled)

    def with_evaluation(
        self, policy: Policy, targets: NDArray[np.intp], values: Array, cost: float
    ) -> Trail:
        """After a policy was evaluated: `values` (T,) performance on `targets` (T,)."""
        policies, paid = self.policies, self.evaluation_steps
        rows = self.rows.copy()
        if policy not in policies:
            policies, paid = (*policies, policy), (*paid, 0.0)
            rows = np.vstack([rows, np.full(self.n, np.nan)])
        i = policies.index(policy)
        rows[i, targets] = values
        paid = (*paid[:i], paid[i] + cost, *paid[i + 1 :])
        after = replace(
            self, policies=policies, rows=rows, evaluation_steps=paid, spent=self.spent + cost
        )
        # one row is new: the others are filled as before
        filled = np.vstack([self.filled, rows[len(self.policies) :]])
        filled[i] = filled_rows(rows[i : i + 1], self.steps)[0]
        return after.filled_as(filled)

    def filled_as(self, filled: Array) -> Trail:
        """The same, its filled rows known."""
        self.__dict__["filled"] = filled
        return self


class Strategy(Protocol):
    """Decides what the next steps are spent on.

    One that begins trainings on several contexts says so beforehand by `trains_on_all = True`, so
    that trainers which cannot do it are refused before anything is spent; one that begins with the
    weights of other trainings by `starts_warm = True`. One that finds something out may have
    `verdict(problem, trail)`: a sentence for people, or None. One that may be asked while others
    are at what it decided before (`Trail.under_way`) says `in_parallel = True`.
    """

    @property
    def name(self) -> str:
        """What results call it."""
        ...

    def decide(self, problem: StepProblem, trail: Trail, rng: np.random.Generator) -> Action:
        """The next action."""
        ...


def middle_of(sources: Sequence[int], steps: Array) -> int:
    """The context of a set that is nearest to its middle: where one policy of all is drawn."""
    places = steps[list(sources)]
    middle = (places.min(axis=0) + places.max(axis=0)) / 2.0
    return int(sources[int(np.linalg.norm(places - middle, axis=1).argmin())])


def filled_rows(rows: Array, steps: Array) -> Array:
    """Rows where what was not evaluated lies on a line between its neighbours that were.

    On one axis linear, and beyond the last one constant; on several, as the nearest one.

    Args:
        rows: (k, N) performance, NaN where not evaluated.
        steps: (N, D) grid steps of the contexts.
    """
    known = np.isfinite(rows)
    if known.all():
        return rows
    if steps.shape[1] > 1:
        return nearest_filled(rows, steps)
    order = np.argsort(steps[:, 0], kind="stable")
    filled = np.empty(rows.shape)
    filled[:, order] = _between(steps[order, 0], rows[:, order], known[:, order])
    return filled


def nearest_filled(rows: Array, steps: Array, *, least: int = 1) -> Array:
    """Rows where a policy that was not evaluated counts as on the nearest target where it was.

    Args:
        rows: (k, N) performance, NaN where not evaluated.
        steps: (N, D) grid steps of the targets.
        least: rows with fewer entries than this stay as they are.
    """
    missing = ~np.isfinite(rows)
    if not missing.any():
        return rows
    from scipy.spatial import KDTree  # kept out of `import mbtl`

    out = np.array(rows, dtype=np.float64)
    for row, gone in zip(out, missing, strict=True):
        if gone.any() and np.count_nonzero(~gone) >= least:
            _, nearest = KDTree(steps[~gone]).query(steps[gone])
            row[gone] = row[~gone][nearest]
    return out


def _between(at: Array, rows: Array, known: NDArray[np.bool_]) -> Array:
    """Linear interpolation of every row along rising places `at` (N,)."""
    n = len(at)
    places = np.broadcast_to(np.arange(n), rows.shape)
    left = np.maximum.accumulate(np.where(known, places, -1), axis=1)
    right = np.minimum.accumulate(np.where(known, places, n)[:, ::-1], axis=1)[:, ::-1]
    left, right = np.where(left < 0, right, left), np.where(right >= n, left, right)
    none = left >= n  # nothing known in this row
    left, right = np.where(none, 0, left), np.where(none, 0, np.minimum(right, n - 1))
    low, high = (np.take_along_axis(rows, side, axis=1) for side in (left, right))
    width = at[right] - at[left]
    part = np.where(width > 0, (at - at[left]) / np.where(width > 0, width, 1.0), 0.0)
    return np.asarray(np.where(known, rows, low + part * (high - low)))
