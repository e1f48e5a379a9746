"""The state of a study: a replay of its events, and nothing that is not in them."""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from mbtl.arrays import Array
from mbtl.contexts import middle_of
from mbtl.episodes import Episodes, completed
from mbtl.errors import StudyError
from mbtl.history import History, Training
from mbtl.objective import Bounds
from mbtl.routing import Routing
from mbtl.seeds import training_seed
from mbtl.selectors.base import SelectionProblem
from mbtl.study.budget import Bill, counted
from mbtl.study.events import Event
from mbtl.study.leases import Lease
from mbtl.study.records import LOGGED, Failure, FreshReturns, Pick, PickRecord, Plan, ToldRow
from mbtl.study.spec import LEAST_TARGETS, StudySpec

ABILITIES = ("sets", "start", "length")
"""What a trainer may be able to do beside specialists."""


@dataclass(eq=False)
class StudyState:
    """Everything the events say; `apply` takes the next one."""

    seq: int = 0
    spec: StudySpec = field(init=False, repr=False)
    """Of the first event."""
    version: str = ""
    uid: str = ""
    created_at: float = 0.0
    picks: list[PickRecord] = field(default_factory=list)
    open_picks: dict[int, PickRecord] = field(default_factory=dict)
    proposing: Lease | None = None
    """Of the worker that finds the source of the next pick; None: nobody does."""
    rows: list[ToldRow] = field(default_factory=list)
    failures: list[Failure] = field(default_factory=list)
    deferred: dict[int, Failure] = field(default_factory=dict)
    """Number of an open pick -> why its policy, which is trained, was not evaluated so far."""
    fresh: FreshReturns | None = None
    equipment: Mapping[str, Any] | None = None
    """Recipe and format of the policies, and own code; None: not known so far."""
    stopped: str | None = None
    _history: History | None = field(default=None, repr=False)
    _routing: Routing | None = field(default=None, repr=False)
    lost_steps: float = 0.0
    """Environment steps of trainings that gave nothing, each try of them."""
    evaluation_steps: float = 0.0
    """Environment steps of all evaluations that were asked for."""
    evaluated_targets: int = 0
    """On how many targets those were, each time."""
    _told_by: dict[int, ToldRow] = field(default_factory=dict, repr=False)
    """Number of the event -> the row that it told, also where that was taken back."""
    _performance: Array | None = field(default=None, repr=False)
    _errors: Array | None = field(default=None, repr=False)

    def apply(self, event: Event) -> None:
        """Advance by one event, which was checked (`mbtl.study.checks.advance`)."""
        getattr(self, f"_{event.kind}")(event)
        self._history = None
        self.seq = event.seq

    def is_proposed_with(self, token: str) -> bool:
        """Whether who has this token finds the source of the next pick."""
        return self.proposing is not None and self.proposing.token == token

    def copied(self) -> StudyState:
        """As it is now, and stays whatever is told meanwhile."""
        self.history()
        new = copy(self)
        for name in ("picks", "open_picks", "rows", "failures", "_told_by"):
            setattr(new, name, copy(getattr(self, name)))
        return new

    def problem(self) -> SelectionProblem:
        """What the strategy may know before any training, and of the trainer."""
        return self.spec.selection_problem(
            self.abilities, assumed="abilities" not in (self.equipment or {})
        )

    def history(self) -> History:
        """What a strategy may see: rows as performance under the bounds of this moment.

        Made once per event, since asking, stopping rules, progress and reports all look at it.
        """
        if self._history is None:
            self._history = self._make_history()
        return self._history

    def routing(self) -> Routing:
        """Who serves which context after every training, and what that is worth.

        Raises:
            StudyError: no row was told.
        """
        if not self.rows:
            raise StudyError("routes need the row of at least one policy, and none was told")
        if self._routing is None or len(self._routing) != len(self.rows):
            spec, history, earlier = self.spec, self.history(), self._routing
            if earlier is not None:  # bounds that were not given move with the rows
                first = history.rows[: len(earlier)]
                same = np.array_equal(earlier.rows, first, equal_nan=True)
                earlier = earlier if same else None
            self._routing = Routing(
                spec.space,
                history.sources,
                history.rows,
                self._episodes(),
                risk=spec.risk,
                earlier=earlier,
            )
        return self._routing

    def curve(self) -> Array:
        """(k,) V after each row; see `Study.curve`."""
        found = self.routing().curve if self.rows else []
        return np.array([value.value for value in found])

    def _make_history(self) -> History:
        n = self.spec.space.n
        if self._performance is None or len(self._performance) < len(self.rows):
            returns = np.array([row.returns for row in self.rows]).reshape(-1, n)
            self._performance = self.bounds().normalise(returns)
            self._performance.setflags(write=False)  # there may be gigabytes of it
            self._errors = self._episodes().errors if self.rows else None
        trainings = [self.training_of(row) for row in self.rows]
        busy = [self.training_of(pick) for pick in self.open_picks.values()]
        dead = [self.training_of(self.picks[failure.pick]) for failure in self.failures]
        usual = all(one.is_specialist for one in trainings)
        return History(
            n,
            tuple(row.source for row in self.rows),
            self._performance,
            tuple(one.contexts[0] for one in busy if one.is_specialist),
            tuple(one.contexts[0] for one in dead if one.is_specialist),
            self._errors,
            self.committed,
            () if usual else tuple(trainings),
            tuple(one for one in busy if not one.is_specialist),
            tuple(one for one in dead if not one.is_specialist),
            self.spec.budget - self.units_left,
        )

    def training_of(self, one: Plan) -> Training:
        """A pick or a row as a strategy sees it."""
        start = None if one.start is None else self.place_of(one.start)
        return Training(one.sources, start, one.length, one.done > 0.0)

    def _episodes(self) -> Episodes:
        return Episodes([row.each for row in self.rows], self.bounds())

    def bounds(self) -> Bounds:
        """The given bounds, or the range of all returns told so far (unit range before any)."""
        if self.spec.bounds is not None:
            return Bounds(*self.spec.bounds, self.spec.direction, self.spec.floor)
        if not self.rows:
            return Bounds(0.0, 1.0, self.spec.direction)
        return Bounds.of([row.returns for row in self.rows], self.spec.direction)

    @property
    def committed(self) -> float:
        """Cost of the rows told and, where costs are known, of picks that failed or are open.

        Each try that failed before counts, too.
        """
        open_ = () if self.spec.costs is None else self.open_picks.values()
        return self.cost_answered + sum(map(self.usual_cost, open_))

    @property
    def cost_answered(self) -> float:
        """The same without picks that are open."""
        if self.spec.costs is None:
            return self.cost
        vain = sum(self.usual_cost(self.picks[failure.pick]) for failure in self.failures)
        again = (self.usual_cost(pick) * pick.retries for pick in self.picks if pick.retries)
        return self.cost + vain + sum(again)

    @property
    def cost_left(self) -> float:
        """Of the cost budget, when all that is committed is paid; infinite where there is none."""
        budget = self.spec.cost_budget
        return np.inf if budget is None else budget * (1.0 + 1e-9) - self.committed

    def usual_cost(self, pick: PickRecord) -> float:
        """What a pick is expected to cost, in the unit of the cost budget."""
        costs = self.spec.costs
        each = 1.0 if costs is None else float(np.mean([costs[source] for source in pick.sources]))
        return each * pick.price

    @property
    def paid(self) -> float:
        """Units of all picks: done, failed or under way. Rows told unasked are free."""
        return sum(pick.price for pick in self.picks)

    @property
    def units_left(self) -> float:
        """Units that can still be paid; where a cost is, of the mean cost.

        In environment steps with an evaluation on all targets. Where these would eat more than half
        of what is left, or a whole training, they may be as few as `LEAST_TARGETS`.
        """
        spec = self.spec
        if spec.steps is None:
            return min(spec.budget - self.paid, self._cost_units)
        left = spec.steps - self.bill().total
        few = left - self.target_steps * min(LEAST_TARGETS, spec.space.n)
        whole = self.unit_steps if few >= self.unit_steps else 0.0
        return max(left - self.row_steps, few / 2.0, whole) / self.unit_steps

    @property
    def _cost_units(self) -> float:
        """Units that the rest of the cost pays for, at the mean cost that is known or was told."""
        spec = self.spec
        if spec.cost_budget is None:
            return np.inf
        told = [row.cost / row.price for row in self.rows if row.pick is not None]
        each = float(np.mean(spec.costs or told or 0.0))
        if each == 0.0:  # nothing is known of it
            return float(spec.space.n)
        held = 0.0 if spec.costs else sum(pick.price for pick in self.open_picks.values())
        return (spec.cost_budget - self.committed) / each - held

    @property
    def row_steps(self) -> float:
        """Environment steps that an evaluation on all targets of a pick is expected to cost."""
        return self.target_steps * (self.spec.eval_targets or self.spec.space.n)

    @property
    def unit_steps(self) -> float:
        """Environment steps that a unit costs."""
        return float(self.spec.unit or 0)

    @property
    def target_steps(self) -> float:
        """Environment steps that an evaluation on one target is expected to cost: the mean so far.

        Before the first, what the study was made with.
        """
        if self.evaluated_targets:
            return self.evaluation_steps / self.evaluated_targets
        return float(self.spec.target_steps or 0)

    @property
    def abilities(self) -> frozenset[str]:
        """What the trainer can do beside specialists; all, while none is known."""
        known = self.equipment or {}
        return frozenset(known.get("abilities", ABILITIES))

    def bill(self) -> Bill:
        """Environment steps so far; what is not known counts as much as it can be.

        Rows that nobody asked for are free.
        """
        spent = {True: 0.0, False: 0.0}  # on trainings that went on, on new ones
        for row in self._told_by.values():
            if row.pick is not None:
                spent[row.done > 0.0] += self._own_steps(row, row.steps)
        open_ = sum(self.expected_steps(pick) for pick in self.open_picks.values())
        return Bill(spent[False], spent[True], self.evaluation_steps, self.lost_steps, open_)

    def _own_steps(self, one: Plan, steps: float | None) -> float:
        """Environment steps that a pick cost, of those that its training has had in all."""
        before = self._parent(one.start) if one.done else None
        had = 0.0 if before is None else before.steps
        if steps is None or had is None:
            return self.unit_steps * one.price
        return max(steps - had, 0.0)

    def _pay_evaluation(self, returns: Array, steps: float | None) -> None:
        """Each episode counts as the longest where its environment steps are not known."""
        most = float(np.isfinite(returns).sum() * (self.spec.horizon or 0))
        self.evaluation_steps += most if steps is None else steps
        self.evaluated_targets += len(returns)

    def expected_steps(self, pick: PickRecord) -> float:
        """Environment steps that a pick is expected to cost, all in."""
        count = self.spec.space.n if pick.targets is None else len(pick.targets)
        return self.unit_steps * pick.price + self.target_steps * count

    def where(self, pick: Pick) -> str:
        """A pick for people, who count from 1: "pick 3 of 5: gravity = 7.5 m/s2"."""
        return f"{self.numbered(pick)}: {self.said(self.picks[pick.number])}"

    def numbered(self, pick: Pick, of: str = " of ") -> str:
        """Which it is: "pick 3 of 5", or "pick 3, 2.5 of 4 units" where they differ in price."""
        if self.spec.in_units and not self.spec.any_training:
            return f"pick {pick.number + 1}{of}{self.spec.budget}"
        return f"pick {pick.number + 1}, {self.spent_words()}"

    def said(self, one: Plan) -> str:
        """A training for people: "all contexts, 1 to 2 units", "x = 7, tuned from training 1"."""
        how = self.how(one)
        return self.spec.space.describe_set(one.sources) + (f", {how}" if how else "")

    def how(self, one: Plan) -> str:
        """From what and how long, in words; empty for a whole training from scratch."""
        units = f"{one.length:g} units"
        if not one.length:
            return f"{self._named(one.start)} evaluated further"
        if one.done:
            return f"{one.done:g} to {units}"
        tuned = [] if one.start is None else [f"tuned from {self._named(one.start)}"]
        return ", ".join([*tuned, *([] if one.length == 1.0 else [units])])

    def _named(self, start: int | None) -> str:
        """The policy that event number `start` told, as tables number it."""
        parent = self._parent(start)
        if parent is None or parent.pick is None:
            return "a policy told unasked"
        return f"training {parent.pick + 1}"

    def units(self) -> Array:
        """(k,) units of training of each row and all before it; those told unasked count, too."""
        return np.cumsum([row.price for row in self.rows])

    def spent_words(self, *, answered: bool = False) -> str:
        """How much of the budget is asked for, or done: "3 of 15 trainings", "cost 2.5 of 60"."""
        if (budget := self.spec.cost_budget) is not None:
            return f"cost {self.cost_answered if answered else self.committed:g} of {budget:g}"
        if self.spec.steps is not None:
            bill = self.bill()
            spent = bill.total - (bill.under_way if answered else 0.0)
            return f"{counted(spent)} of {counted(self.spec.steps)} steps"
        what = "units" if self.spec.any_training else "trainings"
        open_ = sum(pick.price for pick in self.open_picks.values()) if answered else 0.0
        return f"{self.paid - open_:g} of {self.spec.budget} {what}"

    def seed_of(self, pick: PickRecord) -> int:
        """Training seed of a pick; of one that goes on, that of the beginning."""
        spec, parent = self.spec, self._parent(pick.start)
        while pick.done and not pick.retries and parent is not None and parent.pick is not None:
            pick = self.picks[parent.pick]
            parent = self._parent(pick.start)
        return training_seed(
            spec.seed, spec.trial, pick.sources, pick.retries, self._lineage(parent)
        )

    def _parent(self, start: int | None) -> ToldRow | None:
        return None if start is None else self._told_by.get(start)

    def _lineage(self, row: ToldRow | None) -> tuple[int, ...]:
        """What a policy was made of: contexts, length, try, and its parent's likewise."""
        found: list[int] = []
        while row is not None:
            tries = 0 if row.pick is None else self.picks[row.pick].retries
            found += [len(row.sources), *row.sources, round(1000 * row.length), tries]
            row = self._parent(row.start)
        return tuple(found)

    @property
    def cost(self) -> float:
        """Total cost of the rows told."""
        return sum(row.cost for row in self.rows)

    # ---- one method per kind of event ---------------------------------------------------------

    def _created(self, event: Event) -> None:
        self.spec = StudySpec.from_json(event.data["spec"])
        self.version = event.data["version"]
        self.uid = event.data["uid"]
        self.created_at = event.time
        settings = self.spec.settings
        if {"recipe", "policy_format"} <= settings.keys():  # as `mbtl run` and `CMDP.study` do
            self.equipment = {name: settings[name] for name in ("recipe", "policy_format")}

    def _equipped(self, event: Event) -> None:
        self.equipment = {name: one for name, one in event.data.items() if name != "accepted"}
        self.stopped = None  # another trainer may be able to do more

    def _extended(self, event: Event) -> None:
        data, spec = event.data, self.spec
        left = None if data.get("to_the_end") else spec.stop_left
        others = ("steps", "cost_budget", "stop_value")
        own = {name: data.get(name, getattr(spec, name)) for name in others}
        self.spec = replace(spec, budget=data["budget"], stop_left=left, **own)
        self.stopped = None

    def _asked(self, event: Event) -> None:
        self.proposing = None
        pick = self.planned(event.data, event.time).leased(_lease_of(event))
        self.picks.append(pick)
        self.open_picks[pick.number] = pick

    def planned(self, facts: Mapping[str, Any], time: float = 0.0) -> PickRecord:
        """A pick as its facts say it, which nobody holds; without a number it is the next one."""
        sources, start, length = tuple(facts["sources"]), facts.get("start"), facts.get("length")
        parent = self._parent(start)
        goes_on = parent is not None and parent.sources == sources and length != 0.0
        done = parent.length if parent is not None and goes_on else 0.0
        return PickRecord(
            source=middle_of(sources, self.spec.space.steps),
            sources=sources,
            start=start,
            done=done,
            length=done + 1.0 if length is None else float(length),
            number=facts.get("pick", len(self.picks)),
            reason=facts["reason"],
            acquisition=facts["acquisition"],
            notes=tuple(facts["notes"]),
            asked_at=time,
            targets=None if facts.get("targets") is None else tuple(facts["targets"]),
            whole=length is None and start is None,
        )

    def _claimed(self, event: Event) -> None:
        self._hold(event.data["pick"], _lease_of(event))

    def _released(self, event: Event) -> None:
        self._hold(event.data["pick"], None)

    def _hold(self, number: int, lease: Lease | None) -> None:
        """Of the next pick there is only who finds it."""
        if number == len(self.picks):
            self.proposing = lease
        else:
            self.picks[number] = self.open_picks[number] = self.picks[number].leased(lease)

    def _told(self, event: Event) -> None:
        data = event.data
        self._close(data["pick"], data.get("token") or "")
        self.fresh = None  # a new policy may serve targets that were not reported
        self.stopped = None  # nor was the prediction made with this row
        targets = slice(None) if data.get("targets") is None else list(data["targets"])
        returns = event.arrays["returns"]
        each = np.full((self.spec.space.n, returns.shape[1]), np.nan)
        each[targets] = returns
        pick = None if data["pick"] is None else self.picks[data["pick"]]
        if pick is not None:
            self._pay_evaluation(returns, data.get("evaluation_steps"))
        if pick is not None and not pick.length:
            self._evaluated(pick, each)
            return
        if pick is None:
            facts = {"pick": -1, "sources": data["sources"], "reason": "", "acquisition": None}
            pick = self.planned({**facts, "notes": ()})
        facts = {one.name: getattr(pick, one.name) for one in fields(Plan)}
        facts |= {name: data.get(name) for name in LOGGED}
        row = ToldRow(each=each, told_at=event.time, event=event.seq, **facts)
        self.rows.append(row)
        self._told_by[event.seq] = row

    def _evaluated(self, pick: PickRecord, each: Array) -> None:
        """Further entries of a row; those that it had stay."""
        place = self.place_of(pick.start)
        if place < 0:  # it was taken back meanwhile
            return
        row = self.rows[place]
        wider = np.full((len(each), max(row.episodes, each.shape[1])), np.nan)
        wider[:, : row.episodes] = row.each
        new = np.isnan(wider).all(axis=1)
        wider[new, : each.shape[1]] = each[new]
        row = replace(row, each=wider)
        self.rows[place] = self._told_by[row.event] = row
        self._performance = self._routing = None

    def _late(self, event: Event) -> None:
        """The pick was somebody else's by then, so it counts for nothing."""

    def _voided(self, event: Event) -> None:
        place = self.place_of(event.data["told"])
        row = self.rows.pop(place)
        self.fresh = self.stopped = self._performance = self._routing = None
        if row.pick is not None:  # as a training that gave nothing: it may be tried again
            self.failures.append(Failure(row.source, row.pick, event.data["reason"]))

    def place_of(self, told: Any) -> int:
        """Place among the rows of the one that event number `told` recorded; -1: there is none."""
        return next((i for i, row in enumerate(self.rows) if row.event == told), -1)

    def _failed(self, event: Event) -> None:
        number = event.data["pick"]
        pick, failure = self.picks[number], Failure.of(event.data, self.picks[number].source)
        self.lost_steps += self._own_steps(pick, failure.steps)
        if event.data.get("again"):
            self._open_again(number)
            return
        self._close(number, event.data.get("token") or "")
        self.failures.append(failure)
        self.stopped = None  # the prediction believed that this pick would give something

    def _deferred(self, event: Event) -> None:
        number = event.data["pick"]
        self.deferred[number] = Failure.of(event.data, self.picks[number].source)

    def _reopened(self, event: Event) -> None:
        number = event.data["pick"]
        self.failures = [failure for failure in self.failures if failure.pick != number]
        if (trained := self.deferred.pop(number, None)) is not None:  # and is trained once more
            self.lost_steps += self._own_steps(self.picks[number], trained.steps)
        self._open_again(number)

    def _open_again(self, number: int) -> None:
        """Nobody holds it, and it has another seed."""
        pick = replace(self.picks[number].leased(None), retries=self.picks[number].retries + 1)
        self.picks[number] = self.open_picks[number] = pick

    def _close(self, number: int | None, token: str) -> None:
        if number is not None:
            self.open_picks.pop(number, None)
            self.deferred.pop(number, None)
            self.picks[number] = replace(self.picks[number], lease=None, answered_by=token)

    def _stopped(self, event: Event) -> None:
        self.stopped = event.data["reason"]
        self.proposing = None

    def _reported(self, event: Event) -> None:
        arrays, data = event.arrays, event.data
        names, units = data.get("baselines") or [], data.get("metrics") or {}
        who, counts = ["policies", *names], np.isfinite(arrays["served"]).sum(axis=1)
        told = (arrays["served"], arrays["alone"], *arrays.get("baselines", ()))
        served, alone, *others = (completed(each, gaps=True) for each in told)
        self.fresh = FreshReturns(
            served,
            alone,
            data["best_single"],
            dict(zip(names, others, strict=True)),
            units,
            {w: dict(zip(units, m, strict=True))
             for w, m in zip(who, arrays["metrics"], strict=True)} if units else {},
            tuple(data.get("lost") or ()),
            int(counts[counts > 0].min(initial=data["episodes"])),
        )  # fmt: skip


def _lease_of(event: Event) -> Lease:
    data = event.data
    return Lease(data["token"], data["worker"], data.get("seconds"), event.time)
