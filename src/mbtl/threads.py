"""One thread for small linear algebra.

A pick multiplies many small matrices. Spread over threads that takes several times the processor
time, because threads wait for each other by spinning: `auto` on a shipped matrix took 17 s of two
cores, and 3.6 s of one (`mbtl bench --matrix pendulum-length --selectors auto`, with and without
`OMP_NUM_THREADS=1`).
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from threadpoolctl import ThreadpoolController

MANY = 10_000  # contexts from which threads earn their keep


@contextmanager
def threads_for(n: int) -> Iterator[None]:
    """Within it, linear algebra over n contexts has as many threads as pay: one, when they are few.

    It counts for the whole process, not for the thread that asks: until the last one is out.
    """
    if n > MANY:
        yield
        return
    _SINGLE.enter()
    try:
        yield
    finally:
        _SINGLE.leave()


class _Single:
    """One thread of linear algebra, for as long as anybody wants that."""

    def __init__(self) -> None:
        self._lock, self._inside = threading.Lock(), 0
        self._limit: Any = None

    def enter(self) -> None:
        with self._lock:
            if not self._inside:
                self._limit = _controller().limit(limits=1, user_api="blas")
            self._inside += 1

    def leave(self) -> None:
        with self._lock:
            self._inside -= 1
            if not self._inside:
                self._limit.restore_original_limits()


_SINGLE = _Single()


@cache
def _controller() -> ThreadpoolController:
    import scipy.linalg  # noqa: F401  its libraries are to be among those found
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()
