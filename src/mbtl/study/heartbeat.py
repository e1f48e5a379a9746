"""The keeper: says from time to time that a run lives, and hears which of its picks it has lost."""

from __future__ import annotations

import threading
from logging import getLogger

from mbtl.errors import MbtlError
from mbtl.study.ask_tell import AskTell
from mbtl.study.records import Pick

_logger = getLogger(__name__)

ANSWERS = ("claimed", "released", "told", "failed")
"""Kinds of events after which a pick is somebody else's, or answered."""


class Keeper:
    """Keeps the leases of one run; a context manager.

    Its thread follows the log by itself, so that nothing the study is at can hold it up.

    Args:
        study: whose work it is.
        seconds: that a lease lasts; three heartbeats fall into it.
    """

    def __init__(self, study: AskTell, seconds: float) -> None:
        self.seconds = seconds
        self._study = study
        self._log = study.log
        self._held: dict[int, Pick] = {}
        self._lost: set[str] = set()
        self._seq = 0
        self._ended = threading.Event()
        self._lock = threading.Lock()
        self._thread = threading.Thread(target=self._keep, name="mbtl-keeper", daemon=True)

    def __enter__(self) -> Keeper:
        self._seq = self._study.refresh().seq
        self._study.presence.enter(self._study.worker)
        if self._study.is_durable:  # in memory there is nobody to take anything over
            self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._ended.set()
        if self._thread.is_alive():
            self._thread.join()
        self._study.presence.leave(self._study.worker, self._study.leases)

    def hold(self, pick: Pick) -> None:
        """From now on this pick is worked on."""
        with self._lock:
            self._held[pick.number] = pick

    def drop(self, pick: Pick) -> None:
        """It is answered, or given back."""
        with self._lock:
            self._held.pop(pick.number, None)

    def held(self) -> list[Pick]:
        """All that are worked on, or wait here."""
        with self._lock:
            return [*self._held.values()]

    def is_lost(self, pick: Pick) -> bool:
        """True when somebody took it over or away: its training is for nothing."""
        return pick.token in self._lost

    # ---- inside, in the thread ---------------------------------------------------------------

    def _keep(self) -> None:
        while not self._ended.wait(self.seconds / 3.0):
            try:
                self.look()
            except MbtlError as error:  # the next one may go through; the lease outlives two
                _logger.warning("a heartbeat failed: %s", error)

    def look(self) -> None:
        """One round: hear what was lost, and say that the rest is alive."""
        for event in self._log.read(self._seq):
            self._seq = event.seq
            if event.kind not in ANSWERS:
                continue
            with self._lock:
                held = self._held.get(event.data["pick"])
            if held is not None and event.data.get("token") != held.token:
                self._lost.add(held.token)
        for pick in self.held():
            if pick.token not in self._lost:
                self._log.beat(pick.token, self.seconds)
