"""Claims: which worker is at which action of a study that is paid in steps.

An action is leased from its decision on. Whoever holds it says from time to time that it lives, and
hears whether it should go on; one that is silent for too long, or whose process has ended, is
succeeded by another worker, which goes on from the last mark. What comes late is not recorded.
"""

from __future__ import annotations

import contextlib
import random
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from types import TracebackType
from typing import TYPE_CHECKING, Any

from mbtl.actions import Evaluate
from mbtl.arrays import Array
from mbtl.errors import MbtlError, StorageError
from mbtl.study.events import Kind
from mbtl.study.keeper import Keeper
from mbtl.study.leases import new_token
from mbtl.study.steps.record import Work, record_of
from mbtl.study.steps.state import UnderWay
from mbtl.study.storage import Conflict
from mbtl.trainer import Progress

if TYPE_CHECKING:
    from mbtl.study.steps.study import StepStudy

LEASE = 60.0
"""Seconds for which a worker may be silent before others take its action over."""
_ANSWERS = ("claimed", "released", "trained", "evaluated", "halted", "failed")
_COME_TO = frozenset(("trained", "evaluated", "claimed", "released"))
_DECIDED = _COME_TO | {"decided"}
"""News beside which a decision still stands, and those beside which an evaluation does."""
_LATE = 20
"""Events that a worker writes in turn after one that came too late."""
_LOOK, _LONGEST_LOOK = 0.05, 2.0
"""Seconds between looks at what others do: often at first, seldom while nothing happens."""


class Lost(MbtlError):
    """An action is somebody else's by now; what was done of it here counts for nothing."""


@dataclass(frozen=True)
class Claim:
    """The right to carry out an action.

    Attributes:
        number: of its decision.
        token: with which answers come; empty where there is nobody else.
    """

    number: int
    token: str


class Claims:
    """The claims of one run; a context manager.

    Args:
        study: whose actions they are.
        seconds: that a lease lasts.
    """

    def __init__(self, study: StepStudy, seconds: float) -> None:
        self._study, self._seconds = study, seconds
        self._keeper = Keeper(study, seconds, _ANSWERS, "decision")
        self._pause, self._late = _LOOK, 0

    def __enter__(self) -> Claims:
        self._keeper.__enter__()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._keeper.__exit__(kind, error, trace)

    def decided(
        self, work: Work, seconds: float, after: int, is_paid: Callable[[Work], bool]
    ) -> Claim | None:
        """Record a decision that follows from event `after`; None: others were faster.

        What others have only come to meanwhile does not speak against it: they might have come to
        it a moment later. Where they have decided, too, it is decided again, since two would begin
        on the same context; but a policy that waits for its evaluation still does.

        Args:
            work: what was decided.
            seconds: that it took.
            after: the event that it follows from.
            is_paid: whether there are still steps for it.
        """
        study = self._study
        while True:
            with self._turn():
                if study.state.seq > after:
                    news = {e.kind for e in study.log.read(after) if e.seq <= study.state.seq}
                    busy = study.trail.busy
                    waits = isinstance(work, Evaluate) and work.policy.training not in busy
                    if news - (_DECIDED if waits else _COME_TO) or not is_paid(work):
                        return None
                    after = study.state.seq
                claim = Claim(study.state.decisions, self._token())
                record = {"number": claim.number, "action": record_of(work), "seconds": seconds}
                taken = self._taken(claim, "decided", record, after)
                if taken is not None:
                    return taken

    def abandoned(self) -> Claim | None:
        """Take over an action that nobody works on any more; None: there is none."""
        study, watch = self._study, self._study.watch()
        state = study.state
        for number, held in state.under_way.items():
            if watch.is_stale(held.lease):
                claim = Claim(number, self._token())
                taken = self._taken(claim, "claimed", {"decision": number}, state.seq)
                if taken is not None and held.lease is not None:
                    study.presence.succeed(held.lease.worker, study.leases)
                return taken
        return None

    def held(self, claim: Claim) -> UnderWay:
        """What is to be done.

        Raises:
            Lost: it is somebody else's by now, or done.
        """
        held = self._study.state.under_way.get(claim.number)
        token = "" if held is None or held.lease is None else held.lease.token
        if held is None or token != claim.token:
            raise Lost(f"action {claim.number + 1} was taken over by another worker")
        return held

    def is_open(self, claim: Claim) -> bool:
        """Whether something of it is left to do."""
        return claim.number in self._study.refresh().under_way

    def answer(
        self,
        claim: Claim,
        kind: Kind,
        data: Mapping[str, Any],
        arrays: Mapping[str, Array] | None = None,
    ) -> None:
        """Record what came of an action, or of a piece of it.

        Raises:
            Lost: it is somebody else's by now.
        """
        study, answer = self._study, {"decision": claim.number, "token": claim.token}
        while True:
            state = study.refresh()
            with self._turn():
                held = self.held(claim)
                named = {"training": state.number_of(held)} if kind in ("trained", "halted") else {}
                try:
                    study.append(kind, {**data, **named, **answer}, arrays, after=state.seq)
                except Conflict:
                    self._late = _LATE
                    continue
            break
        if claim.number not in study.state.under_way:
            self._keeper.drop(claim)

    def said(self, claim: Claim, progress: Progress) -> None:
        """What the next heartbeat tells of a training.

        Raises:
            Lost: the answer to the last one was that it should stop.
        """
        self._keeper.said(claim, progress)
        if self._keeper.is_lost(claim):
            raise Lost(f"action {claim.number + 1} was taken over by another worker")

    def give_back(self, claim: Claim) -> None:
        """Nobody is at it any more; others take it over at once."""
        self._keeper.drop(claim)
        if claim.token:
            with contextlib.suppress(StorageError, Lost):  # its lease ends by the clock, too
                if self.is_open(claim):
                    self.answer(claim, "released", {})

    def drop(self, claim: Claim) -> None:
        """It was lost."""
        self._keeper.drop(claim)

    def wait(self) -> None:
        """For a moment, and longer each time; `work_again` begins anew."""
        time.sleep(self._pause * random.uniform(0.5, 1.0))
        self._pause = min(1.5 * self._pause, _LONGEST_LOOK)

    def work_again(self) -> None:
        """Something has happened."""
        self._pause = _LOOK

    @contextlib.contextmanager
    def _turn(self) -> Iterator[None]:
        """Who came too late lately waits for a turn to write, where the database can make others.

        Then it knows what others have written meanwhile.
        """
        if not self._late:
            yield
            return
        self._late -= 1
        with self._study.log.turn():
            self._study.refresh()
            yield

    def _token(self) -> str:
        return new_token() if self._study.is_durable else ""

    def _taken(self, claim: Claim, kind: Kind, data: Mapping[str, Any], after: int) -> Claim | None:
        holder = {"token": claim.token, "worker": self._study.worker, "lease": self._seconds}
        try:
            self._study.append(kind, {**data, **(holder if claim.token else {})}, after=after)
        except Conflict:
            self._late = _LATE
            self._study.refresh()
            return None
        self._keeper.hold(claim)
        return claim
