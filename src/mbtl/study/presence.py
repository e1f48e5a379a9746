"""Presence: on one machine, that a worker is gone is known at once, and not when its lease ends.

A run holds a lock on a file beside the study's database; the system lets go of it however the run
ends. Where the database is a server there is no such file, and leases end by the clock alone.
"""

from __future__ import annotations

import contextlib
from pathlib import Path

from filelock import FileLock, Timeout


class Presence:
    """Locks of the workers of one study, held and looked at.

    Args:
        database: file of the study; None: it has none, and nobody is ever surely gone.
    """

    def __init__(self, database: Path | None) -> None:
        self._database = database
        self._held: dict[str, FileLock] = {}
        self._gone: set[str] = set()

    def enter(self, worker: str) -> None:
        """From now on `worker` is here; where locks cannot be had nothing is said."""
        place = self._place(worker)
        if place is None or worker in self._held:
            return
        with contextlib.suppress(OSError, Timeout, NotImplementedError):
            lock = FileLock(place, blocking=False)
            lock.acquire()
            self._held[worker] = lock

    def leave(self, worker: str) -> None:
        """It works on nothing any more."""
        lock, place = self._held.pop(worker, None), self._place(worker)
        if lock is not None and place is not None:
            with contextlib.suppress(OSError):
                place.unlink(missing_ok=True)
            lock.release()

    def is_gone(self, worker: str) -> bool:
        """True when it was here, and surely is not any more."""
        place = self._place(worker)
        if worker in self._gone:
            return True
        if place is None or worker in self._held or not place.is_file():
            return False
        try:
            with FileLock(place, blocking=False):
                place.unlink(missing_ok=True)
        except (OSError, Timeout, NotImplementedError):
            return False
        self._gone.add(worker)
        return True

    def _place(self, worker: str) -> Path | None:
        """The name comes from a log, which may be a stranger's."""
        if self._database is None or not worker.replace("-", "").replace(".", "").isalnum():
            return None
        return self._database.with_name(f".{self._database.name}.{worker}.lock")
