"""Worker processes: an interrupt ends them, instead of waiting for work that nobody wants now."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import active_children, get_context


@contextmanager
def worker_pool(workers: int) -> Iterator[ProcessPoolExecutor]:
    """A pool of fresh processes for the block; whatever ends it but an interrupt waits for them."""
    others = active_children()
    context = get_context("spawn")
    with ProcessPoolExecutor(workers, context, initializer=_obey) as pool:
        try:
            yield pool
        except (KeyboardInterrupt, GeneratorExit):  # the latter: of a caller's loop over results
            for child in active_children():
                if child not in others:
                    child.terminate()
            raise


def _obey() -> None:
    """In a worker: Ctrl-C, which a terminal sends to all, is its master's; its end is its own."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, _end)


def _end(*_: object) -> None:
    """Quietly, with the simulators that this process has started."""
    for child in active_children():
        child.terminate()
    os._exit(1)
