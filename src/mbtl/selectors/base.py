"""What selectors work with: a problem (frozen data), a proposal, and which contexts are open."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from mbtl.arrays import Array, Indices, Mask, unwritable
from mbtl.contexts import Axis, ContextSpace
from mbtl.errors import InvalidInput, StudyError
from mbtl.history import History
from mbtl.models.beliefs import Beliefs
from mbtl.objective import generalisation_performance
from mbtl.plain import LARGEST, finite, is_finite, short, whole


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
        budget: number of trainings K; units, where trainings of other kinds are allowed.
        theta: slope of the linear gap, performance per grid step.
        costs: (N,) cost of a training on each context; None where all cost the same.
        cost_budget: of all trainings together; None for no limit.
        risk: share of the targets, the worst of them, that V is the mean of.
        least_left: gain in V that all trainings left together should be worth; None: not asked.
        axes: of the context space, D columns together; empty: D linear axes.
        trainable: (N,) mask of the contexts that one may train on; None: all. All are targets.
        abilities: what the trainer can do beside specialists: train on several contexts ("sets"),
            begin from a policy ("start"), train for any length ("length"); None: specialists are
            all that is asked for, and each context is one.
        assumed: whether these are only assumed, as no trainer is known so far.
    """

    unit: Array
    steps: Array
    weights: Array
    budget: int
    theta: float
    costs: Array | None = None
    cost_budget: float | None = None
    risk: float = 1.0
    least_left: float | None = None
    axes: tuple[Axis, ...] = ()
    trainable: Mask | None = None
    abilities: frozenset[str] | None = None
    assumed: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "budget", whole("budget", self.budget))
        for name in ("unit", "steps", "weights", "costs", "trainable"):
            object.__setattr__(self, name, unwritable(getattr(self, name)))
        if self.trainable is not None and (
            self.trainable.shape != (self.n,) or self.trainable.dtype != bool
        ):
            raise InvalidInput(
                f"trainable must be a mask of {self.n} contexts, got "
                f"{self.trainable.dtype} of shape {self.trainable.shape}"
            )
        most, rule = len(self.sources), "1 or more units"
        if self.abilities is None:
            which = "contexts" if self.trainable is None else "trainable contexts"
            rule = f"from 1 to the number of {which} ({most})"
        if self.budget < 1 or (self.abilities is None and self.budget > most):
            raise InvalidInput(f"budget must be {rule}, got {self.budget}")
        if not (is_finite(self.risk) and 0.0 < self.risk <= 1.0):
            raise InvalidInput(
                f"risk is the share of the worst targets, in (0, 1], got {short(self.risk)}"
            )
        if self.costs is not None and not (
            self.costs.shape == (self.n,)
            and ((self.costs >= 1.0 / LARGEST) & (self.costs <= LARGEST)).all()
        ):
            raise InvalidInput(
                f"costs must be {self.n} numbers from {1.0 / LARGEST:g} to {LARGEST:g}, one per "
                f"context, got {self.costs.shape[0]} from {self.costs.min():g} to "
                f"{self.costs.max():g}"
            )
        finite("theta", self.theta, 0.0)

    @classmethod
    def of(
        cls, space: ContextSpace, *, budget: int, theta: float | None = None, **wishes: Any
    ) -> SelectionProblem:
        """The selection problem of a context space; `theta` defaults to `default_theta(N)`.

        Args:
            space: the contexts.
            budget: number of trainings K.
            theta: slope of the linear gap.
            **wishes: `costs`, `cost_budget`, `risk`, `least_left`, `trainable`, `abilities`,
                `assumed`.
        """
        slope = default_theta(space.n) if theta is None else theta
        return cls(space.unit, space.steps, space.weights, budget, slope, axes=space.axes, **wishes)

    @property
    def alone(self) -> SelectionProblem:
        """As a selector has it: specialists are all that is asked for."""
        return replace(self, budget=min(self.budget, len(self.sources)), abilities=None)

    @property
    def n(self) -> int:
        """Number of contexts N."""
        return len(self.steps)

    @cached_property
    def sources(self) -> Indices:
        """(M,) indices of the contexts that one may train on."""
        here = np.arange(self.n) if self.trainable is None else np.flatnonzero(self.trainable)
        return unwritable(here)

    @property
    def is_line(self) -> bool:
        """True when the contexts lie on one numeric axis."""
        return bool(self.steps.shape[1] == 1)

    @cached_property
    def line(self) -> Array:
        """(N,) grid steps of a one-dimensional problem.

        Raises:
            InvalidInput: the contexts have several axes, or levels.
        """
        if not self.is_line:
            axes = ", ".join(axis.name for axis in self.axes) or f"{self.steps.shape[1]} of them"
            raise InvalidInput(
                f"this selector needs contexts on one numeric axis, got {axes}; choose one that "
                "takes any, such as 'specialists'"
            )
        return self.steps[:, 0]

    @cached_property
    def uniform_weights(self) -> bool:
        """True when every target counts the same."""
        return bool(np.all(self.weights == self.weights[0]))


@dataclass(frozen=True)
class Proposal:
    """The next training and why. A selector says on which context; the rest is for strategies.

    Attributes:
        source: index of the context to train on.
        reason: one line for people, e.g. "warm-up: worst context so far".
        acquisition: value of the acquisition at `source`; None where the rule has none.
        notes: what went differently from the plan (a fit that fell back, ...); kept in the study.
        chance_left: probability that trainings on all contexts left together gain `least_left` or
            more; where the problem asks.
        start: place, among the rows of the history, of the policy to begin with; None: from
            scratch. With the same contexts as that policy's its training goes on; else a copy of it
            is tuned.
        length: units of the training in all when it is done, those before `start` too where it goes
            on; 0: the policy `start` is only evaluated; None: one unit (more).
        targets: contexts to evaluate on; None: as the study has it.
        sources: indices of the contexts to train on where they are several, `source` among them.
    """

    source: int
    reason: str
    acquisition: float | None = None
    notes: tuple[str, ...] = ()
    chance_left: float | None = None
    start: int | None = None
    length: float | None = None
    targets: tuple[int, ...] | None = None
    sources: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        given: Any = () if self.sources is None else self.sources
        if not isinstance(given, Iterable):
            raise InvalidInput(
                f"sources are the contexts of a training on several, got {short(given)}"
            )
        object.__setattr__(self, "sources", tuple(given))  # an array or a generator will do

    @property
    def given(self) -> tuple[Any, ...]:
        """All that is trained on, as it was given."""
        return self.sources or (self.source,)

    @property
    def contexts(self) -> tuple[int, ...]:
        """Indices of all that is trained on, rising: their order does not matter."""
        return tuple(sorted(int(i) for i in self.given))


@dataclass(frozen=True)
class Outlook:
    """What a model believes at one moment, for people to look at.

    Attributes:
        model: whose it is, a selector's name.
        mean: (N,) of J(pi_x, x), the training performance on every context.
        std: (N,) its standard deviation.
        gain: (N,) acquisition of a training on every context, in V; NaN where it was not asked.
    """

    model: str
    mean: Array
    std: Array
    gain: Array


class Exhausted(StudyError):
    """Every context has been trained, is pending, or failed; or none is cheap enough."""


def open_candidates(problem: SelectionProblem, history: History) -> Mask:
    """(N,) mask of the contexts that may be proposed and that the cost budget still allows.

    Raises:
        Exhausted: there is none.
    """
    mask = history.open_mask(problem.n)
    if problem.trainable is not None:
        mask &= problem.trainable
    if not mask.any():
        raise Exhausted(
            f"all {len(problem.sources)} contexts are trained, pending or failed; nothing is left "
            "to propose"
        )
    if problem.costs is not None and problem.cost_budget is not None:
        left = problem.cost_budget - history.spent
        mask &= problem.costs <= left + 1e-9 * problem.cost_budget
        if not mask.any():
            raise Exhausted(
                f"every context left costs more than the {max(left, 0.0):g} that remain of "
                f"{problem.cost_budget:g}"
            )
    return mask


def believed_rows(problem: SelectionProblem, history: History) -> Array:
    """(k, N) performance; what was not evaluated as the transfer model believes it.

    On the shipped matrices, with 5 to 20 % of the targets evaluated, that has the smallest error of
    V of three rules (docs/decisions.md). NaN where nothing is known.
    """
    rows, seen = history.rows, np.isfinite(history.rows)
    if seen.all() or not seen.any():
        return rows
    believed = Beliefs(problem, history.sources, rows, history.errors)
    return np.where(seen, rows, believed.on(np.arange(problem.n))[0])


def served(problem: SelectionProblem, history: History) -> Array:
    """(N,) performance of the best policy on each target, observed or believed.

    -inf where nothing is known.
    """
    rows = believed_rows(problem, history)
    if rows is history.rows:
        return history.best
    return history.at_least(generalisation_performance(rows))


_USUAL = 0.9
"""Probability that a training gives a policy, before anything is known."""
_REGION = 0.3
"""Share of the space that a region takes in which trainings crash, roughly."""
_WEIGHT = 4.0
"""What one training adds to the log odds of another one at its place."""


def success_chance(problem: SelectionProblem, history: History) -> Array:
    """(N,) probability that a training on each context gives a policy, learnt from the past ones.

    log s / (1 - s) = log 9 + 4 sum_i +-exp(-|x - x_i|^2 / 2 h^2),  3 h the side of 30 % of the cube

    with + for trainings that gave a policy and - for those that did not: simulators crash by
    regions. It is 1 everywhere before the first failure.
    """
    if not history.failed:
        return np.ones(problem.n)
    reach = _REGION ** (1.0 / problem.unit.shape[1]) / 3.0
    odds = np.full(problem.n, np.log(_USUAL / (1.0 - _USUAL)))
    for sign, places in ((1.0, history.sources), (-1.0, history.failed)):
        for place in places:  # one after the other: there may be a million contexts
            apart = np.square(problem.unit - problem.unit[place]).sum(axis=1)
            odds += sign * _WEIGHT * np.exp(-apart / (2.0 * reach**2))
    return np.asarray(0.5 + 0.5 * np.tanh(odds / 2.0))


def likely_candidates(problem: SelectionProblem, history: History, mask: Mask) -> Mask:
    """(N,) those of `mask` where a training more likely than not gives a policy; all if none."""
    likely = mask & (success_chance(problem, history) >= 0.5)
    return likely if likely.any() else mask


def nearest_open(problem: SelectionProblem, point: Array, mask: Mask) -> int:
    """Open context nearest to `point` (D,) in grid steps; the lowest index on a tie."""
    distance = np.sqrt(((problem.steps - point) ** 2).sum(axis=1))
    distance[~mask] = np.inf
    return int(np.flatnonzero(distance <= distance.min() + 1e-9)[0])


def farthest_open(problem: SelectionProblem, taken: Sequence[int], mask: Mask) -> int:
    """Open context whose nearest taken one is farthest; the lowest index on a tie."""
    nearest = nearest_distance(problem.steps, problem.steps[list(taken)])
    nearest[~mask] = -np.inf
    return int(np.flatnonzero(nearest >= nearest.max() - 1e-9)[0])


def nearest_distance(points: Array, taken: Array) -> Array:
    """(M, D), (k, D) in grid steps -> (M,) distance of each point to the nearest that is taken."""
    nearest = np.full(len(points), np.inf)
    for place in taken:  # one after the other: there may be a million points
        nearest = np.minimum(nearest, np.sqrt(((points - place) ** 2).sum(axis=1)))
    return nearest


def first_pick(problem: SelectionProblem, history: History, mask: Mask) -> Proposal:
    """Before any row is known: the middle, then far from what is under way or failed."""
    taken = [*history.pending, *history.failed]
    if taken:
        return Proposal(farthest_open(problem, taken, mask), "far from what was tried so far")
    return Proposal(nearest_open(problem, centre(problem), mask), "middle of the range")


def centre(problem: SelectionProblem) -> Array:
    """(D,) middle of the grid in steps: halfway between the smallest and largest of each column."""
    return np.asarray((problem.steps.min(axis=0) + problem.steps.max(axis=0)) / 2.0)


def spread(problem: SelectionProblem, among: Indices, most: int) -> Indices:
    """At most `most` of the contexts, spread over the space, always the same ones."""
    if len(among) <= most:
        return among
    if problem.is_line:
        order = among[np.argsort(problem.line[among], kind="stable")]
        return np.sort(order[np.linspace(0, len(order) - 1, most).round().astype(np.intp)])
    return np.sort(among[np.argsort(_shuffled(problem.n)[among], kind="stable")[:most]])


@lru_cache(maxsize=1)
def _shuffled(n: int) -> Indices:
    """(n,) place of each context in a random order, always the same."""
    return np.argsort(np.random.default_rng(0).permutation(n))
