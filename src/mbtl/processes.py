"""Worker processes: an interrupt ends them, instead of waiting for work that nobody wants now."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import active_children, get_context


@contextmanager
def worker_pool(workers: int) -> Iterator[ProcessPoolExecutor]:
    """A pool of fresh processes for the block; whatever ends it but an interrupt waits for them."""
    others = active_children()
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        try:
            yield pool
        except (KeyboardInterrupt, GeneratorExit):  # the latter: of a caller's loop over results
            for child in active_children():
                if child not in others:
                    child.terminate()
            raise
