"""Presence: on one machine, that a worker is gone is known at once, and not when its lease ends.

A run holds a lock on a file beside the study's database; the system lets go of it however the run
ends. A file without a lock: surely gone. No file: nothing is known. So whoever ends and leaves work
behind leaves the file, too, for all who look, and only who takes the last of that work over removes
it. Where the database is a server there is no such file, and leases end by the clock alone.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterable
from pathlib import Path

from filelock import FileLock, Timeout

from mbtl.study.leases import Lease


class Presence:
    """Locks of the workers of one study, held and looked at.

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

    def is_known(self, worker: str) -> bool:
        """True where its end would be known at once."""
        place = self._place(worker)
        return place is not None and place.is_file()

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
