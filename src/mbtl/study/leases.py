"""Leases: who may answer a pick, and until when by the clock of the database.

A token is new with every lease. Whoever takes a pick over gets another one, so a row that comes
late, from a worker believed dead, is told apart from the row of its successor: no process numbers
and no clocks of workers are compared.
"""

from __future__ import annotations

import socket
import uuid
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

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
    """

    def __init__(self, log: EventLog) -> None:
        self._log = log

    def is_stale(self, lease: Lease | None) -> bool:
        """True when anybody may take over."""
        if lease is None:
            return True
        if lease.seconds is None:
            return False
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
