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
from mbtl.study.steps.spec import StepSpec
from mbtl.untrusted import MALFORMED

Work = Start | StartOn | Extend | Evaluate
"""An action that costs steps."""


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
class StepState:
    """Everything the events say; `apply` takes the next one."""

    seq: int = 0
    spec: StepSpec | None = None
    version: str = ""
    uid: str = ""
    created_at: float = 0.0
    decisions: int = 0
    pending: Work | None = None
    """What was decided and is not done."""
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
        """Marks of a training, also of one that has not passed any."""
        on_all = isinstance(self.pending, StartOn)
        if training < len(self.trainings):
            on_all = bool(self.trainings[training].on)
        return self.the_spec.lengths_on_all if on_all else self.the_spec.lengths

    def number_of(self, action: Start | StartOn | Extend) -> int:
        """Which training an action is about, also while it is under way."""
        if isinstance(action, Extend):
            return action.training
        begun = self.trainings and self.trainings[-1].length < 0
        return len(self.trainings) - 1 if begun else len(self.trainings)

    def start_of(self, training: int) -> Policy | None:
        """The policy whose weights a training begins with, also one under way; None: scratch."""
        if training < len(self.trainings):
            return self.trainings[training].start
        return self.pending.start if isinstance(self.pending, Start) else None

    def repeats(self, source: int, *, on: bool) -> int:
        """Trainings so far on a context; with `on`, on several contexts."""
        return sum(bool(t.on) if on else t.source == source and not t.on for t in self.trainings)

    # ---- one method per kind of event --------------------------------------------------------

    def _opened(self, data: Mapping[str, Any], event: Event) -> None:
        self.spec = StepSpec.from_json(data["spec"])
        self.version, self.uid = data["version"], data["uid"]
        self.created_at = event.time

    def _decided(self, data: Mapping[str, Any], event: Event) -> None:
        self.pending = action_of(data["action"])
        self.decisions += 1

    def _trained(self, data: Mapping[str, Any], event: Event) -> None:
        action, number, mark = self.pending, int(data["training"]), int(data["mark"])
        if not isinstance(action, (Start, StartOn, Extend)):
            raise ValueError(f"a training, where {action} was to be done")
        if number == len(self.trainings):
            on = action.sources if isinstance(action, StartOn) else ()
            before = self.repeats(int(data["source"]), on=bool(on))
            start = action.start if isinstance(action, Start) else None
            self.trainings.append(Course(int(data["source"]), before, on=on, start=start))
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
            self.pending = None
        self.fresh, self.stopped = None, None
        self.failures.clear()

    def _halted(self, data: Mapping[str, Any], event: Event) -> None:
        action = self.pending
        assert isinstance(action, (Start, StartOn, Extend))
        number = self.number_of(action)
        if self.reached(number) >= 0:
            course = self.trainings[number]
            course.length, course.halted = self.reached(number), True
        self.pending, self.halted = None, True

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
        self.pending, self.fresh = None, None
        self.failures.clear()

    def _failed(self, data: Mapping[str, Any], event: Event) -> None:
        action, reason = self.pending, str(data["reason"])
        if isinstance(action, (Start, StartOn, Extend)):
            number = self.number_of(action)
            if self.reached(number) < 0:
                if isinstance(action, StartOn):
                    self.dead_on_sets = True
                else:
                    self.dead.append(int(data["source"]))
                del self.trainings[number:]
            else:  # as one that has ended: its policies stay
                course = self.trainings[number]
                course.length, course.failed = action.length, reason
            self.prices.failed += float(data["steps"])
        self.failures.append(reason)
        self.pending = None

    def _stopped(self, data: Mapping[str, Any], event: Event) -> None:
        self.stopped, self.pending = str(data["reason"]), None

    def _extended(self, data: Mapping[str, Any], event: Event) -> None:
        self.spec = replace(self.the_spec, budget=int(data["budget"]))
        self.stopped, self.fresh, self.halted = None, None, False
        for course in self.trainings:
            course.halted = False

    def _reported(self, data: Mapping[str, Any], event: Event) -> None:
        self.fresh = Fresh(
            event.arrays["returns"], data["error"], int(data["episodes"]), float(data["steps"])
        )


def record_of(action: Work) -> dict[str, Any]:
    """An action as JSON; `action_of` reads it back."""
    match action:
        case Start(source, length, start):
            record = {"do": "start", "source": int(source), "length": int(length)}
            return record if start is None else {**record, "start": _record_of_policy(start)}
        case StartOn(sources, length):
            some = [int(s) for s in sources]
            return {"do": "start on", "sources": some, "length": int(length)}
        case Extend(training, length):
            return {"do": "extend", "training": int(training), "length": int(length)}
        case Evaluate(policy, targets):
            some = [int(t) for t in targets]
            return {"do": "evaluate", **_record_of_policy(policy), "targets": some}


def _record_of_policy(policy: Policy) -> dict[str, int]:
    return {"training": int(policy.training), "length": int(policy.length)}


def action_of(record: Mapping[str, Any]) -> Work:
    """What `record_of` wrote."""
    match record["do"]:
        case "start":
            begun = record.get("start")
            start = None if begun is None else Policy(begun["training"], begun["length"])
            return Start(record["source"], record["length"], start)
        case "start on":
            return StartOn(tuple(int(s) for s in record["sources"]), int(record["length"]))
        case "extend":
            return Extend(record["training"], record["length"])
        case "evaluate":
            policy = Policy(record["training"], record["length"])
            return Evaluate(policy, tuple(record["targets"]))
    raise ValueError(f"no action is called {record['do']!r}")
