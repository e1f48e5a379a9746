"""Time limits of work in this process, whatever the work is at.

A thread cannot be ended, but an exception can be raised in it: at once in Python code; in a wait
(`time.sleep`, a lock, a child's answer) at once in the main thread, by a signal, and elsewhere when
the wait is over; in native code when that returns. What never returns ends only with its process:
worker processes are killed, and of this one the caller of `at_most` is told.
"""

from __future__ import annotations

import ctypes
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from mbtl.faults import TookTooLong

GRACE = 5.0
"""Seconds in which interrupted work may clean up; then it is interrupted again."""
_ALARM = getattr(signal, "SIGALRM", None)  # not on Windows


@contextmanager
def at_most(seconds: float | None, on_stuck: Callable[[], None] | None = None) -> Iterator[None]:
    """End the block when it takes longer.

    Args:
        seconds: limit; None: there is none.
        on_stuck: called once, from another thread, where the block is in native code that does not
            return.

    Raises:
        TookTooLong: it took longer.
    """
    if seconds is None:
        yield
        return
    limit = _Limit(on_stuck)
    with _alarm(limit):
        try:
            try:
                threading.Thread(target=limit.watch, args=(seconds,), daemon=True).start()
                yield
            finally:
                limit.end()
        except _Ended:  # perhaps raised before `end` had begun
            limit.end()
            raise too_long(seconds) from None


def too_long(seconds: float) -> TookTooLong:
    """What is said of work that was ended."""
    return TookTooLong(f"it took longer than {seconds:g} s")


class _Ended(BaseException):
    """Ends the block; code that catches `Exception` lets it pass."""


class _Limit:
    """Interrupts the thread that made it, and again as long as it does not end."""

    def __init__(self, on_stuck: Callable[[], None] | None) -> None:
        self._thread, self._on_stuck = threading.get_ident(), on_stuck
        self._over, self._lock = threading.Event(), threading.Lock()
        self._rings = False
        self.before: Any = None

    def watch(self, seconds: float) -> None:
        """In a thread of its own."""
        wait = seconds
        while not self._over.wait(wait):
            if self._rings and self._on_stuck is not None:  # not even heard in all that time
                self._on_stuck()
                self._on_stuck = None
            with self._lock:
                if not self._over.is_set():
                    self._interrupt()
            wait = GRACE

    def end(self) -> None:
        """Nothing is raised from now on, nor what is on its way."""
        self._over.set()
        with self._lock:
            self._rings = False
            _raise_in(self._thread, None)

    def heard(self, number: int, frame: Any) -> None:
        """The signal, in the main thread; perhaps it was meant for the handler before ours."""
        if self._rings:
            self._rings = False
            raise _Ended
        if callable(self.before):
            self.before(number, frame)

    def _interrupt(self) -> None:
        # code of others may have put another handler in place of ours: the usual one would kill us
        if _ALARM is not None and signal.getsignal(_ALARM) == self.heard:
            self._rings = True
            signal.pthread_kill(self._thread, _ALARM)
        else:
            _raise_in(self._thread, _Ended)


@contextmanager
def _alarm(limit: _Limit) -> Iterator[None]:
    """In the block the alarm rings for this limit; the main thread alone hears signals."""
    if _ALARM is None or threading.current_thread() is not threading.main_thread():
        yield
        return
    limit.before = signal.signal(_ALARM, limit.heard)
    try:
        yield
    finally:
        if signal.getsignal(_ALARM) == limit.heard:
            signal.signal(_ALARM, signal.SIG_DFL if limit.before is None else limit.before)


def _raise_in(thread: int, kind: type[BaseException] | None) -> None:
    """Before the next instruction of Python code there; None takes back what waits for that."""
    error = None if kind is None else ctypes.py_object(kind)
    ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(thread), error)
