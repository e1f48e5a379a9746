"""The runner joins a study, a trainer and an executor: ask, train, evaluate, tell, until done.

It loses at most the training in flight; see `mbtl.study.job` for how.
"""

from __future__ import annotations

import logging
import pickle
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, Executor, ProcessPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from mbtl.errors import InvalidInput, MissingExtra, StorageError, StudyError, TrainingFailed
from mbtl.processes import worker_pool
from mbtl.seeds import evaluation_seed
from mbtl.study.callbacks import Callback
from mbtl.study.fresh import can_report, report_fresh_returns
from mbtl.study.job import Job, Outcome, perform
from mbtl.study.pick import Pick, StudyFinished
from mbtl.study.study import Study
from mbtl.trainer import Trainer
from mbtl.untrusted import inside

_logger = logging.getLogger(__name__)

_NOT_THE_TRAININGS_FAULT = (StorageError, InvalidInput, MissingExtra)
"""Raised as they are: the pick is given back, to be trained once the cause is mended."""


def run(
    study: Study,
    trainer: Trainer,
    *,
    parallel: int = 1,
    executor: Executor | None = None,
    on_failure: str = "continue",
    callbacks: Sequence[Callback] = (),
    report: bool = True,
) -> None:
    """Run a study to its end; interrupted, it goes on where it was when called again.

    Args:
        study: decides what to train.
        trainer: trains, evaluates, saves and loads.
        parallel: picks trained at the same time. The selector proposes them together, so each is
            made without the rows of the others.
        executor: runs the jobs when parallel > 1; local processes when missing.
        on_failure: "continue" records a failed training and goes on; "stop" also raises it.
        callbacks: told what happens.
        report: evaluate the routed policies on fresh seeds at the end.

    Raises:
        TrainingFailed: a training failed and on_failure is "stop", or every training failed.
    """
    if on_failure not in ("continue", "stop"):
        raise InvalidInput(f"on_failure must be 'continue' or 'stop', got {on_failure!r}")
    if parallel < 1:
        raise InvalidInput(f"parallel must be >= 1, got {parallel}")
    try:
        with ExitStack() as stack:
            if parallel > 1 and executor is None:
                executor = stack.enter_context(worker_pool(parallel))
            pooled = executor if parallel > 1 else None
            work = _Work(study, trainer, pooled, on_failure == "stop", callbacks)
            while batch := _next_batch(study, parallel):
                work.do(batch)
        if study.state.failures and not study.state.rows:
            last = study.state.failures[-1]
            raise TrainingFailed(
                f"all {len(study.state.failures)} trainings failed, the last with {last.reason}; "
                "mend the cause and start afresh (--new, or another name)"
            )
        if report and can_report(study):
            _report(study, trainer, callbacks)
    finally:
        for callback in callbacks:
            callback.on_end(study)


def _report(study: Study, trainer: Trainer, callbacks: Sequence[Callback]) -> None:
    """Measure V on fresh episodes; a failure there must not hide what the study found."""
    for callback in callbacks:
        callback.on_report(study)
    told = len(study.state.rows)
    try:
        report_fresh_returns(study, trainer)
    except StorageError:
        if len(study.refresh().rows) == told:
            raise
    except StudyError:  # another process told a row meanwhile; it reports when it ends
        return
    except Exception as error:
        for callback in callbacks:
            callback.on_report_failed(study, _reason(error))


def _next_batch(study: Study, size: int) -> list[Pick]:
    """The next picks to train together; empty when the study is finished.

    Picks left by a killed run come first. A batch then fills up to a multiple of `size` picks
    asked, so a resumed run asks exactly when, and knowing just what, an undisturbed one would have.
    """
    batch: list[Pick] = []
    while len(batch) < size:
        try:
            batch.append(study.ask(take_over=True))
        except StudyFinished:
            break
        if not study.orphans and len(study.state.picks) % size == 0:
            break
    return batch


@dataclass(frozen=True)
class _Work:
    """Does batches of picks: trains them, tells their rows in pick order, gives back the rest."""

    study: Study
    trainer: Trainer
    executor: Executor | None
    stop_on_failure: bool
    callbacks: Sequence[Callback]

    def do(self, batch: list[Pick]) -> None:
        """Train a batch and tell it; on any interrupt give the unanswered picks back."""
        waiting = list(batch)
        try:
            for pick in batch:
                self._announce("on_pick", pick)
            for pick, outcome in self._outcomes(batch):
                self._record(pick, outcome)
                waiting.remove(pick)
                self._log(pick, outcome)
                if not isinstance(outcome, Exception):
                    self._announce("on_told", pick)
                    continue
                self._announce("on_failed", pick, _reason(outcome))
                if self.stop_on_failure:
                    raise TrainingFailed(
                        f"training on {pick.context} failed: {_reason(outcome)}"
                    ) from outcome
        except _CallbackError as wrapped:
            raise wrapped.error from None
        finally:
            self._give_back(waiting)

    def _outcomes(self, batch: list[Pick]) -> Iterator[tuple[Pick, Outcome | Exception]]:
        """What each pick gave, in pick order; the exception where its training failed."""
        jobs = [self._job(pick) for pick in batch]
        calls: list[Callable[[], Outcome]]
        if self.executor is None:
            pairs = zip(batch, jobs, strict=True)
            calls = [partial(self._perform_here, pick, job) for pick, job in pairs]
        else:
            _check_can_travel(self.executor, jobs[0])
            calls = [self.executor.submit(perform, job).result for job in jobs]
        for pick, call in zip(batch, calls, strict=True):
            try:
                outcome: Outcome | Exception = call()
            except _NOT_THE_TRAININGS_FAULT:
                raise
            except BrokenExecutor as error:
                raise StudyError(
                    "a worker process died (a script without `if __name__ == '__main__':`, killed, "
                    "or out of memory); its picks are given back: run again, with a smaller "
                    "parallel if memory is short"
                ) from error
            except Exception as error:
                outcome = error
            yield pick, outcome

    def _record(self, pick: Pick, outcome: Outcome | Exception) -> None:
        if isinstance(outcome, Exception):
            self.study.fail(pick, _reason(outcome))
            return
        self.study.tell(
            pick,
            outcome.returns,
            seconds=outcome.seconds,
            policy=_policy_path(self.study, pick).as_posix() if outcome.saved else None,
            policy_object=outcome.policy,
        )

    def _log(self, pick: Pick, outcome: Outcome | Exception) -> None:
        where = f"pick {pick.number + 1} of {self.study.spec.budget}, {pick.context}"
        if isinstance(outcome, Exception):
            _logger.warning("%s failed: %s", where, _reason(outcome))
        else:
            _logger.info("%s: V = %.4f", where, self.study.value)

    def _give_back(self, picks: list[Pick]) -> None:
        for pick in picks:
            try:
                self.study.release(pick)
            except StorageError:  # the storage is what failed; the pick is taken over later
                return
            except StudyError:  # somebody else answered it
                continue

    def _perform_here(self, pick: Pick, job: Job) -> Outcome:
        return perform(
            job,
            partial(self._announce, "on_progress", pick),
            partial(self._announce, "on_evaluation", pick),
        )

    def _announce(self, method: str, pick: Pick, *facts: Any) -> None:
        for callback in self.callbacks:
            try:
                getattr(callback, method)(self.study, pick, *facts)
            except Exception as error:
                raise _CallbackError(error) from error

    def _job(self, pick: Pick) -> Job:
        study, spec = self.study, self.study.spec
        place = _policy_path(study, pick).as_posix()
        folder = inside(study.folder, place, "a study") if study.folder else None
        seed = evaluation_seed(spec.seed, spec.trial)
        targets = range(study.space.n) if pick.targets is None else pick.targets
        contexts = [study.space.context(target) for target in targets]
        return Job(self.trainer, pick.context, pick.seed, contexts, seed, folder)


class _CallbackError(BaseException):
    """Carries a callback's error past the code that records errors of trainings."""

    def __init__(self, error: Exception) -> None:
        super().__init__(error)
        self.error = error


def _policy_path(study: Study, pick: Pick) -> Path:
    """Below the study's folder; studies that share it, or a database, keep apart by their uid."""
    again = f"-{pick.repeat}" if pick.repeat else ""
    return Path("policies", study.state.uid, f"source-{pick.source:04d}{again}")


def _check_can_travel(executor: Executor, job: Job) -> None:
    if isinstance(executor, ProcessPoolExecutor):
        try:
            pickle.dumps(job)
        except Exception as error:
            raise InvalidInput(
                "training in other processes needs functions of a module that they can import, got "
                f"one that cannot be sent ({error}); move it to a module, or use parallel=1"
            ) from error


def _reason(error: Exception) -> str:
    return f"{type(error).__name__}: {error}"
