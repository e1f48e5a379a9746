"""Leases: who may answer a pick, and until when by the clock of the database.

A token is new with every lease. Whoever takes a pick over gets another one, so a row that comes
late, from a worker believed dead, is told apart from the row of its successor: no process numbers
and no clocks of workers are compared.
"""

from __future__ import annotations

import hashlib
import socket
import uuid
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from mbtl.errors import StudyError, few

if TYPE_CHECKING:
    from mbtl.study.storage import EventLog

_ASKER = "asker-"
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


@dataclass(frozen=True)
class Beat:
    """The last sign of life of a lease.

    Attributes:
        expires: seconds since the epoch, by the clock of the database.
        steps: environment steps done; None: not said.
        value: a return on the way; None: not said.
    """

    expires: float
    steps: float | None = None
    value: float | None = None


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
        beat = self._beats.get(lease.token)
        return beat is None or self._now > beat.expires

    def beat(self, token: str) -> Beat | None:
        """The last heartbeat of a lease; None: it gave none."""
        return self._beats.get(token)

    def askers(self) -> set[str]:
        """Tokens of the workers that wait for a pick (`asker`)."""
        return {
            token
            for token, beat in self._beats.items()
            if token.startswith(_ASKER) and beat.expires > self._now
        }

    @cached_property
    def _beats(self) -> Mapping[str, Beat]:
        return self._log.beats()

    @cached_property
    def _now(self) -> float:
        return self._log.now()


def check_holds(worker: str, leases: Iterable[Lease]) -> None:
    """Refuse a name under which nothing is held.

    Raises:
        StudyError: so it is; the message says who holds something.
    """
    held = sorted({lease.worker for lease in leases})
    if worker not in held:
        who = f"these do: {few(held, 10)}" if held else "nobody does"
        raise StudyError(f"a worker gives back what it holds, and {worker!r} holds nothing; {who}")


def new_token() -> str:
    """Never given out before."""
    return uuid.uuid4().hex[:12]


def asker(worker: str) -> str:
    """In place of the token of a lease, for heartbeats while a worker waits for one."""
    return _ASKER + hashlib.sha256(worker.encode()).hexdigest()[:12]


def new_worker() -> str:
    """A name that is nobody else's, with the host for people."""
    return f"{socket.gethostname()}-{uuid.uuid4().hex[:6]}"
