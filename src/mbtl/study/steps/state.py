"""The state of a study that is paid in steps: a replay of its events.

Notation (shapes): N contexts, k policies evaluated.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from mbtl.actions import Evaluate, Extend, Policy, Start, StartOn, Trail, Training
from mbtl.arrays import Array
from mbtl.errors import StorageError
from mbtl.objective import Bounds
from mbtl.study.events import OPENED, Event
from mbtl.study.leases import Lease
from mbtl.study.steps.record import Work, action_of
from mbtl.study.steps.spec import StepSpec
from mbtl.untrusted import MALFORMED


@dataclass(frozen=True)
class Mark:
    """A policy on the way of a training.

    Attributes:
        steps: environment steps of the training until then.
        checks: environment steps of its evaluations of itself until then.
        place: of the policy in the study's store; None: kept in memory only.
        sha256: of the policy's files.
    """

    steps: int
    checks: int
    place: str | None
    sha256: str | None


@dataclass
class Course:
    """One training so far.

    Attributes:
        source: context index.
        repeat: trainings before it on the same source.
        marks: what was kept, by the index of its length.
        length: index of the length that it counts as; beyond its last mark where it ended early.
        ended: nothing left to gain.
        failed: why it cannot go on; None: it can.
        halted: no steps were left for it.
        seconds: wall time.
        on: contexts of a training on several, of which `source` is the middle one; else none.
        start: the policy whose weights it began with; None: from scratch.
        decision: number of the decision that began it, by which its files are called.
    """

    source: int
    repeat: int = 0
    marks: dict[int, Mark] = field(default_factory=dict)
    length: int = -1
    ended: bool = False
    failed: str | None = None
    halted: bool = False
    seconds: float = 0.0
    on: tuple[int, ...] = ()
    start: Policy | None = None
    decision: int = 0

    def at(self, length: int) -> tuple[int, Mark]:
        """The latest mark up to a length."""
        mark = max(m for m in self.marks if m <= length)
        return mark, self.marks[mark]

    @property
    def steps(self) -> int:
        """Environment steps done."""
        return max((mark.steps for mark in self.marks.values()), default=0)

    @property
    def checks(self) -> int:
        """Environment steps of its evaluations of itself."""
        return max((mark.checks for mark in self.marks.values()), default=0)


@dataclass(frozen=True)
class Fresh:
    """V on fresh episodes, whose steps nobody is charged for.

    Attributes:
        returns: (N,) mean returns of the policies that serve, raw units.
        error: standard error of V, raw units; None: unknown.
        episodes: behind each return.
        steps: environment steps of all of them.
    """

    returns: Array
    error: float | None
    episodes: int
    steps: float


@dataclass
class Prices:
    """Environment steps by what they were paid for.

    Attributes:
        training: of new trainings.
        extension: of trainings that went on.
        checks: evaluations that trainings made of themselves, to end early.
        evaluation: episodes of policies on targets.
        failed: trainings that gave nothing.
    """

    training: float = 0.0
    extension: float = 0.0
    checks: float = 0.0
    evaluation: float = 0.0
    failed: float = 0.0

    @property
    def total(self) -> float:
        """All of them."""
        return self.training + self.extension + self.checks + self.evaluation + self.failed


@dataclass
class UnderWay:
    """An action that was decided and is not done.

    Attributes:
        work: what.
        training: its number; None: it has not passed a mark.
        lease: who is at it; None: nobody, or that does not matter.
    """

    work: Work
    training: int | None = None
    lease: Lease | None = None


@dataclass
class StepState:
    """Everything the events say; `apply` takes the next one."""

    seq: int = 0
    spec: StepSpec | None = None
    version: str = ""
    uid: str = ""
    created_at: float = 0.0
    kept: Mapping[str, str] = field(default_factory=dict)
    """Where the policies are, as `kept.marked` left it; empty where nothing was."""
    code: Mapping[str, Any] | None = None
    """A user's own, by which policies are made and evaluated; None: not known so far."""
    decisions: int = 0
    under_way: dict[int, UnderWay] = field(default_factory=dict)
    """What was decided and is not done, by the number of its decision."""
    trainings: list[Course] = field(default_factory=list)
    policies: list[Policy] = field(default_factory=list)
    returns: list[Array] = field(default_factory=list)
    """(N,) per policy, raw units, NaN where not evaluated."""
    evaluation_steps: list[float] = field(default_factory=list)
    prices: Prices = field(default_factory=Prices)
    dead: list[int] = field(default_factory=list)
    """Sources of trainings that gave nothing."""
    dead_on_sets: bool = False
    """A training on several contexts gave nothing."""
    failures: list[str] = field(default_factory=list)
    """Reasons, in order, since the last success."""
    halted: bool = False
    """A training was stopped short: what is left goes into evaluation."""
    stopped: str | None = None
    fresh: Fresh | None = None

    def apply(self, event: Event) -> None:
        """Advance by one event."""
        if event.seq != self.seq + 1:
            raise StorageError(f"event {self.seq + 1} is missing from the log, got {event.seq}")
        if (self.spec is None) != (event.kind == OPENED):
            raise StorageError(
                f"event {event.seq} ({event.kind}) is out of place; this is no study that is paid "
                "in steps, or its log is damaged"
            )
        try:
            getattr(self, f"_{event.kind}")(event.data, event)
        except MALFORMED as error:
            raise StorageError(
                f"event {event.seq} ({event.kind}) of the study is damaged or not ours: {error}; "
                "restore a copy of the study"
            ) from error
        self.seq = event.seq

    # ---- what follows ------------------------------------------------------------------------

    @property
    def spent(self) -> float:
        """Environment steps, all in."""
        return self.prices.total

    def bounds(self) -> Bounds:
        """The given bounds, or the range of all returns seen so far (unit range before any)."""
        spec = self.the_spec
        if spec.bounds is not None:
            return Bounds(*spec.bounds, spec.direction, spec.floor)
        if not self.returns:
            return Bounds(0.0, 1.0, spec.direction)
        return Bounds.of(np.array(self.returns), spec.direction)

    @property
    def the_spec(self) -> StepSpec:
        """What the study was opened with."""
        assert self.spec is not None
        return self.spec

    def trail(self) -> Trail:
        """What a strategy may see: trainings that gave nothing are not in it."""
        trainings = tuple(
            Training(t.source, t.length, t.steps, t.ended or t.failed is not None, t.on, t.start)
            for t in self.trainings
        )
        return Trail(
            self.the_spec.space.steps,
            trainings,
            tuple(self.policies),
            self.bounds().normalise(np.array(self.returns)) if self.returns else np.empty((0, 0)),
            tuple(self.evaluation_steps),
            self.spent,
            tuple(held.work for held in self.under_way.values()),
        )

    def value(self) -> float:
        """V by the rows that route the policies, performance; -inf before the first one."""
        filled = self.trail().filled
        return float(filled.max(axis=0) @ self.the_spec.space.weights) if len(filled) else -np.inf

    def reached(self, training: int) -> int:
        """Index of the last mark of a training; -1: none, or it has not begun."""
        known = training < len(self.trainings)
        return max(self.trainings[training].marks, default=-1) if known else -1

    def lengths_of(self, training: int) -> tuple[int, ...]:
        """Marks of a training."""
        return self._marks(on_all=bool(self.trainings[training].on))

    def marks_of(self, held: UnderWay) -> tuple[int, ...]:
        """Marks of a training that is under way."""
        if held.training is not None:
            return self.lengths_of(held.training)
        return self._marks(on_all=isinstance(held.work, StartOn))

    def work_on(self, training: int) -> Start | StartOn | Extend | None:
        """The training that is under way under this number; None: it is not."""
        for held in self.under_way.values():
            if held.training == training and not isinstance(held.work, Evaluate):
                return held.work
        return None

    def number_of(self, held: UnderWay) -> int:
        """Of a training under way; of one without a mark that which it would have now."""
        return len(self.trainings) if held.training is None else held.training

    def start_of(self, held: UnderWay) -> Policy | None:
        """The policy whose weights a training under way begins with; None: scratch."""
        if held.training is not None:
            return self.trainings[held.training].start
        return held.work.start if isinstance(held.work, Start) else None

    def _marks(self, *, on_all: bool) -> tuple[int, ...]:
        return self.the_spec.lengths_on_all if on_all else self.the_spec.lengths

    def _held(self, data: Mapping[str, Any]) -> tuple[int, UnderWay]:
        """What an event answers; before there were several workers the latest decision."""
        number = int(data.get("decision", self.decisions - 1))
        return number, self.under_way[number]

    def repeats(self, source: int, *, on: bool) -> int:
        """Trainings so far on a context; with `on`, on several contexts."""
        return sum(bool(t.on) if on else t.source == source and not t.on for t in self.trainings)

    # ---- one method per kind of event --------------------------------------------------------

    def _opened(self, data: Mapping[str, Any], event: Event) -> None:
        self.spec = StepSpec.from_json(data["spec"])
        self.version, self.uid = data["version"], data["uid"]
        self.created_at, self.kept = event.time, dict(data.get("kept") or {})

    def _equipped(self, data: Mapping[str, Any], event: Event) -> None:
        self.code = dict(data["code"])

    def _decided(self, data: Mapping[str, Any], event: Event) -> None:
        work = action_of(data["action"])
        training = work.training if isinstance(work, Extend) else None
        self.under_way[int(data["number"])] = UnderWay(work, training, _lease(data, event))
        self.decisions += 1

    def _claimed(self, data: Mapping[str, Any], event: Event) -> None:
        self._held(data)[1].lease = _lease(data, event)

    def _released(self, data: Mapping[str, Any], event: Event) -> None:
        self._held(data)[1].lease = None

    def _trained(self, data: Mapping[str, Any], event: Event) -> None:
        decision, held = self._held(data)
        action, number, mark = held.work, int(data["training"]), int(data["mark"])
        if isinstance(action, Evaluate) or number != self.number_of(held):
            raise ValueError(f"training {number}, where {action} was to be done")
        if held.training is None:
            on = action.sources if isinstance(action, StartOn) else ()
            before = self.repeats(int(data["source"]), on=bool(on))
            start = action.start if isinstance(action, Start) else None
            source = int(data["source"])
            made = Course(source, before, on=on, start=start, decision=decision)
            self.trainings.append(made)
            held.training = number
        course = self.trainings[number]
        steps, checks = int(data["steps"]), int(data["checks"])
        paid = steps - course.steps
        if isinstance(action, Extend):
            self.prices.extension += paid
        else:
            self.prices.training += paid
        self.prices.checks += checks - course.checks
        course.marks[mark] = Mark(steps, checks, data["policy"], data["sha256"])
        course.seconds += float(data["seconds"] or 0.0)
        course.halted = False
        course.ended = bool(data["ended"])
        if course.ended or mark >= action.length:
            course.length = action.length
            del self.under_way[decision]
        self.fresh, self.stopped = None, None
        self.failures.clear()

    def _halted(self, data: Mapping[str, Any], event: Event) -> None:
        decision, held = self._held(data)
        if held.training is not None:
            course = self.trainings[held.training]
            course.length, course.halted = self.reached(held.training), True
        del self.under_way[decision]
        self.halted = True

    def _evaluated(self, data: Mapping[str, Any], event: Event) -> None:
        policy = Policy(int(data["training"]), int(data["length"]))
        row = np.full(self.the_spec.space.n, np.nan)
        targets = np.asarray(data["targets"], dtype=np.intp)
        if policy in self.policies:
            place = self.policies.index(policy)
        else:
            place = len(self.policies)
            self.policies.append(policy)
            self.returns.append(row)
            self.evaluation_steps.append(0.0)
        self.returns[place] = self.returns[place].copy()
        self.returns[place][targets] = event.arrays["returns"]
        self.evaluation_steps[place] += float(data["steps"])
        self.prices.evaluation += float(data["steps"])
        del self.under_way[self._held(data)[0]]
        self.fresh = None
        self.failures.clear()

    def _failed(self, data: Mapping[str, Any], event: Event) -> None:
        decision, held = self._held(data)
        action, reason = held.work, str(data["reason"])
        if not isinstance(action, Evaluate):
            if held.training is not None:  # as one that has ended: its policies stay
                course = self.trainings[held.training]
                course.length, course.failed = action.length, reason
            elif isinstance(action, StartOn):
                self.dead_on_sets = True
            else:
                self.dead.append(int(data["source"]))
            self.prices.failed += float(data["steps"])
        self.failures.append(reason)
        del self.under_way[decision]

    def _stopped(self, data: Mapping[str, Any], event: Event) -> None:
        self.stopped = str(data["reason"])
        self.under_way.clear()

    def _extended(self, data: Mapping[str, Any], event: Event) -> None:
        self.spec = replace(self.the_spec, budget=int(data["budget"]))
        self.stopped, self.fresh, self.halted = None, None, False
        for course in self.trainings:
            course.halted = False

    def _reported(self, data: Mapping[str, Any], event: Event) -> None:
        self.fresh = Fresh(
            event.arrays["returns"], data["error"], int(data["episodes"]), float(data["steps"])
        )


def _lease(data: Mapping[str, Any], event: Event) -> Lease | None:
    if not data.get("token"):
        return None
    return Lease(data["token"], data["worker"], data["lease"], event.time)
