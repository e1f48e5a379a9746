"""Handing out picks: claimed, proposed, kept alive, given back."""

from __future__ import annotations

import contextlib
import random
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, overload

from mbtl.errors import InvalidInput, StorageError, StudyError
from mbtl.plain import is_finite, short, whole
from mbtl.selectors import Selector
from mbtl.study import asking, telling
from mbtl.study.artifacts import ArtifactStore
from mbtl.study.checks import check_event
from mbtl.study.events import Event
from mbtl.study.leases import asker, check_holds
from mbtl.study.pick import Pick, StudyFinished
from mbtl.study.records import PickRecord
from mbtl.study.state import StudyState
from mbtl.study.storage import Conflict, EventLog
from mbtl.study.view import StudyView
from mbtl.trainer import Trainer

_PAUSE, _LONGEST_PAUSE, _LONGEST_COMMIT = 0.01, 1.0, 0.1
"""Seconds between looks while somebody else proposes, or writes: few at first, since most wait for
a moment, then ever more, since many who look at once only disturb each other."""
_QUEUED = 50
"""Writes that take turns after one that came too late: where nobody disturbs, that costs time."""
_WATCH = 1.0
"""Seconds for which an asker believes what it knows of heartbeats: many wait at the same time."""


class LeasingStudy(StudyView):
    """What of `mbtl.study.Study` is about picks that are not answered so far.

    Attributes:
        selector: proposes trainings.
        proposes_ahead: propose picks for other workers that wait, too; False: each pick knows all
            rows that were told before it.
    """

    def __init__(
        self,
        log: EventLog,
        selector: Selector,
        *,
        folder: Path | ArtifactStore | None,
        name: str = "study",
        trainer: Trainer | None = None,
        state: StudyState | None = None,
    ) -> None:
        """Use `create_study` or `load_study`; the log must hold a `created` event."""
        super().__init__(log, folder=folder, name=name, trainer=trainer, state=state)
        self.selector = selector
        self.proposes_ahead = True
        self._queued = 0

    @overload
    def ask(self, n: None = None, *, lease: float | None = None) -> Pick: ...

    @overload
    def ask(self, n: int, *, lease: float | None = None) -> list[Pick]: ...

    def ask(self, n: int | None = None, *, lease: float | None = None) -> Pick | list[Pick]:
        """Propose the next training, or the next `n`, and lease them to this worker.

        Each of several is proposed as if those before it had given what is expected of them. A pick
        that somebody gave back, or whose lease has ended, is handed out again before a new one is
        proposed.

        Args:
            n: number of picks, for as many parallel trainings; fewer where fewer are left. None:
                one pick, not in a list.
            lease: seconds after which others may take the pick over, unless `heartbeat` is called
                meanwhile; None: never, until it is told, failed or given back (`release`).

        Raises:
            StudyFinished: the budget is spent, a stopping rule is met, or no context is left.
            InvalidInput: n < 1, or a lease that is not > 0.
        """
        if lease is not None and not (is_finite(lease) and lease > 0):
            raise InvalidInput(
                f"a lease lasts a number of seconds > 0, or None, got {short(lease)}"
            )
        if n is None:
            return self._ask(lease)
        if whole("the number n of picks", n) < 1:
            raise InvalidInput(f"ask gives a whole number of picks, 1 or more, got n = {n!r}")
        picks = [self._ask(lease)]
        while len(picks) < n:
            try:
                picks.append(self._ask(lease))
            except StudyFinished:
                break
        return picks

    def heartbeat(
        self, pick: Pick, *, steps: float | None = None, value: float | None = None
    ) -> bool:
        """Say that a training goes on, and hear whether it should.

        Args:
            pick: what `ask` gave.
            steps: environment steps done so far, for people.
            value: a return on the way, for people.

        Returns:
            True: go on; the lease begins anew. False: stop, because the pick was given back,
            answered, or taken over.
        """
        held = self.refresh().open_picks.get(pick.number)
        if held is None or held.lease is None or held.lease.token != pick.token:
            return False
        self._log.beat(pick.token, held.lease.seconds or 0.0, steps=steps, value=value)
        return True

    def pick(self, number: int) -> Pick:
        """A pick by its 0-based number, as whoever holds it has it: to answer it elsewhere.

        Raises:
            StudyError: so many were not asked for.
        """
        picks, number = self.refresh().picks, whole("the number of a pick", number)
        if not 0 <= number < len(picks):
            raise StudyError(f"pick numbers run from 0 to {len(picks) - 1} so far, got {number}")
        return self._pick(picks[number])

    def open_picks(self) -> list[Pick]:
        """The picks that wait for an answer, in order; `state.open_picks` says who holds them."""
        with self._lock:
            return [self._pick(record) for _, record in sorted(self.refresh().open_picks.items())]

    def release(self, pick: Pick | int) -> None:
        """Give a pick back untrained; the next `ask` hands it out again.

        Args:
            pick: what `ask` gave; or the number of any open pick, whoever holds it: its training
                is told to stop by its next heartbeat.

        Raises:
            StudyError: it is not open, or somebody took it over.
        """
        if not isinstance(pick, Pick):
            pick = whole("the number of a pick", pick)
        self._commit(lambda state: Event("released", {"pick": telling.held_number(state, pick)}))

    def release_all(self, worker: str) -> int:
        """Give back all that a worker holds, if it is known to have ended; how many picks.

        One that has not ended is told to stop by its next heartbeat.

        Raises:
            StudyError: it holds nothing.
        """
        state = self.refresh()
        check_holds(worker, self.leases)
        numbers = [n for n, pick in state.open_picks.items() if pick.worker == worker]
        for number in numbers:
            self.release(number)
        if self.state.proposing is not None and self.state.proposing.worker == worker:
            self._stop_proposing(self.state.proposing.token)
        return len(numbers)

    # ---- inside ------------------------------------------------------------------------------

    def _sent(self) -> tuple[Any, ...]:
        return (self.selector,)

    def _ask(self, lease: float | None) -> Pick:
        turn, retry = _Turn(_LONGEST_PAUSE), _Turn(_LONGEST_COMMIT)
        watch, watched, heard = self.watch(), time.monotonic(), 0.0

        def wanted(state: StudyState) -> Event | None:
            return asking.claim(state, watch, lease, self.worker, proposed=self.proposes_ahead)

        while True:
            if time.monotonic() - watched > _WATCH:
                watch, watched = self.watch(), time.monotonic()
            try:
                with self._lock:
                    claim = self._attempt(wanted)
                    following = len(self._state.picks)
            except Conflict:
                retry.wait()
                continue
            if claim is None:  # somebody proposes just now, and the next one for us, too
                if self.proposes_ahead and time.monotonic() > heard:
                    self._log.beat(asker(self.worker), 3.0 * _WATCH)
                    heard = time.monotonic() + _WATCH
                turn.wait()
                continue
            if claim.kind == "released":
                continue
            number = claim.data["pick"]
            is_next = claim.kind == "claimed" and number == following
            if is_next and not self._propose(claim.data["token"], lease):
                continue
            given = self._pick(self._state.picks[number])
            if given.token == claim.data["token"]:
                return given
            # the database was away until the lease had ended: it is somebody else's by now

    def _propose(self, token: str, lease: float | None) -> bool:
        """Find and record the source of the next pick; False where somebody else has done so.

        Raises:
            StudyFinished: there is none, or it would not be worth it.
        """
        done = False
        try:
            while not done:
                with self._lock:
                    state = self.refresh()
                    if state.proposing is None or state.proposing.token != token:
                        return False
                    known = len(state.rows), len(state.failures)
                    moment = asking.Moment.of(state)
                    ahead = self.proposes_ahead
                    more = asking.ahead(state, self.watch(), self.worker) if ahead else 0
                found = asking.propose(moment, self.selector, more)  # others may tell meanwhile
                holder = {"worker": self.worker, "token": token, "seconds": lease}

                def settled(
                    now: StudyState, found: Any = found, known: Any = known, holder: Any = holder
                ) -> Event:
                    if now.proposing is None or now.proposing.token != token:
                        raise _Superseded
                    news = known != (len(now.rows), len(now.failures))
                    if isinstance(found, str):
                        if news:  # the prediction did not know of it
                            raise _Superseded
                        return Event("stopped", {"reason": found})
                    if news and not asking.is_open(now, found):
                        raise _Superseded
                    return Event("asked", {**found, **holder})

                try:
                    self._commit(settled)
                    done = True
                except _Superseded:
                    continue
                if isinstance(found, str):
                    raise StudyFinished(f"the study is finished: {found}")
        finally:
            if not done:
                self._stop_proposing(token)
        return True

    def _stop_proposing(self, token: str) -> None:
        """Let the next asker propose at once, whatever has happened here."""

        def released(state: StudyState) -> Event:
            if state.proposing is None or state.proposing.token != token:
                raise _Superseded
            return Event("released", {"pick": len(state.picks)})

        with contextlib.suppress(StorageError, _Superseded):  # it ends by the clock, too
            self._commit(released)

    def _pick(self, record: PickRecord) -> Pick:
        return Pick(
            record.number,
            record.source,
            self.space.context(record.source),
            self._state.seed_of(record),
            record.reason,
            record.targets,
            record.sources,
            tuple(self.space.context(source) for source in record.sources),
            record.start,
            record.done,
            None if record.whole else record.length,
            record.tokens[-1] if record.tokens else "",
        )

    def _commit(self, decide: Callable[[StudyState], Event]) -> Event:
        """Append what `decide` makes of the newest state; decide anew if somebody was faster."""
        turn = _Turn(_LONGEST_COMMIT)
        while True:
            try:
                event = self._attempt(decide)
            except Conflict:
                turn.wait()
                continue
            assert event is not None
            return event

    def _attempt(self, decide: Callable[[StudyState], Event | None]) -> Event | None:
        """Append what `decide` makes of the newest state, which no other thread changes meanwhile.

        Returns:
            The event; None where there is nothing to append.

        Raises:
            Conflict: another process was faster.
        """
        with self._lock:
            event = decide(self.refresh())
            if event is None:
                return None
            with self._turn() as queued:
                if queued and (event := decide(self.refresh())) is None:
                    return None
                check_event(event, self._state)
                before = self._holder(event)
                self._log.append(event, after=self._state.seq)
                self.refresh()
            if before is not None:
                self.presence.succeed(before, self.leases)
            return event

    @contextlib.contextmanager
    def _turn(self) -> Iterator[bool]:
        """True where others were faster lately, so that this one waits for its turn to write."""
        queued = self._queued > 0
        self._queued -= queued
        try:
            with self._log.turn() if queued else contextlib.nullcontext():
                yield queued
        except Conflict:
            self._queued = _QUEUED
            raise

    def _holder(self, event: Event) -> str | None:
        """Name of the worker whose pick an event gives to somebody else; None: nobody's."""
        if event.kind not in ("claimed", "released"):
            return None
        held = self._state.open_picks.get(event.data["pick"])
        lease = self._state.proposing if held is None else held.lease
        return None if lease is None else lease.worker


class _Turn:
    """Waits for a moment, and for longer each time."""

    def __init__(self, longest: float) -> None:
        self._pause, self._longest = _PAUSE, longest

    def wait(self) -> None:
        time.sleep(self._pause * random.random())
        self._pause = min(2 * self._pause, self._longest)


class _Superseded(Exception):
    """What was to be recorded does not follow from the newest state."""
