"""The selector contract: a problem (frozen data) and a history in, the next source out.

A selector never sees a study, a storage or a matrix. It keeps no state between calls: what it needs
is in the history, so a resumed study proposes what an undisturbed one would have.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from mbtl.arrays import Array
from mbtl.contexts import ContextSpace
from mbtl.errors import InvalidInput, StudyError
from mbtl.history import History


def default_theta(n: int) -> float:
    """Slope of the linear gap, performance per grid step: 0.005 to N = 100, then 0.5 per span."""
    return 0.005 if n <= 100 else 0.5 / (n - 1)


@dataclass(frozen=True)
class SelectionProblem:
    """What a selector may know before any training.

    Attributes:
        unit: (N, D) unit-cube coordinates of the contexts; candidates and targets are one list.
        steps: (N, D) grid-step coordinates.
        weights: (N,) target weights, sum 1.
        budget: number of trainings K.
        theta: slope of the linear gap, performance per grid step.
    """

    unit: Array
    steps: Array
    weights: Array
    budget: int
    theta: float

    def __post_init__(self) -> None:
        if not 1 <= self.budget <= self.n:
            raise InvalidInput(
                f"budget must be from 1 to the number of contexts ({self.n}), got {self.budget}"
            )
        if not (np.isfinite(self.theta) and self.theta >= 0):
            raise InvalidInput(f"theta must be finite and >= 0, got {self.theta!r}")

    @classmethod
    def of(
        cls, space: ContextSpace, *, budget: int, theta: float | None = None
    ) -> SelectionProblem:
        """The selection problem of a context space; `theta` defaults to `default_theta(N)`."""
        slope = default_theta(space.n) if theta is None else theta
        return cls(space.unit, space.steps, space.weights, budget, slope)

    @property
    def n(self) -> int:
        """Number of contexts N."""
        return len(self.steps)

    @property
    def is_line(self) -> bool:
        """True when the contexts lie on one numeric axis."""
        return bool(self.steps.shape[1] == 1)

    @cached_property
    def line(self) -> Array:
        """(N,) grid steps of a one-dimensional problem."""
        if not self.is_line:
            raise InvalidInput(f"this needs one context axis, got {self.steps.shape[1]} columns")
        return self.steps[:, 0]

    @cached_property
    def uniform_weights(self) -> bool:
        """True when every target counts the same."""
        return bool(np.all(self.weights == self.weights[0]))


@dataclass(frozen=True)
class Proposal:
    """The next source and why.

    Attributes:
        source: context index.
        reason: one line for people, e.g. "warm-up: worst context so far".
        acquisition: value of the acquisition at `source`; None where the rule has none.
        notes: what went differently from the plan (a fit that fell back, ...); kept in the study.
    """

    source: int
    reason: str
    acquisition: float | None = None
    notes: tuple[str, ...] = ()


@runtime_checkable
class Selector(Protocol):
    """Proposes the next source to train on."""

    @property
    def name(self) -> str:
        """The registered name, e.g. "mbtl-ei"."""
        ...

    def propose(
        self, problem: SelectionProblem, history: History, rng: np.random.Generator
    ) -> Proposal:
        """Choose one source that is neither trained, pending nor failed.

        Raises:
            Exhausted: every context is taken.
        """
        ...


class Exhausted(StudyError):
    """Every context has been trained, is pending, or failed."""


def open_candidates(problem: SelectionProblem, history: History) -> NDArray[np.bool_]:
    """(N,) mask of the contexts that may be proposed.

    Raises:
        Exhausted: there is none.
    """
    mask = history.open_mask(problem.n)
    if not mask.any():
        raise Exhausted(
            f"all {problem.n} contexts are trained, pending or failed; nothing is left to propose"
        )
    return mask


def nearest_open(problem: SelectionProblem, point: Array, mask: NDArray[np.bool_]) -> int:
    """Open context nearest to `point` (D,) in grid steps; the lowest index on a tie."""
    distance = np.sqrt(((problem.steps - point) ** 2).sum(axis=1))
    distance[~mask] = np.inf
    return int(np.flatnonzero(distance <= distance.min() + 1e-9)[0])


def farthest_open(problem: SelectionProblem, taken: Sequence[int], mask: NDArray[np.bool_]) -> int:
    """Open context whose nearest taken one is farthest; the lowest index on a tie."""
    nearest = np.full(problem.n, np.inf)
    for index in taken:
        away = np.sqrt(((problem.steps - problem.steps[index]) ** 2).sum(axis=1))
        nearest = np.minimum(nearest, away)
    nearest[~mask] = -np.inf
    return int(np.flatnonzero(nearest >= nearest.max() - 1e-9)[0])


def first_pick(problem: SelectionProblem, history: History, mask: NDArray[np.bool_]) -> Proposal:
    """Before any row is known: the middle, then far from what is under way or failed."""
    taken = [*history.pending, *history.failed]
    if taken:
        return Proposal(farthest_open(problem, taken, mask), "far from what was tried so far")
    return Proposal(nearest_open(problem, centre(problem), mask), "middle of the range")


def centre(problem: SelectionProblem) -> Array:
    """(D,) middle of the grid in steps: halfway between the smallest and largest of each column."""
    return np.asarray((problem.steps.min(axis=0) + problem.steps.max(axis=0)) / 2.0)
