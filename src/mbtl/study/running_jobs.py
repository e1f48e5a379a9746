"""Trainings under way in an executor: begun, brought back, begun again, given up."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Executor, Future
from concurrent.futures import wait as wait_for
from dataclasses import dataclass
from typing import Any

from mbtl.errors import StudyError
from mbtl.faults import FAULTS, reason_of
from mbtl.processes import SeparateWorkers
from mbtl.study.job import (
    NOT_THE_TRAININGS_FAULT,
    Job,
    Outcome,
    Trouble,
    perform_elsewhere,
)
from mbtl.study.pick import Pick
from mbtl.study.time_limits import too_long

_DIED = (
    "a worker process died (a script without `if __name__ == '__main__':`, killed, or out of "
    "memory); its picks are given back: run again, with a smaller parallel if memory is short"
)


_LATE = 30.0
"""Seconds after its time limit when a job is given up that has not ended itself: it is in native
code that does not return, or its process took long to begin."""


@dataclass
class _Flight:
    """One training.

    Attributes:
        pick: what it answers.
        job: as it was sent, to send it again.
        began: on this process's clock.
        tries: how often it was begun.
        died: whether its worker has died; once that is nobody's fault.
    """

    pick: Pick
    job: Job
    began: float
    tries: int = 1
    died: bool = False


class Flights:
    """Trainings that an executor is at.

    Args:
        executor: does them.
        timeout: seconds for each, from when it is handed over; None: no limit.
        retries: so often one that failed is begun again. One whose worker dies is begun again as
            it was, once, since that may be nobody's fault.
        again: gives the pick and the job of another try; None: they are somebody else's by now.
    """

    def __init__(
        self,
        executor: Executor,
        timeout: float | None,
        retries: int,
        again: Callable[[Pick, Trouble], tuple[Pick, Job] | None],
    ) -> None:
        self._executor, self._again = executor, again
        self._timeout = timeout
        self._retries = retries
        self._flights: dict[Future[Any], _Flight] = {}

    def __len__(self) -> int:
        return len(self._flights)

    def begin(self, pick: Pick, job: Job) -> None:
        """Hand one over."""
        self._send(_Flight(pick, job, time.monotonic()))

    def landed(self) -> Iterator[tuple[Pick, Outcome | Trouble | None]]:
        """Wait for one or more, and say what they gave; those begun again say nothing so far.

        None: it is somebody else's by now.

        Raises:
            StudyError: the executor is broken, or what a training gave cannot travel.
        """
        done, _ = wait_for(self._flights, self._patience(), return_when=FIRST_COMPLETED)
        for future in [one for one in self._flights if one in done]:  # in the order they were begun
            flight = self._flights.pop(future)
            outcome, died = self._brought(future)
            flight.began = time.monotonic()
            if died and not flight.died:
                flight.died = True
                self._send(flight)
                continue
            if may_try_again(outcome) and flight.tries <= self._retries:
                assert isinstance(outcome, Trouble)
                found = self._again(flight.pick, outcome)
                if found is None:
                    yield flight.pick, None
                    continue
                flight.pick, flight.job = found
                flight.tries += 1
                self._send(flight)
                continue
            yield flight.pick, outcome
        for future, flight in list(self._flights.items()):
            late = time.monotonic() - flight.began - _LATE
            if self._timeout is not None and late > self._timeout:
                del self._flights[future]
                if isinstance(self._executor, SeparateWorkers):
                    self._executor.kill(future)
                future.cancel()
                error = too_long(self._timeout)
                yield flight.pick, Trouble("training", str(error), "", error)

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
        return max(0.0, first + self._timeout + _LATE - time.monotonic()) + 0.01

    def _brought(self, future: Future[Any]) -> tuple[Outcome | Trouble, bool]:
        """What it gave, and whether its worker has died."""
        try:
            outcome: Outcome | Trouble = brought_back(future)
        except CancelledError:
            return Trouble("training", "it was cancelled", ""), False
        except StudyError as error:
            if not (
                _worker_died(error.__cause__)
                and (isinstance(self._executor, SeparateWorkers) or _of_dask(error.__cause__))
            ):
                raise
            return Trouble("training", "its worker process died", str(error.__cause__)), True
        return outcome, False


def may_try_again(outcome: Outcome | Trouble) -> bool:
    """True for a training that gave no policy, for a cause that may be gone the next time."""
    return (
        isinstance(outcome, Trouble)
        and outcome.kept is None
        and not isinstance(outcome.error, NOT_THE_TRAININGS_FAULT)
        and not outcome.pruned
        and outcome.reason != "it was cancelled"
    )


def brought_back(future: Future[Any]) -> Any:
    """What a worker process gave.

    Raises:
        StudyError: the process died, or what it gave cannot travel.
    """
    try:
        return future.result()
    except CancelledError:
        raise
    except FAULTS as error:
        if _worker_died(error):
            raise StudyError(_DIED) from error
        raise StudyError(
            f"a policy trained in another process must be sent back or saved there, got "
            f"{reason_of(error)}; give save and load functions, or use Workers(1)"
        ) from error


def _worker_died(error: BaseException | None) -> bool:
    return isinstance(error, BrokenExecutor) or _of_dask(error)


def _of_dask(error: BaseException | None) -> bool:
    """Dask's own errors, such as KilledWorker, without importing it."""
    return type(error).__module__.partition(".")[0] == "distributed"
