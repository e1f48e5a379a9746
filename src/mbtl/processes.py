"""Processes and threads: as many as pay, and none that nobody wants any more.

Workers end at an interrupt, or with their master.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor
from functools import cache
from multiprocessing import current_process, parent_process
from multiprocessing.context import SpawnContext, SpawnProcess
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

from threadpoolctl import ThreadpoolController

from mbtl.errors import InvalidInput

GRACE = 5.0
"""Seconds in which a worker that is to end may close its simulators; then it is killed."""

_MOMENT = 2.0
"""Seconds in which a simulator that is told to end may do so; then it is killed."""

_KILL = getattr(signal, "SIGKILL", signal.SIGTERM)  # not on Windows


def usable_cores() -> int:
    """Cores that this process may use; all there are where the system does not say."""
    if hasattr(os, "sched_getaffinity"):  # not on macOS and Windows
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def native_threads() -> int:
    """Threads that a native simulator of this process may use: all cores, but one in a worker.

    A number in the environment variable `NPROC` comes first, as it does in jax.
    """
    given = os.environ.get("NPROC", "")
    if given.isdecimal() and int(given) > 0:
        return int(given)
    return usable_cores() if parent_process() is None else 1


@contextlib.contextmanager
def separate_workers(workers: int) -> Iterator[SeparateWorkers]:
    """Fresh processes for the block that do not share their fate: one that dies is replaced.

    An interrupt, and the end of a generator that holds the block, ends them with all they have
    started; any other end waits for the work under way.
    """
    separate = SeparateWorkers(workers)
    try:
        yield separate
    except (KeyboardInterrupt, GeneratorExit):
        separate.shutdown(wait=False, cancel_futures=True)
        separate.end()
        raise
    finally:
        separate.shutdown()


class SeparateWorkers(Executor):
    """So many fresh processes, each a pool of its own.

    Args:
        workers: processes; as many jobs run at a time, and no more are to be submitted.
    """

    def __init__(self, workers: int) -> None:
        self._context = _Context()
        self._pools: list[ProcessPoolExecutor | None] = [None] * workers
        self._jobs: list[Future[Any] | None] = [None] * workers

    def begin(self) -> None:
        """Start all processes; whoever finds out with the first jobs has them to do again.

        Raises:
            InvalidInput: one ended at once.
        """
        try:
            for job in [self.submit(os.getpid) for _ in self._pools]:
                job.result()
        except BrokenExecutor as error:
            raise InvalidInput(
                "a worker process ended as it began; a script that starts them must be guarded by "
                "if __name__ == '__main__', and what else went wrong is printed above"
            ) from error

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Give a job to an idle worker; to the first one where none is."""
        idle = [i for i, job in enumerate(self._jobs) if job is None or job.done()]
        slot = idle[0] if idle else 0
        for _ in range(2):
            pool = self._pools[slot]
            if pool is None:
                pool = ProcessPoolExecutor(1, self._context, initializer=_obey)
                self._pools[slot] = pool
            try:
                job = pool.submit(fn, *args, **kwargs)
            except BrokenExecutor:  # its process died
                self._pools[slot] = None
                continue
            self._jobs[slot] = job
            return job
        raise BrokenExecutor("a worker process ends as soon as it is started")

    def kill(self, job: Future[Any]) -> None:
        """End the process that does a job, and what it has started."""
        slot = next(i for i, one in enumerate(self._jobs) if one is job)
        pool, self._pools[slot], self._jobs[slot] = self._pools[slot], None, None
        if pool is not None:
            for process in list((pool._processes or {}).values()):
                _tell_group(process, _KILL)
            pool.shutdown(wait=False)

    def end(self) -> None:
        """End all processes, whatever they are at."""
        _end(self._context.made)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """As of any executor."""
        for pool in self._pools:
            if pool is not None:
                pool.shutdown(wait=wait, cancel_futures=cancel_futures)


class _Context(SpawnContext):
    """Remembers the processes it made."""

    def __init__(self) -> None:
        super().__init__()
        self.made: list[SpawnProcess] = []

    def Process(self, *args: Any, **kwargs: Any) -> SpawnProcess:  # type: ignore[override]
        self.made.append(SpawnProcess(*args, **kwargs))
        return self.made[-1]


def _end(workers: Sequence[SpawnProcess]) -> None:
    for worker in workers:
        worker.terminate()
    latest = time.monotonic() + GRACE
    for worker in workers:
        worker.join(max(0.0, latest - time.monotonic()))
    for worker in workers:
        _tell_group(worker, _KILL)


def _obey() -> None:
    """In a worker, first of all.

    It leaves its master's process group, to which a terminal sends Ctrl-C, for one of its own, in
    which are the simulators that it starts.
    """
    if hasattr(os, "setpgid"):
        os.setpgid(0, 0)
    signal.signal(signal.SIGTERM, _leave)
    threading.Thread(target=_end_with_master, daemon=True).start()


def _leave(*_: object) -> None:
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # once is enough
    sys.stderr = open(os.devnull, "w")  # noqa: SIM115  closed pipes and the like concern nobody now
    raise KeyboardInterrupt  # not SystemExit, which is a fault of the code that it ends


def _end_with_master() -> None:
    master, worker = parent_process(), current_process()
    assert master is not None
    master.join()
    _tell_group(worker, signal.SIGTERM)
    time.sleep(GRACE)
    _tell_group(worker, _KILL)


def _tell_group(worker: BaseProcess, number: int) -> None:
    """A worker, and what it has started and not ended."""
    if worker.pid is None:
        return
    with contextlib.suppress(ProcessLookupError):
        (os.killpg if hasattr(os, "killpg") else os.kill)(worker.pid, number)


def end_children() -> None:
    """End the processes that this one, or a library in it, has started and left behind.

    A simulator that is interrupted before it is connected to waits for ever.
    """
    left = _children()
    for child in left:
        _tell(child, signal.SIGTERM)
    latest = time.monotonic() + _MOMENT
    while (left := [child for child in left if child in _children()]) and time.monotonic() < latest:
        time.sleep(_MOMENT / 40)
    for child in left:
        _tell(child, _KILL)


def _children() -> list[int]:
    """Processes of this one that run, without those that tidy up by themselves."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):  # none where the system has no such folder
        with contextlib.suppress(OSError, ValueError, IndexError):
            state, parent = (folder / "stat").read_text().rpartition(")")[2].split()[:2]
            command = (folder / "cmdline").read_bytes()
            if int(parent) == os.getpid() and state != "Z" and b"resource_tracker" not in command:
                found.append(int(folder.name))
    return found


def _tell(process: int, number: int) -> None:
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.kill(process, number)


# ---- threads of linear algebra -------------------------------------------------------------------


MANY = 10_000  # contexts from which threads earn their keep


def threads_for(n: int) -> contextlib.AbstractContextManager[None]:
    """Within it, linear algebra over n contexts has as many threads as pay: one, when they are few.

    A pick multiplies many small matrices. Spread over threads that takes several times the
    processor time, because threads wait for each other by spinning. It counts for the whole
    process, not for the thread that asks: until the last one is out.
    """
    return contextlib.nullcontext() if n > MANY else _SINGLE


class _Single:
    """One thread of linear algebra, for as long as anybody wants that."""

    def __init__(self) -> None:
        self._lock, self._inside = threading.Lock(), 0
        self._limit: Any = None

    def __enter__(self) -> None:
        with self._lock:
            if not self._inside:
                self._limit = _controller().limit(limits=1, user_api="blas")
            self._inside += 1

    def __exit__(self, *error: object) -> None:
        with self._lock:
            self._inside -= 1
            if not self._inside:
                self._limit.restore_original_limits()


_SINGLE = _Single()


@cache
def _controller() -> ThreadpoolController:
    import scipy.linalg  # noqa: F401  its libraries are to be among those found

    return ThreadpoolController()
