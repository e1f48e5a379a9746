"""Leases: who may answer a pick, and until when by the clock of the database.

A token is new with every lease. Whoever takes a pick over gets another one, so a row that comes
late, from a worker believed dead, is told apart from the row of its successor: no process numbers
and no clocks of workers are compared.
"""

from __future__ import annotations

import contextlib
import socket
import uuid
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from filelock import FileLock, Timeout

from mbtl.study.storage import EventLog

PROPOSING = 60.0
"""Seconds in which a selector answers, or the next asker takes the proposal over."""


@dataclass(frozen=True)
class Lease:
    """The right to answer a pick.

    Attributes:
        token: what an answer must come with.
        worker: name of the holder, for people.
        seconds: without a heartbeat, after which others may take over; None: never.
        since: seconds since the epoch, by the clock of the database.
    """

    token: str
    worker: str
    seconds: float | None
    since: float


class Watch:
    """Which leases are stale at this moment; the database is asked at most once.

    Args:
        log: has the clock and the heartbeats.
        is_gone: says that a worker surely does not run any more.
    """

    def __init__(self, log: EventLog, is_gone: Callable[[str], bool]) -> None:
        self._log = log
        self._is_gone = is_gone

    def is_stale(self, lease: Lease | None) -> bool:
        """True when anybody may take over."""
        if lease is None:
            return True
        if lease.seconds is None:
            return False
        if self._is_gone(lease.worker):
            return True
        if self._now <= lease.since + lease.seconds:
            return False
        return self._now > self._beats.get(lease.token, 0.0)

    @cached_property
    def _beats(self) -> Mapping[str, float]:
        return self._log.beats()

    @cached_property
    def _now(self) -> float:
        return self._log.now()


def new_token() -> str:
    """Never given out before."""
    return uuid.uuid4().hex[:12]


def new_worker() -> str:
    """A name that is nobody else's, with the host for people."""
    return f"{socket.gethostname()}-{uuid.uuid4().hex[:6]}"


class Presence:
    """On one machine it is known at once that a worker is gone, and not when its lease ends.

    A run holds a lock on a file beside the study's database; the system lets go of it however the
    run ends. A file without a lock: surely gone. No file: nothing is known. So whoever ends and
    leaves work behind leaves the file, too, for all who look, and only who takes the last of that
    work over removes it. Where the database is a server there is no such file, and leases end by
    the clock alone.

    Args:
        database: file of the study; None: it has none, and nobody is ever surely gone.
    """

    def __init__(self, database: Path | None) -> None:
        self._database = database
        self._held: dict[str, FileLock] = {}

    def enter(self, worker: str) -> None:
        """From now on `worker` is here; where locks cannot be had nothing is said."""
        place = self._place(worker)
        if place is None or worker in self._held:
            return
        with contextlib.suppress(OSError, Timeout, NotImplementedError):
            lock = FileLock(place, blocking=False)
            lock.acquire()
            self._held[worker] = lock

    def leave(self, worker: str, leases: Iterable[Lease]) -> None:
        """It ends; of `leases`, those in force, none should be its own, but one may be."""
        lock = self._held.pop(worker, None)
        if lock is not None:
            self._forget(worker, leases)
            lock.release()

    def succeed(self, worker: str, leases: Iterable[Lease]) -> None:
        """What it held is held by somebody else; `leases` are in force now."""
        if self.is_gone(worker):
            self._forget(worker, leases)

    def is_gone(self, worker: str) -> bool:
        """True when it was here, and surely is not any more."""
        place = self._place(worker)
        if place is None or worker in self._held or not place.is_file():
            return False
        try:
            with FileLock(place, blocking=False):
                return True
        except (OSError, Timeout, NotImplementedError):
            return False

    def _forget(self, worker: str, leases: Iterable[Lease]) -> None:
        place = self._place(worker)
        if place is None or any(one.worker == worker and one.seconds for one in leases):
            return
        with contextlib.suppress(OSError):
            place.unlink(missing_ok=True)

    def _place(self, worker: str) -> Path | None:
        """The name comes from a log, which may be a stranger's."""
        if self._database is None or not worker.replace("-", "").replace(".", "").isalnum():
            return None
        return self._database.with_name(f".{self._database.name}.{worker}.lock")
