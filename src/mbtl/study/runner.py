"""The runner joins a study, a trainer and an executor: ask, train, evaluate, tell, until done.

It loses at most the training in flight. A trained policy is put in its folder by one rename before it
is evaluated, so a run killed during evaluation finds it there and trains nothing again.
"""

from __future__ import annotations

import json
import shutil
import time
import uuid
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from mbtl.contexts import Context
from mbtl.errors import InvalidInput, MbtlError, MissingExtra, StorageError, TrainingFailed
from mbtl.objective import Array
from mbtl.seeds import Purpose, evaluation_seed
from mbtl.study.callbacks import Callback
from mbtl.study.study import Pick, Study, StudyFinished
from mbtl.trainer import OnProgress, Progress, Trainer, checked_returns

_RECEIPT = "trained.json"


@dataclass(frozen=True)
class Job:
    """One training and its evaluation, complete in itself so that any process can do it."""

    trainer: Trainer
    context: Context
    seed: int
    targets: Sequence[Context]
    evaluation_seed: int
    folder: Path | None


@dataclass(frozen=True)
class Outcome:
    """What a job gave: checked returns (N, n_episodes), and the policy if it was not saved."""

    returns: Array
    seconds: float
    saved: bool
    policy: Any = None


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
            while batch := _next_batch(study, parallel):
                _do_batch(
                    study, trainer, batch, executor if parallel > 1 else None, on_failure, callbacks
                )
        if report and _can_report(study):
            for callback in callbacks:
                callback.on_report(study)
            report_fresh_returns(study, trainer)
    finally:
        for callback in callbacks:
            callback.on_end(study)


def _next_batch(study: Study, size: int) -> list[Pick]:
    """The next picks to train together; empty when the study is finished.

    Picks left by a killed run come first. A batch then fills up to a multiple of `size` picks asked,
    so a resumed run asks exactly when, and knowing just what, an undisturbed one would have.
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


def _do_batch(
    study: Study,
    trainer: Trainer,
    batch: list[Pick],
    executor: Executor | None,
    on_failure: str,
    callbacks: Sequence[Callback],
) -> None:
    """Train a batch and tell it in pick order; on any interrupt give the open picks back."""
    waiting = list(batch)
    try:
        for pick in batch:
            for callback in callbacks:
                callback.on_pick(study, pick)
        futures: list[Future[Outcome]] = []
        if executor is not None:
            futures = [executor.submit(perform, _job(study, trainer, pick)) for pick in batch]
        for position, pick in enumerate(batch):
            try:
                if executor is not None:
                    outcome = futures[position].result()
                else:
                    outcome = _perform_here(study, trainer, pick, callbacks)
            except (KeyboardInterrupt, StorageError, InvalidInput, MissingExtra):
                raise  # not the training's fault: the pick is given back, to be trained once it is mended
            except Exception as error:
                reason = f"{type(error).__name__}: {error}"
                study.fail(pick, reason)
                waiting.remove(pick)
                for callback in callbacks:
                    callback.on_failed(study, pick, reason)
                if on_failure == "stop":
                    raise TrainingFailed(f"training on {pick.context} failed: {reason}") from error
                continue
            _tell(study, pick, outcome)
            waiting.remove(pick)
            for callback in callbacks:
                callback.on_told(study, pick)
    finally:
        for pick in waiting:
            try:
                study.release(pick)
            except (
                MbtlError
            ):  # the storage is what failed; a dead process's pick is taken over later
                break


def _perform_here(
    study: Study, trainer: Trainer, pick: Pick, callbacks: Sequence[Callback]
) -> Outcome:
    def on_progress(progress: Progress) -> None:
        for callback in callbacks:
            callback.on_progress(study, pick, progress)

    def on_trained() -> None:
        for callback in callbacks:
            callback.on_evaluation(study, pick)

    return perform(_job(study, trainer, pick), on_progress, on_trained)


def _job(study: Study, trainer: Trainer, pick: Pick) -> Job:
    spec = study.spec
    folder = study.folder / _policy_path(pick.source) if study.folder else None
    seed = evaluation_seed(spec.seed, spec.trial)
    return Job(trainer, pick.context, pick.seed, study.space.contexts, seed, folder)


def _policy_path(source: int) -> Path:
    return Path("policies") / f"source-{source:04d}"


def _tell(study: Study, pick: Pick, outcome: Outcome) -> None:
    path = _policy_path(pick.source).as_posix() if outcome.saved else None
    study.tell(
        pick,
        outcome.returns,
        seconds=outcome.seconds,
        policy=path,
        policy_object=outcome.policy,
    )


def perform(
    job: Job, on_progress: OnProgress | None = None, on_trained: Callable[[], None] | None = None
) -> Outcome:
    """Train (unless the policy is there already), save, evaluate. Runs in any process."""
    started = time.perf_counter()
    policy = _trained_before(job)
    saved = policy is not None
    if policy is None:
        policy = job.trainer.train(dict(job.context), job.seed, on_progress)
        saved = _save(job, policy)
    if on_trained is not None:
        on_trained()
    returns = job.trainer.evaluate(policy, list(job.targets), job.evaluation_seed)
    checked = checked_returns(returns, len(job.targets))
    return Outcome(checked, time.perf_counter() - started, saved, None if saved else policy)


def _trained_before(job: Job) -> Any:
    """The policy of a run that was killed after training; None if there is none of this seed."""
    if job.folder is None or not (job.folder / _RECEIPT).is_file():
        return None
    receipt = json.loads((job.folder / _RECEIPT).read_text())
    return job.trainer.load(job.folder) if receipt["seed"] == job.seed else None


def _save(job: Job, policy: Any) -> bool:
    if job.folder is None:
        return False
    temporary = job.folder.with_name(f".{job.folder.name}.{uuid.uuid4().hex[:8]}")
    try:
        temporary.mkdir(parents=True)
        saved = job.trainer.save(policy, temporary)
        if saved:
            receipt = {
                "seed": job.seed,
                "context": dict(job.context),
                "format": job.trainer.policy_format,
            }
            (temporary / _RECEIPT).write_text(json.dumps(receipt))
            shutil.rmtree(job.folder, ignore_errors=True)
            temporary.rename(job.folder)
        return saved
    except OSError as error:
        raise StorageError(
            f"the policy could not be saved in {job.folder.parent} ({error.strerror or error}); what was "
            "told before is kept: free space or mend access, then run the same command again"
        ) from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _can_report(study: Study) -> bool:
    """True when there is something to report and every policy is at hand."""
    state = study.state
    at_hand = all(row.policy or row.source in study.policies for row in state.rows)
    return bool(state.rows) and state.fresh_returns is None and at_hand


def report_fresh_returns(study: Study, trainer: Trainer) -> Array:
    """Evaluate on fresh seeds each policy where it served at some k; record and return (k, N).

    The rows that chose the routes are noisy, so their maximum is biased upwards; these episodes
    chose nothing.
    """
    history = study.history
    portfolio = study.portfolio(trainer)
    seed = evaluation_seed(study.spec.seed, study.spec.trial, Purpose.REPORT)
    fresh = np.full(history.rows.shape, np.nan)
    for i, targets in enumerate(served_targets(history.rows)):
        if targets.size:
            contexts = [study.space.context(int(t)) for t in targets]
            returns = trainer.evaluate(portfolio.policy(i), contexts, seed)
            fresh[i, targets] = checked_returns(returns, targets.size).mean(axis=1)
    study.record_fresh_returns(fresh)
    return fresh


def served_targets(rows: Array) -> list[np.ndarray[tuple[int], np.dtype[np.intp]]]:
    """For each of k rows, the targets it serves after 1, 2, ... or k trainings."""
    routes = routes_by_k(rows)
    return [np.flatnonzero((routes == i).any(axis=0)) for i in range(len(rows))]


def routes_by_k(rows: Array) -> np.ndarray[tuple[int, int], np.dtype[np.intp]]:
    """(k, N) row index that serves each target after 1..k trainings; the first of equals."""
    running = np.maximum.accumulate(rows, axis=0)
    improved = np.vstack([np.ones((1, rows.shape[1]), dtype=bool), running[1:] > running[:-1]])
    index = np.where(improved, np.arange(len(rows))[:, None], 0)
    return np.asarray(np.maximum.accumulate(index, axis=0))


def fresh_curve(study: Study) -> Array | None:
    """(k,) V after each training, routed by the selecting rows, measured on fresh episodes."""
    fresh = study.state.fresh_returns
    if fresh is None:
        return None
    performance = study.bounds.normalise(fresh)
    routes = routes_by_k(study.history.rows)
    routed = np.take_along_axis(performance, routes, axis=0)
    return np.asarray(routed @ study.space.weights)
