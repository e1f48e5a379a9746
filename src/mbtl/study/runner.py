"""The runner joins a study, a trainer and an executor: ask, train, evaluate, tell, until done.

It loses at most the training in flight; see `mbtl.study.job` for how.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path

from mbtl.errors import InvalidInput, MbtlError, MissingExtra, StorageError, TrainingFailed
from mbtl.seeds import evaluation_seed
from mbtl.study.callbacks import Callback
from mbtl.study.fresh import can_report, report_fresh_returns
from mbtl.study.job import Job, Outcome, perform
from mbtl.study.study import Pick, Study, StudyFinished
from mbtl.trainer import Progress, Trainer

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
        TrainingFailed: a training failed and on_failure is "stop".
    """
    if on_failure not in ("continue", "stop"):
        raise InvalidInput(f"on_failure must be 'continue' or 'stop', got {on_failure!r}")
    if parallel < 1:
        raise InvalidInput(f"parallel must be >= 1, got {parallel}")
    try:
        with ExitStack() as stack:
            if parallel > 1 and executor is None:
                pool = ProcessPoolExecutor(parallel, mp_context=get_context("spawn"))
                executor = stack.enter_context(pool)
            pooled = executor if parallel > 1 else None
            work = _Work(study, trainer, pooled, on_failure == "stop", callbacks)
            while batch := _next_batch(study, parallel):
                work.do(batch)
        if report and can_report(study):
            for callback in callbacks:
                callback.on_report(study)
            report_fresh_returns(study, trainer)
    finally:
        for callback in callbacks:
            callback.on_end(study)


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
        for pick in batch:
            for callback in self.callbacks:
                callback.on_pick(self.study, pick)
        waiting = list(batch)
        try:
            for pick, outcome in self._outcomes(batch):
                self._answer(pick, outcome)
                waiting.remove(pick)
                if isinstance(outcome, Exception) and self.stop_on_failure:
                    raise TrainingFailed(
                        f"training on {pick.context} failed: {_reason(outcome)}"
                    ) from outcome
        finally:
            self._give_back(waiting)

    def _outcomes(self, batch: list[Pick]) -> Iterator[tuple[Pick, Outcome | Exception]]:
        """What each pick gave, in pick order; the exception where its training failed."""
        calls: list[Callable[[], Outcome]]
        if self.executor is None:
            calls = [partial(self._perform_here, pick) for pick in batch]
        else:
            calls = [self.executor.submit(perform, self._job(pick)).result for pick in batch]
        for pick, call in zip(batch, calls, strict=True):
            try:
                outcome: Outcome | Exception = call()
            except _NOT_THE_TRAININGS_FAULT:
                raise
            except Exception as error:
                outcome = error
            yield pick, outcome

    def _answer(self, pick: Pick, outcome: Outcome | Exception) -> None:
        if isinstance(outcome, Exception):
            self.study.fail(pick, _reason(outcome))
            for callback in self.callbacks:
                callback.on_failed(self.study, pick, _reason(outcome))
            return
        self.study.tell(
            pick,
            outcome.returns,
            seconds=outcome.seconds,
            policy=_policy_path(pick.source).as_posix() if outcome.saved else None,
            policy_object=outcome.policy,
        )
        for callback in self.callbacks:
            callback.on_told(self.study, pick)

    def _give_back(self, picks: list[Pick]) -> None:
        for pick in picks:
            try:
                self.study.release(pick)
            except (
                MbtlError
            ):  # the storage itself failed; a dead process's pick is taken over later
                return

    def _perform_here(self, pick: Pick) -> Outcome:
        def on_progress(progress: Progress) -> None:
            for callback in self.callbacks:
                callback.on_progress(self.study, pick, progress)

        def on_trained() -> None:
            for callback in self.callbacks:
                callback.on_evaluation(self.study, pick)

        return perform(self._job(pick), on_progress, on_trained)

    def _job(self, pick: Pick) -> Job:
        study, spec = self.study, self.study.spec
        folder = study.folder / _policy_path(pick.source) if study.folder else None
        seed = evaluation_seed(spec.seed, spec.trial)
        return Job(self.trainer, pick.context, pick.seed, study.space.contexts, seed, folder)


def _policy_path(source: int) -> Path:
    return Path("policies") / f"source-{source:04d}"


def _reason(error: Exception) -> str:
    return f"{type(error).__name__}: {error}"
