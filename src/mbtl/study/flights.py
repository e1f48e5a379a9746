"""Trainings under way in an executor: begun, brought back, begun again, given up."""

from __future__ import annotations

import time
from collections.abc import Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Executor, Future
from concurrent.futures import wait as wait_for
from dataclasses import dataclass
from typing import Any

from mbtl.errors import StudyError
from mbtl.processes import SeparateWorkers
from mbtl.study.job import (
    NOT_THE_TRAININGS_FAULT,
    Job,
    Outcome,
    Trouble,
    perform_elsewhere,
    reason_of,
)
from mbtl.study.pick import Pick

_DIED = (
    "a worker process died (a script without `if __name__ == '__main__':`, killed, or out of "
    "memory); its picks are given back: run again, with a smaller parallel if memory is short"
)


@dataclass
class _Flight:
    """One training.

    Attributes:
        pick: what it answers.
        job: as it was sent, to send it again.
        began: on this process's clock.
        tries: how often it was begun.
    """

    pick: Pick
    job: Job
    began: float
    tries: int = 1


class Flights:
    """Trainings that an executor is at.

    Args:
        executor: does them.
        timeout: seconds for each, from when it is handed over; None: no limit.
        retries: so often one that failed is begun again. A worker that dies costs one more try at
            least, since that may be nobody's fault.
    """

    def __init__(self, executor: Executor, timeout: float | None, retries: int) -> None:
        self._executor = executor
        self._timeout = timeout
        self._retries = retries
        self._flights: dict[Future[Any], _Flight] = {}

    def __len__(self) -> int:
        return len(self._flights)

    def begin(self, pick: Pick, job: Job) -> None:
        """Hand one over."""
        self._send(_Flight(pick, job, time.monotonic()))

    def landed(self) -> Iterator[tuple[Pick, Outcome | Trouble]]:
        """Wait for one or more, and say what they gave; those begun again say nothing so far.

        Raises:
            StudyError: the executor is broken, or what a training gave cannot travel.
        """
        done, _ = wait_for(self._flights, self._patience(), return_when=FIRST_COMPLETED)
        for future in [one for one in self._flights if one in done]:  # in the order they were begun
            flight = self._flights.pop(future)
            outcome, least = self._brought(future)
            if may_try_again(outcome) and flight.tries <= max(self._retries, least):
                flight.tries, flight.began = flight.tries + 1, time.monotonic()
                self._send(flight)
                continue
            yield flight.pick, outcome
        for future, flight in list(self._flights.items()):
            if self._timeout is not None and time.monotonic() - flight.began > self._timeout:
                del self._flights[future]
                if isinstance(self._executor, SeparateWorkers):
                    self._executor.kill(future)
                future.cancel()
                yield flight.pick, too_long(self._timeout)

    def cancel(self) -> None:
        """Nobody waits for them any more; those that have not begun will not."""
        for future in self._flights:
            future.cancel()

    def _send(self, flight: _Flight) -> None:
        try:
            self._flights[self._executor.submit(perform_elsewhere, flight.job)] = flight
        except BrokenExecutor as error:
            raise StudyError(_DIED) from error

    def _patience(self) -> float | None:
        if self._timeout is None:
            return None
        first = min(flight.began for flight in self._flights.values())
        return max(0.0, first + self._timeout - time.monotonic()) + 0.01

    def _brought(self, future: Future[Any]) -> tuple[Outcome | Trouble, int]:
        """What it gave, and how many retries that allows at least."""
        try:
            outcome: Outcome | Trouble = brought_back(future)
        except CancelledError:
            return Trouble("training", "it was cancelled", ""), 0
        except StudyError as error:
            if not (
                _worker_died(error.__cause__)
                and (isinstance(self._executor, SeparateWorkers) or _of_dask(error.__cause__))
            ):
                raise
            return Trouble("training", "its worker process died", str(error.__cause__)), 1
        return outcome, 0


def may_try_again(outcome: Outcome | Trouble) -> bool:
    """True for a training that gave no policy, for a cause that may be gone the next time."""
    return (
        isinstance(outcome, Trouble)
        and outcome.kept is None
        and not isinstance(outcome.error, NOT_THE_TRAININGS_FAULT)
        and not outcome.pruned
        and outcome.reason != "it was cancelled"
    )


def too_long(timeout: float | None) -> Trouble:
    """What a training that was ended gave."""
    return Trouble("training", f"it took longer than {timeout:g} s", "")


def brought_back(future: Future[Any]) -> Any:
    """What a worker process gave.

    Raises:
        StudyError: the process died, or what it gave cannot travel.
    """
    try:
        return future.result()
    except CancelledError:
        raise
    except Exception as error:
        if _worker_died(error):
            raise StudyError(_DIED) from error
        raise StudyError(
            f"a policy trained in another process must be sent back or saved there, got "
            f"{reason_of(error)}; give save and load functions, or use parallel=1"
        ) from error


def _worker_died(error: BaseException | None) -> bool:
    return isinstance(error, BrokenExecutor) or _of_dask(error)


def _of_dask(error: BaseException | None) -> bool:
    """Dask's own errors, such as KilledWorker, without importing it."""
    return type(error).__module__.partition(".")[0] == "distributed"
