"""Replay of strategies over trainings of every kind: transfer data answer, nothing is trained.

A strategy asks as it does in a study, and what it asks for is rounded to what the data hold:

- all contexts: the one training on all that is extended, to the next mark that is no less than what
  was asked for; to the last one before it where the next one costs more than is left;
- a copy tuned on one context: of the generalist at the longest stored parent that is no longer than
  the one asked for (a copy of the policy of 8 units is answered by that of 4), its length likewise;
- one context from scratch: the whole training.

Each costs the units between its marks. Where a new training is longer than what is left, and there
is no shorter one, the run ends. What the data cannot answer (several contexts that lack some of the
sources, a context without trainings, a copy of a specialist or of less than a unit, a length of 0)
counts as a training that gave nothing, at no price, so that a strategy which takes failures into
account asks for something else; the run has it among `refused`. Policies are evaluated on all
targets, whatever a proposal says. A strategy that learned from matrices has not seen those of the
family (`held_out`).
"""

from __future__ import annotations

import time
from collections.abc import Collection
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from mbtl.arrays import Array
from mbtl.errors import InvalidInput
from mbtl.history import History, Training, standard_errors
from mbtl.plain import finite, short, whole
from mbtl.processes import threads_for
from mbtl.routing import last_route
from mbtl.seeds import selection_rng
from mbtl.selectors.base import Exhausted, Proposal, SelectionProblem, default_theta
from mbtl.selectors.contract import Proposes, check_proposal, traits_of
from mbtl.strategies import get_strategy
from mbtl.zoo.benchmark.compare import held_out
from mbtl.zoo.benchmark.matrix import TransferMatrix
from mbtl.zoo.benchmark.transfers import TransferData

ABILITIES = frozenset({"sets", "start", "length"})
"""What a trainer could do whose trainings the data are."""
_LEAST = 1e-6
"""Units that are no training any more."""
_REFUSALS = 50
"""Times that a strategy may ask in vain before the replay ends."""


class Row(NamedTuple):
    """One policy of the data.

    Attributes:
        training: what made it, as a history has it.
        source: the context trained on; of several, the one in their middle.
        price: units from where it began.
        seen: (N,) performance on the episodes to choose by.
        fresh: (N,) performance on those to report.
        deviation: (N,) of single episodes, performance.
    """

    training: Training
    source: int
    price: float
    seen: Array
    fresh: Array
    deviation: Array


@dataclass(frozen=True, eq=False)
class TrainingsRun:
    """What a strategy did with its units.

    Attributes:
        strategy: its name.
        seed: index of the seed of the data.
        budget: units that it had.
        trainings: contexts, start and length of each that was answered, in order.
        refused: likewise, that the data cannot answer.
        reasons: why each was asked for.
        units: (k,) paid after each.
        value: (k,) V after each, on fresh episodes, routed by those seen.
        decide_seconds: wall time of all proposals.
        history: at the end.
    """

    strategy: str
    seed: int
    budget: float
    trainings: tuple[Training, ...]
    refused: tuple[Training, ...]
    reasons: tuple[str, ...]
    units: Array
    value: Array
    decide_seconds: float
    history: History = field(repr=False)

    def at(self, units: float) -> float:
        """V when so many units are paid; NaN before the first training.

        Raises:
            InvalidInput: that is no number of units.
        """
        finite("units", units)
        done = int(np.searchsorted(self.units, units + _LEAST, side="right"))
        return float(self.value[done - 1]) if done else float("nan")


class TransferWorld:
    """One seed of transfer data, as a world that strategies train in.

    Args:
        data: of a CMDP.
        seed: index of its seed.
        theta: slope of the linear gap for selectors that take one; None: the library's.
        abilities: what the trainer is to be able to do.
    """

    def __init__(
        self,
        data: TransferData,
        seed: int,
        theta: float | None = None,
        abilities: Collection[str] = ABILITIES,
    ) -> None:
        """Nothing is trained yet.

        Raises:
            InvalidInput: there is no such seed, or ability.
        """
        if not isinstance(data, TransferData):
            raise InvalidInput(f"data are those of load_transfers(id), got {short(data)}")
        seeds = len(data.specialists)
        if not 0 <= whole("seed", seed) < seeds:
            raise InvalidInput(f"seed is an index from 0 to {seeds - 1}, got {seed}")
        listed = isinstance(abilities, Collection) and not isinstance(abilities, str)
        if not (listed and ABILITIES.issuperset(map(str, abilities))):
            raise InvalidInput(
                f"abilities are some of {sorted(ABILITIES)}, in a list, got {short(abilities)}"
            )
        self.data, self.seed, self.abilities = data, seed, frozenset(abilities)
        self.theta = default_theta(data.n) if theta is None else theta
        self._place = {int(source): i for i, source in enumerate(data.sources)}

    def problem(self, budget: int, *, any_training: bool = True) -> SelectionProblem:
        """What a strategy may know of it; a selector no more trainings than there are sources."""
        trainable = np.isin(np.arange(self.data.n), self.data.sources)
        units = budget if any_training else min(budget, len(self.data.sources))
        return SelectionProblem.of(
            self.data.space,
            budget=units,
            theta=self.theta,
            trainable=None if trainable.all() else trainable,
            abilities=self.abilities if any_training else None,
        )

    def answer(self, rows: list[Row], asked: Training, source: int, left: float) -> Row | None:
        """The policy that is there for a training, for at most `left` units; None: there is none.

        Args:
            rows: policies so far, in the order of the history.
            asked: the training.
            source: the context in its middle.
            left: units.

        Raises:
            Exhausted: a new training is longer than what is left, and nothing shorter is there.
        """
        before = rows[asked.start or 0].training.length if asked.goes_on else 0.0
        marks, bounds = self._marks(rows, asked), self.data.bounds
        mark = _rounded(list(marks), asked.length, before, left) if asked.length else None
        if mark is None and marks and not asked.goes_on and asked.length > left + _LEAST:
            raise Exhausted(f"{left:g} units are left, and more is asked for")
        if mark is None or any(row.training == replace(asked, length=mark) for row in rows):
            return None
        (seen, fresh), deviation = bounds.normalise(marks[mark][0]), marks[mark][1]
        made = replace(asked, length=mark)
        return Row(made, source, mark - before, seen, fresh, deviation / (bounds.high - bounds.low))

    def _marks(self, rows: list[Row], asked: Training) -> dict[float, tuple[Array, Array]]:
        """Units -> (2, N) returns and (N,) deviations of a training at each of its marks."""
        data, seed, first = self.data, self.seed, asked
        while first.goes_on:
            first = rows[first.start or 0].training
        parent = None if first.start is None else rows[first.start].training
        if len(asked.contexts) > 1:
            if parent is not None or not set(self._place) <= set(asked.contexts):
                return {}
            each, std = data.generalists, data.std.get("generalists", ())
            return {u: (each[u][seed], of[seed]) for u, of in zip(each, std, strict=True)}
        place = self._place.get(asked.contexts[0])
        if place is None:
            return {}
        if parent is None:
            return {1.0: (data.specialists[seed, :, place], data.std["specialists"][seed, place])}
        if len(parent.contexts) == 1:
            return {}
        own = max((p for p, _ in data.tuned if p <= parent.length + _LEAST), default=None)
        return {
            units: (raw[seed, :, place], data.std["tuned"][i, seed, place])
            for i, ((p, units), raw) in enumerate(data.tuned.items())
            if p == own
        }

    def value(self, rows: list[Row]) -> float:
        """V on fresh episodes, each context served by the policy that was seen best there."""
        known = self.history(rows, [], alone=False)
        route = last_route(known.rows, known.sources, self.data.space.steps)
        fresh = np.array([row.fresh for row in rows])
        return float(fresh[route, np.arange(self.data.n)] @ self.data.space.weights)

    def history(self, rows: list[Row], refused: list[Training], *, alone: bool) -> History:
        """What a strategy may see; a selector of specialists alone."""
        found = History(
            self.data.n,
            given_up=tuple(one for one in refused if not one.is_specialist),
            failed=tuple(one.contexts[0] for one in refused if one.is_specialist),
            paid=sum(row.price for row in rows),
        )
        if not rows:
            return found
        deviations = np.array([row.deviation for row in rows])
        found = replace(
            found,
            sources=tuple(row.source for row in rows),
            rows=np.array([row.seen for row in rows]),
            errors=standard_errors(deviations, [self.data.episodes[0]] * len(rows)),
            trainings=tuple(row.training for row in rows),
        )
        return found.specialists() if alone else found


def replay_trainings(
    strategy: str | Proposes, world: TransferWorld, budget: int, *, seed: int = 0
) -> TrainingsRun:
    """Let a strategy ask until its units are spent, or it asks for nothing that they buy.

    It ends after 50 trainings that the data cannot answer, too; `refused` of the run has them.

    Args:
        strategy: any of `mbtl.strategies`, selectors among them, by name, or your own.
        world: that answers and charges.
        budget: units.
        seed: root seed of the strategy's generators.

    Raises:
        InvalidInput: a proposal breaks the contract, or is one that was made before; the budget or
            the seed is no whole number.
    """
    budget, seed = whole("budget", budget), whole("seed", seed)
    if not isinstance(world, TransferWorld):
        raise InvalidInput(f"world is TransferWorld(data, seed), got {short(world)}")
    chosen = held_out(get_strategy(strategy), world.data.name)
    alone = not traits_of(chosen).any_training
    problem = world.problem(budget, any_training=not alone)
    rows, refused = list[Row](), list[Training]()
    reasons, value = list[str](), list[float]()
    seconds, paid = 0.0, 0.0
    while paid < problem.budget - _LEAST and len(refused) < _REFUSALS:
        rng = selection_rng(seed, world.seed, len(rows) + len(refused))
        history = world.history(rows, refused, alone=alone)
        begun = time.perf_counter()
        try:
            with threads_for(problem.n):
                proposal = chosen.propose(problem, history, rng)
        except Exhausted:
            break
        finally:
            seconds += time.perf_counter() - begun
        check_proposal(chosen, proposal, history, any_training=not alone)
        asked = _training(history, proposal)
        if asked in history.asked:
            raise InvalidInput(
                f"a training is asked for once, got {short(asked)} again from {chosen.name!r}; "
                "`history.asked` has those that are done or gave nothing"
            )
        try:
            row = world.answer(rows, asked, proposal.source, problem.budget - paid)
        except Exhausted:
            break
        if row is None:
            refused.append(asked)
            continue
        rows.append(row)
        paid += row.price
        reasons.append(proposal.reason)
        value.append(world.value(rows))
    return TrainingsRun(
        chosen.name,
        world.seed,
        float(budget),
        tuple(row.training for row in rows),
        tuple(refused),
        tuple(reasons),
        np.cumsum([row.price for row in rows]),
        np.array(value),
        seconds,
        world.history(rows, refused, alone=False),
    )


def specialists_of(data: TransferData, theta: float | None = None) -> TransferMatrix:
    """The specialists as a transfer matrix, for references that know no other trainings."""
    sources = None if len(data.sources) == data.n else data.sources
    return TransferMatrix(
        data.name,
        data.specialists[:, 0],
        data.space,
        data.bounds,
        default_theta(data.n) if theta is None else theta,
        data.std["specialists"],
        {"seeds": list(data.provenance)},
        data.specialists[:, 1],
        data.episodes,
        {},
        sources,
    )


def _training(history: History, proposal: Proposal) -> Training:
    """What is asked for, as a history has it."""
    before = None if proposal.start is None else history.made(proposal.start)
    goes_on = before is not None and before.contexts == proposal.contexts
    done = before.length if before is not None and goes_on else 0.0
    length = done + 1.0 if proposal.length is None else proposal.length
    return Training(proposal.contexts, proposal.start, length, goes_on)


def _rounded(marks: list[float], asked: float, before: float, left: float) -> float | None:
    """The least mark that is no less than what was asked for, or the last one there are units for.

    None: there is none beyond `before`.
    """
    there = sorted(m for m in marks if before + _LEAST < m <= before + left + _LEAST)
    enough = [mark for mark in there if mark >= asked - _LEAST]
    return enough[0] if enough else (there[-1] if there else None)
