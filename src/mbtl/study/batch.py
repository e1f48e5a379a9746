"""The trainings of a run: begun, brought back, told, begun again; and when failures end the run.

A failed training is recorded and spends budget. A failed evaluation does not: its pick stays open
and its policy is kept, in its folder or in memory, to be evaluated again.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Executor, Future
from concurrent.futures import wait as wait_for
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from mbtl.errors import StorageError, StudyError, TrainingFailed, TrainingPruned
from mbtl.faults import FAULTS, reason_of
from mbtl.processes import SeparateWorkers
from mbtl.study.artifacts import Artifact, spools_of
from mbtl.study.ask_tell import AskTell
from mbtl.study.heartbeat import Keeper
from mbtl.study.job import (
    ALONE,
    NOT_THE_TRAININGS_FAULT,
    Job,
    Kept,
    Outcome,
    Trouble,
    perform,
    perform_elsewhere,
)
from mbtl.study.records import Pick
from mbtl.study.time_limits import too_long
from mbtl.trainers.contract import Progress, Trainer

_DIED = (
    "a worker process died (a script without `if __name__ == '__main__':`, killed, or out of "
    "memory); its picks are given back: run again, with a smaller parallel if memory is short"
)


_LATE = 30.0
"""Seconds after its time limit when a job is given up that has not ended itself: it is in native
code that does not return, or its process took long to begin."""


_DEAD, _CANCELLED = "its worker process died", "it was cancelled"
"""Reasons of trainings of which nothing came back."""


@dataclass
class Batches:
    """Does the picks of one run.

    A training that failed is handed out once more as often as the run says, each time with another
    seed; one whose worker dies once, as it was, since that may be nobody's fault.

    Attributes:
        study: is told.
        trainer: does the work.
        executor: where; None: in this thread, each as it is begun.
        failures_allowed: failures in a row that are borne; one more ends the run.
        rehearse: the first policy is read back and evaluated on two targets before all else.
        announce: calls a method of all callbacks, by its name, with what it takes.
        keeper: keeps the leases of the picks.
        timeout: seconds that a training and its evaluation may take; None: as many as they want.
        retries: so often a training that failed is begun again before it counts as failed.
        held: picks whose policy could not be evaluated. They stay with this process meanwhile, so
            that nobody tries again at once.
    """

    study: AskTell
    trainer: Trainer
    executor: Executor | None
    failures_allowed: int
    rehearse: bool
    announce: Callable[..., None]
    keeper: Keeper
    timeout: float | None = None
    retries: int = 0
    held: list[Pick] = field(default_factory=list)
    _under_way: dict[Future[Any], tuple[Pick, float]] = field(default_factory=dict)
    _died: set[int] = field(default_factory=set)
    _in_a_row: int = 0
    _given_up: set[int] = field(default_factory=set)
    _ending: BaseException | None = None
    _failed: tuple[Pick, Trouble] | None = None
    _said: set[str] = field(default_factory=set)

    def do(self, size: int, ask: Callable[[], Pick | None]) -> None:
        """Train `size` picks at a time until none is left; on any interrupt give them back.

        Each is told, and the next one asked for, when it is done.

        Args:
            size: trainings at a time.
            ask: gives the next pick, which the keeper holds; None: there is none.

        Raises:
            TrainingFailed: failures end the run. What was under way is told.
        """
        self._failed = self._ending = None
        try:
            for pick, outcome in self._outcomes(size, ask):
                trouble = outcome if isinstance(outcome, Trouble) else None
                if trouble is not None and isinstance(trouble.error, NOT_THE_TRAININGS_FAULT):
                    self._keep(pick, trouble.kept)
                    self._ending = self._ending or trouble.error
                    continue
                again = trouble is not None and self._may_try_again(pick, trouble)
                in_time = outcome is not None and self._record(pick, outcome, again=again)
                if not in_time:
                    self._lose(pick)
                elif trouble is None:
                    self._announce("on_told", pick)
                elif trouble.pruned and trouble.kept is None:
                    self._announce("on_pruned", pick, trouble.reason)
                elif again:
                    words = f"{self.study.state.where(pick)} failed, and is begun again"
                    self._announce("on_note", f"{words}: {_reason(trouble)}")
                else:
                    self._announce("on_failed", pick, _reason(trouble))
                    self._failed = pick, trouble
                    if self._in_a_row > self.failures_allowed:
                        failures = "failure" if self._in_a_row == 1 else "failures"
                        row = f"{self._in_a_row} {failures} in a row"
                        self._ending = self._ending or self._end(pick, trouble, row)
        except _CallbackError as wrapped:
            raise wrapped.error from None
        finally:
            for future in self._under_way:  # those that have not begun will not
                future.cancel()
            self._under_way.clear()
            self._give_back([pick for pick in self.keeper.held() if pick not in self.held])
        if self._ending is None and self._failed is not None and self._in_doubt:
            self._ending = self._end(*self._failed, "nothing has succeeded yet")
        if self._ending is not None:
            raise self._ending

    def give_back_held(self) -> bool:
        """Let go of the picks whose policies could not be evaluated; False when there are none."""
        picks, self.held = self.held, []
        self._give_back(picks)
        return bool(picks)

    # ---- trainings under way -----------------------------------------------------------------

    def _outcomes(
        self, size: int, ask: Callable[[], Pick | None]
    ) -> Iterator[tuple[Pick, Outcome | Trouble | None]]:
        """What each pick gave, see `do`; None where it is somebody else's by now.

        While nothing has succeeded and something failed, nothing new is begun.
        """
        while True:
            while len(self._under_way) < size and not self._ending and not self._in_doubt:
                pick = ask()
                if pick is None:
                    break
                self._announce_pick(pick)
                future = self._begun(pick, self._job(pick))
                self._under_way[future] = pick, time.monotonic()
            if not self._under_way:
                return
            yield from self._landed()

    @property
    def _in_doubt(self) -> bool:
        """Nothing has succeeded, and something failed, though not only what not all can do."""
        if self._failed is None or self.study.has_succeeded:
            return False
        state = self.study.state
        failures = [one for one in state.failures if not one.pruned]
        alone = any(len(state.picks[one.pick].sources) == 1 for one in failures)
        return alone or bool(state.deferred)

    def _begun(self, pick: Pick, job: Job) -> Future[Any]:
        """One that is handed over, or done in this thread."""
        if self.executor is None:
            future: Future[Any] = Future()
            future.set_result(self._perform_here(pick, job))
            return future
        try:
            return self.executor.submit(perform_elsewhere, job)
        except BrokenExecutor as error:
            raise StudyError(_DIED) from error

    def _landed(self) -> Iterator[tuple[Pick, Outcome | Trouble | None]]:
        """Wait for one or more, and say what they gave; None: it is somebody else's by now.

        Raises:
            StudyError: the executor is broken, or what a training gave cannot travel.
        """
        patience = None
        if self.timeout is not None:
            first = min(began for _, began in self._under_way.values())
            patience = max(0.0, first + self.timeout + _LATE - time.monotonic()) + 0.01
        done, _ = wait_for(self._under_way, patience, return_when=FIRST_COMPLETED)
        for future in [one for one in self._under_way if one in done]:  # in the order they began
            pick, _ = self._under_way.pop(future)
            yield pick, self._brought(future)
        for future, (pick, began) in list(self._under_way.items()):
            if self.timeout is not None and time.monotonic() - began - _LATE > self.timeout:
                del self._under_way[future]
                if isinstance(self.executor, SeparateWorkers):
                    self.executor.kill(future)
                future.cancel()
                error = too_long(self.timeout)
                yield pick, Trouble("training", str(error), "", error)

    def _brought(self, future: Future[Any]) -> Outcome | Trouble | None:
        """What it gave, also where its worker died or its user cancelled it."""
        try:
            outcome: Outcome | Trouble | None = brought_back(future)
        except CancelledError:
            return Trouble("training", _CANCELLED, "")
        except StudyError as error:
            cause = error.__cause__
            alone = isinstance(self.executor, SeparateWorkers) or _of_dask(cause)
            if not (alone and _worker_died(cause)):
                raise
            return Trouble("training", _DEAD, str(cause))
        return outcome

    def _may_try_again(self, pick: Pick, trouble: Trouble) -> bool:
        """True for a training that gave no policy, for a cause that may be gone the next time."""
        if trouble.kept is not None or trouble.pruned or trouble.reason == _CANCELLED:
            return False
        tries = self.study.state.picks[pick.number].retries
        return tries < self.retries or self._is_first_death(pick, trouble)

    def _is_first_death(self, pick: Pick, trouble: Trouble) -> bool:
        return trouble.reason == _DEAD and pick.number not in self._died

    # ---- one training ------------------------------------------------------------------------

    def _perform_here(self, pick: Pick, job: Job) -> Outcome | Trouble | None:
        """Do it in this thread; None: it is somebody else's by now, or was given up."""
        try:
            outcome = perform(
                job,
                partial(self._progressed, pick),
                partial(self._keep, pick),
                partial(self._announce, "on_evaluation", pick),
                partial(self._give_up, pick),
            )
        except _Stopped:
            return None
        except _Pruned as wrapped:
            return Trouble("training", str(wrapped.error), "", wrapped.error)
        return None if pick.number in self._given_up else outcome

    def _give_up(self, pick: Pick) -> None:
        """In another thread: this one is in native code, perhaps for ever, and will not answer."""
        self._given_up.add(pick.number)
        assert self.timeout is not None
        reason = f"{too_long(self.timeout)}, in native code that does not return"
        self.study.fail(pick, reason)
        self.keeper.drop(pick)
        self.announce("on_stuck", pick, reason)

    def _progressed(self, pick: Pick, progress: Progress) -> None:
        self._announce("on_progress", pick, progress)
        if self.keeper.is_lost(pick):
            raise _Stopped

    def _job(self, pick: Pick) -> Job:
        study = self.study
        targets = range(study.space.n) if pick.targets is None else pick.targets
        return Job(
            self.trainer,
            pick.contexts,
            pick.seed,
            [study.space.context(target) for target in targets],
            study.evaluation_seeds(pick.targets),
            study.artifacts,
            places_of(study, pick),
            study.untold.get(pick.number),
            self.rehearse and not study.has_succeeded,
            spools_of(study.database) if study.is_durable else (),
            self.timeout,
            self._begun_with(pick),
            pick.done,
            pick.length,
            study.spec.any_training and pick.trains,
            study.spec.steps is not None,
        )

    def _begun_with(self, pick: Pick) -> Kept | None:
        """The policy that a training begins with, with its state where it goes on or inherits."""
        if pick.start is None:
            return None
        place = self.study.state.place_of(pick.start)
        if place < 0:
            raise StudyError(
                f"pick {pick.number + 1} begins with a policy that was taken back; give the pick "
                "up (fail), and the strategy chooses another one"
            )
        row = self.study.state.rows[place]
        kept = Artifact(row.policy, row.sha256 or "") if row.policy else None
        state = None
        if row.state and (pick.done or (pick.trains and "inherit" in self.trainer.takes)):
            state = Artifact(row.state, row.state_sha256 or "")
        return Kept(self.study.policies.get(place), kept, row.steps, state)

    def _keep(self, pick: Pick, kept: Kept | None) -> None:
        """Hold on to a policy that is nowhere else."""
        if kept is not None and kept.artifact is None:
            self.study.untold[pick.number] = kept
        else:
            self.study.untold.pop(pick.number, None)

    def _record(self, pick: Pick, outcome: Outcome | Trouble, *, again: bool) -> bool:
        """Tell the study; False: too late.

        Args:
            pick: what was done.
            outcome: what it gave.
            again: it failed, and is handed out once more.
        """
        self._keep(pick, outcome.kept)
        if isinstance(outcome, Outcome):
            return self._tell(pick, outcome)
        if again and self._is_first_death(pick, outcome):
            self._died.add(pick.number)
            self._give_back([pick])
            return True
        reason, trace = _reason(outcome), outcome.traceback
        if outcome.kept is not None:
            if not self.study.defer(pick, reason, traceback=trace, steps=outcome.kept.steps):
                return False
            self.held.append(pick)
        else:
            pruned, steps = outcome.pruned, outcome.steps
            if not self.study.fail(
                pick, reason, traceback=trace, pruned=pruned, steps=steps, again=again
            ):
                return False
            self.keeper.drop(pick)
            if pruned:
                return True
        self._in_a_row += not again
        return True

    def _tell(self, pick: Pick, outcome: Outcome) -> bool:
        kept = outcome.kept
        in_time = self.study.tell(
            pick,
            outcome.returns,
            seconds=outcome.seconds,
            steps=kept.steps,
            policy=kept.artifact if pick.trains else None,
            policy_object=kept.policy if pick.trains else None,
            training_state=kept.state,
            evaluation_steps=outcome.evaluation_steps,
        )
        self.study.untold.pop(pick.number, None)
        self._in_a_row = 0
        if in_time:
            self.keeper.drop(pick)
        return in_time

    def _lose(self, pick: Pick) -> None:
        """Somebody else does it, or has done it."""
        self.study.untold.pop(pick.number, None)
        self.keeper.drop(pick)
        self._announce("on_lost", pick)

    def _end(self, pick: Pick, trouble: Trouble, why: str) -> TrainingFailed:
        again = "with Failures(retry_failed=True) (--retry-failed)"
        then = "run again: the policy is kept and only evaluated"
        then += f"; {again} it is trained again" if pick.trains else ""
        if trouble.kept is None:
            then = f"run again, {again} to train there again"
        elif trouble.kept.artifact is None:
            then = f"run again {ALONE}"
        elif trouble.stage == "loading":
            place = trouble.kept.artifact.place
            then = f"run again, or remove {place} to have the policy trained again"
        return failure(
            f"{self.study.state.where(pick)} failed: {_reason(trouble)}; the run ends here "
            f"({why}), so mend the cause and {then}",
            trouble,
        )

    def _give_back(self, picks: Sequence[Pick]) -> None:
        for pick in picks:
            self.keeper.drop(pick)
            try:
                self.study.release(pick)
            except StorageError:  # the storage is what failed; the pick is taken over later
                return
            except StudyError:  # somebody else answered it
                continue

    def _announce_pick(self, pick: Pick) -> None:
        self._announce("on_pick", pick)
        often = self.study.state.picks[pick.number].abandoned
        if often > 1 and self.executor is None:
            self._announce(
                "on_note",
                f"pick {pick.number + 1} was begun {often} times by processes that ended without a "
                "word: if its training kills the process, Workers(2) (--parallel 2) records that "
                "as a failure and goes on",
            )
        if self.study.spec.any_training:  # what a strategy cannot try is said once
            for note in self.study.state.picks[pick.number].notes:
                if note not in self._said:
                    self._said.add(note)
                    self._announce("on_note", note)

    def _announce(self, method: str, *facts: Any) -> None:
        try:
            self.announce(method, *facts)
        except TrainingPruned as error:
            raise (_Pruned if method == "on_progress" else _CallbackError)(error) from error
        except Exception as error:
            raise _CallbackError(error) from error


class _CallbackError(BaseException):
    """Carries a callback's error past the code that records errors of trainings."""

    def __init__(self, error: Exception) -> None:
        super().__init__(error)
        self.error = error


class _Pruned(_CallbackError):
    """Carries a callback's wish to end a training past the trainer."""


class _Stopped(BaseException):
    """Ends a training whose pick is somebody else's by now."""


def _reason(trouble: Trouble) -> str:
    """One line; of a policy that is trained it says what could not be done with it."""
    if trouble.kept is None:
        return trouble.reason
    return f"the policy is trained, its {trouble.stage} failed with {trouble.reason}"


def failure(message: str, trouble: Trouble) -> TrainingFailed:
    """The error that ends a run, with where the trouble came from."""
    error = TrainingFailed(message)
    error.__cause__ = trouble.error
    if trouble.error is None or trouble.error.__traceback__ is None:  # of another process
        error.add_note(trouble.traceback)
    return error


def places_of(study: AskTell, pick: Pick) -> list[str]:
    """Where the policy of a pick may be, and last where it is to be written.

    Below the study's folder; studies that share it, or a database, keep apart by their uid.
    """
    record = study.state.picks[pick.number]
    alone = study.state.training_of(record).is_specialist
    own = f"source-{pick.source:04d}" if alone else f"pick-{pick.number:04d}"
    base = f"policies/{study.state.uid}/{own}"
    tokens = (*record.tokens, pick.token)
    return [base, *dict.fromkeys(f"{base}-{token}" for token in tokens if token)]


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
            f"{reason_of(error)}; give save and load functions, and the study a place for policies "
            "(artifacts=), or use Workers(1)"
        ) from error


def _worker_died(error: BaseException | None) -> bool:
    return isinstance(error, BrokenExecutor) or _of_dask(error)


def _of_dask(error: BaseException | None) -> bool:
    """Dask's own errors, such as KilledWorker, without importing it."""
    return type(error).__module__.partition(".")[0] == "distributed"
