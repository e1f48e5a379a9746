"""Strategies on known transfer curves: every environment step is charged, nothing is trained.

What is paid for, and nothing else is free:
    training     the steps of every training, extension and discarded one
    checks       evaluations of a training on its own context on the way, where a training may end
                 early by them or the best policy so far is kept
    evaluation   episodes of a policy on targets
An episode of CartPole takes as many steps as its return says, so its price is the true one.
Elsewhere an episode is charged with the horizon, which is the true length where none ends early.

Selection and routes see one half of the episodes; V is of the other, which is a report's business
and not charged. A training on a context is done once: a second try there is not in the data. A
training on all contexts is possible where its rows are given, too, once at each length.

Notation (shapes): L lengths, M sources, N contexts, A lengths of trainings on all contexts.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mbtl.arrays import Array
from mbtl.errors import InvalidInput
from mbtl.routing import TIE_DECIMALS
from mbtl.seeds import selection_rng
from mbtl.selectors.base import SelectionProblem
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
    middle_of,
)
from mbtl.zoo.benchmark.curves import Kind, TransferCurves

HORIZONS = {"cartpole": 500, "pendulum": 200, "ring": 400, "ramp": 400}
"""Steps of an episode that nothing ends early, by family."""
ONE_PER_STEP = {"cartpole"}
"""Families whose return is the number of steps of the episode."""
CHECKS, CHECK_EPISODES = 50, 10
"""Evaluations on its own context during a whole training, and the episodes of each."""
_MOST_ACTIONS = 100_000


@dataclass(frozen=True, eq=False)
class OnAll:
    """Trainings on all contexts of a set of curves, one of each length, one seed.

    Attributes:
        steps: (A,) environment steps of each, rising.
        returns: (A, 2, N) raw returns of their policies, of both halves of the episodes.
    """

    steps: NDArray[np.int64]
    returns: Array


class StepWorld:
    """One seed of transfer curves as a world that strategies act in.

    Args:
        curves: of a CMDP.
        seed: index of the training seed.
        kind: which policy of a training at a length: the latest, or the best so far.
        horizon: steps of an episode; None: that of the family.
        on_all: trainings on all contexts; None: strategies cannot have one.

    Raises:
        InvalidInput: the horizon is not known, or lengths are not counted in steps.
    """

    def __init__(
        self,
        curves: TransferCurves,
        seed: int,
        kind: Kind = "last",
        horizon: int | None = None,
        on_all: OnAll | None = None,
    ) -> None:
        """Nothing is spent yet."""
        family = curves.name.split("-")[0]
        known = HORIZONS.get(family) if horizon is None else horizon
        if known is None:
            raise InvalidInput(
                f"nobody knows how long an episode of {curves.name!r} is; say it with `horizon`"
            )
        unit = known if curves.unit == "episodes" else 1
        self.curves, self.seed, self.kind, self.horizon = curves, seed, kind, known
        self.on_all = on_all
        self.lengths = np.asarray(curves.lengths) * unit
        self._exact = family in ONE_PER_STEP
        self._done = np.asarray(curves.steps[seed]) * unit  # (L, M)
        self._raw = curves.returns[kind][seed].astype(np.float64)  # (L, H, M, N)
        sources = range(curves.space.n) if curves.sources is None else curves.sources.tolist()
        self._row = {source: i for i, source in enumerate(sources)}

    def problem(self, budget: float) -> StepProblem:
        """What a strategy may know of it beforehand."""
        episodes = self.curves.episodes[0]
        marks = np.empty(0, dtype=np.int64) if self.on_all is None else self.on_all.steps
        return StepProblem(self.selection, self.lengths, budget, episodes, self.horizon, marks)

    @cached_property
    def selection(self) -> SelectionProblem:
        """Contexts, weights and theta."""
        curves = self.curves
        trainable = None
        if curves.sources is not None:
            trainable = np.isin(np.arange(curves.space.n), curves.sources)
        return SelectionProblem.of(
            curves.space, budget=len(self._row), theta=curves.theta, trainable=trainable
        )

    @cached_property
    def seen(self) -> Array:
        """(L, M, N) performance on the episodes that strategies and routes see."""
        return self.curves.bounds.normalise(self._raw[:, 0])

    @cached_property
    def fresh(self) -> Array:
        """(L, M, N) performance on the other episodes."""
        return self.curves.bounds.normalise(self._raw[:, 1])

    @cached_property
    def may_end_early(self) -> bool:
        """Whether some training of these curves did."""
        return bool((self.curves.steps[:, -1] < self.curves.lengths[-1]).any())

    @cached_property
    def episode_steps(self) -> Array:
        """(L, M, N) environment steps of an episode, mean of the half seen."""
        return self._lasted(self._raw[:, 0])

    def _lasted(self, returns: Array) -> Array:
        if self._exact:
            return np.asarray(np.clip(returns, 1.0, self.horizon))
        return np.full(returns.shape, float(self.horizon))

    def rows_of(self, training: Training, length: int) -> tuple[Array, Array, Array]:
        """(N,) performance seen and fresh, and steps of an episode, of a policy."""
        if training.on:
            assert self.on_all is not None
            raw = self.on_all.returns[length].astype(np.float64)
            seen, fresh = self.curves.bounds.normalise(raw)
            return seen, fresh, self._lasted(raw[0])
        i = self._row[training.source]
        return self.seen[length, i], self.fresh[length, i], self.episode_steps[length, i]

    @cached_property
    def training_price(self) -> Array:
        """(L, M) steps of a training from nothing to each mark, checks included."""
        price = self._done.astype(np.float64)
        if not (self.may_end_early or self.kind == "best"):
            return price
        every = self.lengths[-1] / CHECKS
        m = len(self._row)
        own = self.episode_steps[:, np.arange(m), list(self._row)]  # (L, M)
        steps = np.vstack([np.zeros((1, m)), self._done])
        checks = np.diff(np.floor(steps / every + 1e-6), axis=0)
        return np.asarray(price + np.cumsum(checks * CHECK_EPISODES * own, axis=0))

    def row(self, source: int) -> int:
        """Position of a source among the M that were trained on."""
        return self._row[source]

    def start(self, trail: Trail, source: int, length: int) -> Trail:
        """A training on a context to a mark."""
        if source not in self._row or any(t.source == source for t in trail.trainings):
            raise InvalidInput(
                f"a training starts on a trainable context without one, got {source}; extend it"
            )
        return self._trained(trail, len(trail.trainings), source, -1, length)

    def extend(self, trail: Trail, training: int, length: int) -> Trail:
        """A training continued to a later mark."""
        now = trail.trainings[training]
        if length <= now.length or now.ended:
            raise InvalidInput(
                f"a training goes on to a later mark unless it has ended, got {length} for {now}"
            )
        return self._trained(trail, training, now.source, now.length, length)

    def start_on(self, trail: Trail, sources: tuple[int, ...], length: int) -> Trail:
        """A training on all contexts to a mark."""
        every = set(self.selection.sources.tolist())
        done = {t.length for t in trail.trainings if t.on}
        if self.on_all is None or set(sources) != every or length in done:
            raise InvalidInput(
                "a training on several contexts is one on all, once at a length, and its rows are "
                f"given, got {len(sources)} contexts at length {length}"
            )
        marks = self.on_all.steps
        if not 0 <= length < len(marks):
            raise InvalidInput(f"a length is an index of {len(marks)} marks, got {length}")
        middle = middle_of(sources, self.selection.steps)
        now = Training(middle, length, int(marks[length]), ended=True, on=tuple(sources))
        return trail.with_training(len(trail.trainings), now, float(marks[length]))

    def _trained(self, trail: Trail, number: int, source: int, before: int, to: int) -> Trail:
        if not 0 <= to < len(self.lengths):
            raise InvalidInput(f"a length is an index of {len(self.lengths)} marks, got {to}")
        i = self._row[source]
        price = self.training_price[:, i]
        cost = float(price[to] - (price[before] if before >= 0 else 0.0))
        steps = int(self._done[to, i])
        now = Training(source, to, steps, ended=steps < self.lengths[to])
        return trail.with_training(number, now, cost)

    def evaluate(self, trail: Trail, policy: Policy, targets: tuple[int, ...]) -> Trail:
        """A policy on targets; those it was evaluated on already are free."""
        training = trail.trainings[policy.training]
        if not 0 <= policy.length <= training.length:
            raise InvalidInput(f"there is no policy at mark {policy.length} of {training} yet")
        new = np.unique(np.asarray(targets, dtype=np.intp))
        if policy in trail.policies:
            row = trail.rows[trail.policies.index(policy)]
            new = new[~np.isfinite(row[new])]
        if not len(new):
            raise InvalidInput(f"an evaluation needs targets that {policy} has not been seen on")
        seen, _, lasted = self.rows_of(training, policy.length)
        cost = float(lasted[new].sum() * self.curves.episodes[0])
        return trail.with_evaluation(policy, new, seen[new], cost)

    def act(self, trail: Trail, action: Action) -> Trail:
        """What an action leads to."""
        match action:
            case Start(source, length, None):
                return self.start(trail, source, length)
            case Start():
                raise InvalidInput(
                    "what a training becomes that begins with the weights of another one is in no "
                    "curve; replay a strategy that begins from scratch, or run this one live"
                )
            case StartOn(sources, length):
                return self.start_on(trail, sources, length)
            case Extend(training, length):
                return self.extend(trail, training, length)
            case Evaluate(policy, targets):
                return self.evaluate(trail, policy, targets)
            case Wait() | Stop():
                return trail

    def value(self, trail: Trail) -> float:
        """V on fresh episodes of all policies evaluated so far, routed by what was seen of them."""
        problem = self.selection
        route = serving(trail.filled, trail.sources, problem.steps)
        fresh = np.zeros(problem.n)
        for i in np.unique(route).tolist():
            policy, mine = trail.policies[i], route == i
            fresh[mine] = self.rows_of(trail.trainings[policy.training], policy.length)[1][mine]
        return float(fresh @ problem.weights)


def serving(rows: Array, sources: NDArray[np.intp], steps: Array) -> NDArray[np.intp]:
    """(N,) positions of the policies that serve: `routing.last_route`, all at once."""
    scores = np.round(np.where(np.isfinite(rows), rows, -np.inf), TIE_DECIMALS)
    distance = np.linalg.norm(steps[sources][:, None] - steps[None], axis=2)
    distance[scores < scores.max(axis=0)] = np.inf
    nearest = distance <= distance.min(axis=0)
    lowest = np.where(nearest & np.isfinite(distance), sources[:, None], steps.shape[0])
    return np.asarray(lowest.argmin(axis=0))


@dataclass(frozen=True)
class StepRun:
    """What a strategy did with its steps.

    Attributes:
        strategy: its name.
        seed: training seed of the curves.
        spent: (E,) environment steps, all in, at each moment when V changed.
        value: (E,) V then.
        trail: at the end.
        decide_seconds: wall time of all decisions.
        decisions: how many there were.
    """

    strategy: str
    seed: int
    spent: Array
    value: Array
    trail: Trail
    decide_seconds: float
    decisions: int

    @property
    def evaluation_share(self) -> float:
        """Part of all steps that went into evaluation on targets."""
        return sum(self.trail.evaluation_steps) / max(self.trail.spent, 1.0)


def replay_steps(strategy: Strategy, world: StepWorld, budget: float, *, seed: int = 0) -> StepRun:
    """Let a strategy act until its steps are spent.

    The action that goes over the budget is not done: what it would bring comes too late.

    Args:
        strategy: that decides.
        world: that charges.
        budget: environment steps, all in.
        seed: root seed of the strategy's generators.

    Raises:
        InvalidInput: an action is impossible.
    """
    problem, trail = world.problem(budget), Trail(world.selection.steps)
    spent, value, seconds, decisions = [], [], 0.0, 0
    while decisions < _MOST_ACTIONS:
        rng = selection_rng(seed, world.seed, decisions)
        begun = time.perf_counter()
        action = strategy.decide(problem, trail, rng)
        seconds += time.perf_counter() - begun
        decisions += 1
        after = world.act(trail, action)
        if after is trail or after.spent > budget:
            break
        trail = after
        if isinstance(action, Evaluate):
            spent.append(trail.spent)
            value.append(world.value(trail))
    return StepRun(
        strategy.name, world.seed, np.array(spent), np.array(value), trail, seconds, decisions
    )
