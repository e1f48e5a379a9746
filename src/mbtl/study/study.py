"""A study with its runs: ask, train, evaluate, tell, until done; and what a run tells meanwhile.

It loses at most the training in flight; see `mbtl.study.job` and `mbtl.study.batch` for how.
"""

from __future__ import annotations

import pickle
import random
import sys
import time
import uuid
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal, TextIO

import numpy as np

from mbtl.arrays import Array, Indices
from mbtl.errors import (
    InvalidInput,
    MbtlError,
    StorageError,
    StudyError,
    TrainingFailed,
    UnsavedPolicies,
    check_known,
)
from mbtl.faults import FAULTS, reason_of, say
from mbtl.plain import record, short, whole
from mbtl.portfolio import Portfolio
from mbtl.processes import SeparateWorkers, separate_workers
from mbtl.score import RANDOM_ACTIONS, SCORE
from mbtl.seeds import Purpose
from mbtl.study import ask
from mbtl.study.artifacts import FolderStore
from mbtl.study.ask_tell import AskTell
from mbtl.study.batch import Batches, brought_back, failure
from mbtl.study.budget import counted
from mbtl.study.closing_report import FreshValue, ReportPlan, fresh_value, plan_to_do
from mbtl.study.heartbeat import Keeper
from mbtl.study.job import NOT_THE_TRAININGS_FAULT, Trouble
from mbtl.study.job import rehearse as rehearsed
from mbtl.study.problem import trainer_of
from mbtl.study.records import Failure, Pick, StudyFinished
from mbtl.study.tell import answered, sources_of
from mbtl.study.time_limits import at_most, too_long
from mbtl.study.trainings import Training
from mbtl.trainers.contract import (
    FunctionTrainer,
    MeasuringTrainer,
    Progress,
    RehearsingTrainer,
    Trainer,
    checked_returns,
    checked_targets,
    completed,
)

LEASE = 60.0
"""Seconds for which a run may be silent before others take its trainings over."""
_LOOK, _LONGEST_LOOK = 0.1, 2.0
"""Seconds between looks at what others do: often at first, seldom while nothing happens."""


@dataclass(frozen=True)
class Failures:
    """What a run does about trainings that fail.

    Attributes:
        most_in_a_row: so many failures in a row end the run, and so does the first one while
            nothing has succeeded; 1: the first one always.
        retries: so often a training that failed is begun again, each time with another seed, before
            it counts as failed. One whose worker process died is begun again once in any case, as
            it was.
        retry_failed: train again where trainings of former runs failed, or gave policies that
            cannot be evaluated; see `Study.retry`.
        rehearse: evaluate an untrained policy on two contexts before the first training, where the
            trainer can make one; else the first policy on two contexts before all others.

    Raises:
        InvalidInput: a number that is too small.
    """

    most_in_a_row: int = 3
    retries: int = 0
    retry_failed: bool = False
    rehearse: bool = True

    def __post_init__(self) -> None:
        whole("most_in_a_row of Failures", self.most_in_a_row, 1)
        whole("retries of Failures", self.retries, 0)


@dataclass(frozen=True)
class Workers:
    """Where the trainings of a run are done, and how long they may take.

    Attributes:
        parallel: picks trained at the same time. Each is told when it is done, and the next one is
            proposed at once, without the rows of those under way.
        executor: does them when `parallel` > 1; None: processes of this machine.
        lease: seconds without a sign of life after which other runs take the trainings over. On one
            machine they do so at once when the process has ended.
        timeout: seconds that a training and its evaluation may take; longer ones are ended, and
            count as failed. In this process only Python code and waits can be ended, and native
            code when it returns (`Callback.on_stuck`); worker processes are killed if need be.

    Raises:
        InvalidInput: a number that is too small.
    """

    parallel: int = 1
    executor: Executor | None = None
    lease: float = LEASE
    timeout: float | None = None

    def __post_init__(self) -> None:
        whole("parallel of Workers", self.parallel, 1)
        for name, seconds in (("lease", self.lease), ("timeout", self.timeout)):
            if seconds is not None and not seconds > 0:
                raise InvalidInput(f"{name} of Workers is a number of seconds > 0, got {seconds!r}")


class Study(AskTell):
    """One selection run over an event log. Make one with `create_study` or `load_study`.

    Threads may share one; another process opens it with `load_study`, as another worker.

    Attributes:
        name: within its storage.
        log: where its events are.
        artifacts: keeps the policies; None: they cannot be kept.
        database: its file; None: it is on a server, or in memory.
        trainer: trains and reads policies where no other is given.
        beside: what people see beside V, measured by the closing report.
        worker: name by which this object holds picks.
        presence: who surely is gone, where that can be known.
        policies: number of the row -> policy, for policies of this process that were not saved.
        untold: number of the pick -> what is trained, not saved, and not evaluated so far.
        stopping: why the run that goes on is to end (`Study.stop`); None: it is not.
        selector: the strategy, which proposes trainings.
    """

    def run(
        self,
        train: Callable[..., Any] | None = None,
        evaluate: Callable[..., Any] | None = None,
        *,
        trainer: Trainer | None = None,
        workers: Workers | None = None,
        failures: Failures | None = None,
        callbacks: Sequence[Callback] = (),
        progress: bool = True,
        report: bool | Literal["all"] = True,
    ) -> RunResult:
        """Train and evaluate until the study is finished; see `mbtl.study.study.run`.

        A callback ends the run by `study.stop`, and a training early by raising `TrainingPruned`.

        Args:
            train: `train(context, seed) -> policy`; or `train(contexts, seed, *, start=None,
                length=None) -> policy`, which lets a strategy train on several contexts, from a
                policy, for any length; see `mbtl.trainers.FunctionTrainer`.
            evaluate: policy, contexts, seeds -> returns, (n_targets,) or (n_targets, n_episodes);
                one seed per context.
            trainer: instead of these functions; None: the one that the study was made with. To
                keep policies of functions: `FunctionTrainer(train, evaluate, save, load)`.
            workers: how many trainings at a time, where, how long; None: one after another, here.
            failures: what to do about trainings that fail; None: see `Failures`.
            callbacks: told what happens.
            progress: print a line per pick to standard error.
            report: evaluate the routed policies on fresh seeds at the end; "all": on all contexts.

        Returns:
            V after each training, all trainings, failures, and why the run ended.

        Raises:
            StudyMismatch: the study was run with another recipe, policy format or code before;
                `equip(trainer, accept_changes=True)` accepts other code.
        """
        if (train is not None or evaluate is not None) and trainer is not None:
            raise InvalidInput("run takes functions or a trainer, got both; leave one out")
        trainer = self.trainer if trainer is None and train is None else trainer
        if trainer is None:
            if train is None or evaluate is None:
                raise InvalidInput("run needs train and evaluate functions, or a trainer")
            trainer = FunctionTrainer(train, evaluate)
        if report not in (True, False, "all"):
            raise InvalidInput(f"report is True, False or 'all', got {short(report)}; give one")
        return run(
            self,
            trainer_of(trainer),
            workers=record("workers", workers, Workers(), Workers),
            failures=record("failures", failures, Failures(), Failures),
            callbacks=(*_listed(callbacks), *([PrintProgress()] if progress else [])),
            report=report,
        )

    def adopt(
        self,
        policy: Any,
        trained_on: Mapping[str, Any] | Sequence[Mapping[str, Any]],
        *,
        trainer: Trainer | None = None,
    ) -> None:
        """Take in a policy that you have: save it, evaluate it as all are, and tell its row.

        It serves where it is best, trainings may begin with it, and the budget stays whole.

        Args:
            policy: as the trainer has them, e.g. what Stable-Baselines3 loads from your zip.
            trained_on: its context, which is one of the study's, or several of them.
            trainer: evaluates and saves; None: the one that the study was made with.

        Raises:
            InvalidInput: there is no trainer.
            ContextMismatch: the study has no such context.
            StudyError: one that was trained there, from scratch, was told before.
            StorageError: the policy cannot be saved.
        """
        trainer = self.trainer if trainer is None else trainer_of(trainer)
        if trainer is None:
            raise InvalidInput("a policy is evaluated by a trainer, got none; give trainer=...")
        if isinstance(policy, Path) or (isinstance(policy, str) and policy.endswith(".zip")):
            raise InvalidInput(
                f"a policy is taken in as an object, got the path {str(policy)!r}; load it first, "
                "e.g. stable_baselines3.PPO.load(path)"
            )
        sources = sources_of(self.space, trained_on)
        self.equip(trainer)
        state = self.refresh()
        answered(state, None, sources)  # refused before anything is played
        targets = ask.usual_targets(state, sources)
        contexts = [self.space.context(target) for target in checked_targets(targets, self.space.n)]
        returns = trainer.evaluate(policy, contexts, self.evaluation_seeds(targets))
        kept = None
        if self.artifacts is not None:
            place = f"policies/{self.state.uid}/adopted-{uuid.uuid4().hex[:8]}"
            on = [self.space.context(source) for source in sources]
            kept = self.artifacts.write(place, partial(trainer.save, policy), {"contexts": on})
        unsaved = None if kept else policy
        self.tell(sources, returns, targets=targets, policy=kept, policy_object=unsaved)


@dataclass(frozen=True, eq=False, repr=False)
class RunResult:
    """A study when a run of it has ended.

    Attributes:
        study: that was run.
        curve: (k,) the running estimate of V after each row, performance.
        fresh: V on fresh episodes, which chose nothing: the one to tell people; None: not measured.
        trainings: all of the study, those of earlier runs too.
        failures: of the study, those of trainings ended early on purpose too.
        stop_reason: why no more is trained; None: others are still at it.
        seconds: wall time of this run.
    """

    study: Study
    curve: Array
    fresh: FreshValue | None
    trainings: tuple[Training, ...]
    failures: tuple[Failure, ...]
    stop_reason: str | None
    seconds: float

    @property
    def value(self) -> float:
        """V at the end, as `Study.value`: fresh if played, else the running estimate."""
        if self.fresh is not None:
            return self.fresh.value
        return float(self.curve[-1]) if len(self.curve) else float("-inf")

    def portfolio(self) -> Portfolio:
        """The trained policies with their router; see `Study.portfolio`."""
        return self.study.portfolio()

    def __repr__(self) -> str:
        where = "on fresh episodes" if self.fresh is not None else "estimated"
        lost = sum(not one.pruned for one in self.failures)
        failed = f", {lost} failed" if lost else ""
        return (
            f"RunResult({self.study.name!r}: {len(self.curve)} trainings told{failed}, "
            f"V = {self.value:.4f} {where}, {self.seconds:.1f} s; {self.stop_reason})"
        )


class Callback:
    """Base with methods that do nothing.

    `study.stop(reason)` in any of them ends the run when what is under way is told; raising
    `TrainingPruned` in `on_progress` ends that training alone. Other exceptions end the run at
    once, and nothing is lost.
    """

    def on_note(self, study: Study, words: str) -> None:
        """A sentence that people should read, such as who else works on the study."""

    def on_pick(self, study: Study, pick: Pick) -> None:
        """A pick was asked for and its training starts."""

    def on_progress(self, study: Study, pick: Pick, progress: Progress) -> None:
        """A training reports; only trainings in this process do."""

    def on_evaluation(self, study: Study, pick: Pick) -> None:
        """Training is done, evaluation on all contexts starts."""

    def on_told(self, study: Study, pick: Pick) -> None:
        """The row of a pick was recorded."""

    def on_failed(self, study: Study, pick: Pick, reason: str) -> None:
        """A training failed, or a trained policy could not be evaluated; it was recorded."""

    def on_pruned(self, study: Study, pick: Pick, reason: str) -> None:
        """A training was ended early on purpose; who does not tell it apart hears of a failure."""
        self.on_failed(study, pick, reason)

    def on_lost(self, study: Study, pick: Pick) -> None:
        """A pick was taken over or taken away; its training counts for nothing."""

    def on_stuck(self, study: Study, pick: Pick, reason: str) -> None:
        """A training did not end at its time limit, and counts as failed. From another thread.

        This process can do nothing more until its native code returns: what is worth having is to
        be saved here, or the process ended.
        """

    def on_report(self, study: Study, plan: ReportPlan) -> None:
        """The policies are now evaluated on fresh seeds, as often as the plan says."""

    def on_end(self, study: Study) -> None:
        """The run ends, also by an interrupt."""


class PrintProgress(Callback):
    """A line per pick, for people.

    `pick 3 of 5: gravity = 7.5 m/s2, V = 0.8312 +- 0.0140, estimated (gain 0.0210)`

    Args:
        file: to print to; None: standard error, as it is at that moment.
    """

    def __init__(self, file: TextIO | None = None) -> None:
        self._file = file

    def on_note(self, study: Study, words: str) -> None:
        """The sentence."""
        self._say(words)

    def on_told(self, study: Study, pick: Pick) -> None:
        """V, and what the new policy added to it."""
        curve = study.curve
        gain = f" (gain {curve[-1] - curve[-2]:.4f})" if len(curve) > 1 else ""
        self._say(f"{study.state.where(pick)}, {estimate(study)}{gain}", pick)

    def on_failed(self, study: Study, pick: Pick, reason: str) -> None:
        """Why there is no V."""
        self._say(f"{study.state.where(pick)} failed: {reason}", pick, "red")

    def on_pruned(self, study: Study, pick: Pick, reason: str) -> None:
        """Why there is no V, and that it is meant so."""
        self._say(f"{study.state.where(pick)} was ended early: {reason}", pick, "yellow")

    def on_lost(self, study: Study, pick: Pick) -> None:
        """That the work was for nothing."""
        self._say(f"{study.state.where(pick)} was taken over by somebody else", pick, "yellow")

    def on_stuck(self, study: Study, pick: Pick, reason: str) -> None:
        """Why nothing happens, and what helps."""
        self._say(
            f"{study.state.where(pick)} failed: {reason}; end this process and run again to go on: "
            "worker processes (Workers(2)) would be killed"
        )

    def on_report(self, study: Study, plan: ReportPlan) -> None:
        """How much is evaluated."""
        self._say(f"measuring V on fresh episodes: {plan}")

    def _say(self, line: str, ended: Pick | None = None, style: str | None = None) -> None:
        """One line; of a pick that has ended, where it says so."""
        say(line, sys.stderr if self._file is None else self._file)


def estimate(study: Study) -> str:
    """V while a study runs, in words, with half its 95 % interval: "V = 0.8312 +- 0.0140"."""
    now = study.routing.value
    bar = f" +- {now.margin:.4f}" if now.margin > 0.0 else ""
    return f"V = {now.value:.4f}{bar}, estimated"


# ---- a run ------------------------------------------------------------------------------------


def run(
    study: Study,
    trainer: Trainer,
    *,
    workers: Workers = Workers(),
    failures: Failures = Failures(),
    callbacks: Sequence[Callback] = (),
    report: bool | Literal["all"] = True,
    accept_changes: bool = False,
    wait: bool = True,
) -> RunResult:
    """Run a study to its end; interrupted, it goes on where it was when called again.

    A policy that is trained and could not be evaluated is kept: it spends no further budget, and
    the evaluation is done again when all else is done, and by the next run.

    Args:
        study: decides what to train.
        trainer: trains, evaluates, saves and loads.
        workers: where, and how long at most.
        failures: what to do about them.
        callbacks: told what happens.
        report: evaluate the routed policies on fresh seeds at the end: on as many contexts as cost
            no more than the study itself, or on "all". Not of a study with a risk.
        accept_changes: a user's own functions may have changed since the study was begun; the log
            says so then.
        wait: stay while others are at the last trainings, to take over from those that die.

    Returns:
        The study at its end, and why it ended.

    Raises:
        TrainingFailed: failures ended the run, or no training succeeded.
    """
    started, study.stopping = time.monotonic(), None

    def announce(method: str, *facts: Any) -> None:
        for callback in callbacks:
            getattr(callback, method)(study, *facts)

    try:
        with Keeper(study, workers.lease) as keeper, _pool(workers) as pooled:
            _check_can_travel(pooled, trainer)
            _warn_of_unsaved(study, trainer)
            if any(isinstance(one, str) for one in study.beside.baselines.values()):
                _baselines(study, trainer)  # refuses a name before anything is trained
            _announce_others(study, announce)
            lost = _announce_lost(study, announce)
            _announce_dear_rows(study, announce)
            if study.state.equipment is not None or failures.retry_failed or not study.is_finished:
                study.equip(trainer, accept_changes=accept_changes)
            if failures.retry_failed:
                begin_again(study)
            finished = study.stop_reason is not None and not study.orphans
            if not (finished or lost):
                _check_kept(study)
            if isinstance(pooled, SeparateWorkers) and not finished:
                pooled.begin()
            first_policy = failures.rehearse and not (study.has_succeeded or finished)
            if first_policy and isinstance(trainer, RehearsingTrainer):
                _rehearse(study, partial(rehearsed, trainer, timeout=workers.timeout), pooled)
                first_policy = False
            batches = Batches(
                study, trainer, pooled, failures.most_in_a_row - 1, first_policy, announce, keeper,
                workers.timeout, failures.retries,
            )  # fmt: skip
            do_all = partial(batches.do, workers.parallel, partial(_next_pick, study, keeper))
            try:
                do_all()
                while wait and _wait_for_others(study, announce):
                    do_all()
                if batches.give_back_held():
                    do_all()
            finally:
                batches.give_back_held()
        _check_any_success(study)
        if report:
            _report(study, trainer, announce, workers.timeout, whole=report == "all")
    finally:
        announce("on_end")
    return RunResult(
        study,
        study.curve,
        fresh_value(study.state),
        study.trainings,
        tuple(study.state.failures),
        study.stopping or study.stop_reason,
        time.monotonic() - started,
    )


def begin_again(study: Study) -> None:
    """Open what failed, and where nobody works on it what gave a policy that cannot be evaluated.

    A further evaluation that cannot be made trains nothing, so it is given up.
    """
    state = study.refresh()
    for failed in [one for one in state.failures if not one.pruned]:
        study.retry(failed.pick)
    for number in sorted(state.deferred.keys() & set(study.orphans)):
        if state.picks[number].length:
            study.retry(number)
        else:
            study.fail(study.pick(number), state.deferred[number].reason)


def _listed(callbacks: Any) -> Sequence[Callback]:
    """Raises InvalidInput where it is one alone, or has a class that was not called."""
    found = tuple(callbacks) if isinstance(callbacks, Iterable) else (type(callbacks),)
    if any(isinstance(one, type) for one in found):
        raise InvalidInput(f"callbacks is a list of objects, as [MyCallback()], got {callbacks!r}")
    return found


def _pool(workers: Workers) -> AbstractContextManager[Executor | None]:
    """Where jobs run; None: in this process."""
    if workers.parallel > 1 and workers.executor is None:
        return separate_workers(workers.parallel)
    return nullcontext(None if workers.parallel == 1 else workers.executor)


def _check_any_success(study: Study) -> None:
    failures = [failure for failure in study.state.failures if not failure.pruned]
    if failures and not study.state.rows:
        raise TrainingFailed(
            f"no training of this study succeeded, {len(failures)} failed, the last with "
            f"{failures[-1].reason}; mend the cause and run again with "
            "Failures(retry_failed=True) (--retry-failed)"
        )


def _rehearse(
    study: Study, rehearsal: Callable[..., Trouble | None], executor: Executor | None
) -> None:
    """Find out before the first training what would fail after it."""
    ends = sorted({0, study.space.n - 1})
    contexts, seeds = [study.space.context(i) for i in ends], study.evaluation_seeds(ends)
    if executor is None:
        trouble = rehearsal(contexts, seeds)
    else:
        trouble = brought_back(executor.submit(rehearsal, contexts, seeds))
    if trouble is None:
        return
    if isinstance(trouble.error, NOT_THE_TRAININGS_FAULT):
        raise trouble.error
    if isinstance(trouble.error, MbtlError):  # it says all; where it was raised says nothing more
        cause = trouble.error.__cause__
        raise TrainingFailed(f"{trouble.error}; nothing was trained") from cause
    raise failure(
        f"{trouble.stage} of an untrained policy failed with {trouble.reason}, so nothing was "
        "trained: mend the cause and run again; Failures(rehearse=False) "
        "(--no-rehearsal) skips this trial",
        trouble,
    )


def _next_pick(study: Study, keeper: Keeper) -> Pick | None:
    """A pick that is held from now on; None when nothing can be asked, or shall be."""
    if study.stopping is not None:
        return None
    try:
        pick = study.ask(lease=keeper.seconds)
    except StudyFinished:
        return None
    keeper.hold(pick)
    return pick


def _wait_for_others(study: Study, announce: Callable[..., None]) -> bool:
    """Wait for a change while others hold what is left; False when there is nothing to wait for.

    One of them may die, and its training is then to be done here.
    """
    seq, left, pause = study.refresh().seq, study.orphans, _LOOK
    while seq == study.refresh().seq and study.orphans == left:
        theirs = ask.others(study.state, study.watch(), study.worker, for_ever=False)
        if not theirs or study.stopping is not None:
            return False
        if pause == _LOOK:
            announce("on_note", f"waiting for trainings of {', '.join(theirs)}")
        time.sleep(pause * random.uniform(0.5, 1.0))
        pause = min(1.5 * pause, _LONGEST_LOOK)
    return True


def _report(
    study: Study,
    trainer: Trainer,
    announce: Callable[..., None],
    timeout: float | None,
    *,
    whole: bool,
) -> None:
    """Measure V on fresh episodes; a failure there must not hide what the study found."""

    def failed(reason: str) -> None:
        announce("on_note", f"V on fresh episodes could not be measured: {reason}")

    plan = plan_to_do(study.state, study.policies, study.beside, whole=whole)
    if plan is None:
        if study.state.rows and study.state.fresh is None and study.spec.risk == 1.0:
            failed("policies that serve were told without their files")
        return
    store, kept = study.artifacts, _kept(study)
    serving = [i for i in plan.policies if i in kept]
    if gone := [i + 1 for i in serving if store and store.receipt(kept[i][0]) is None]:
        failed(f"the policies of trainings {gone} are not where they were told")
        return
    told = len(study.state.rows)
    stuck = partial(failed, f"{too_long(timeout or 0.0)}; end this process, all else is kept")
    try:
        baselines = _baselines(study, trainer)
    except FAULTS as error:
        failed(reason_of(error))
        return
    plan = replace(plan, baselines=len(baselines))
    announce("on_report", plan)
    try:
        _play(study, trainer, plan, baselines, announce, partial(at_most, timeout, stuck))
    except StorageError:
        if len(study.refresh().rows) == told:
            raise
    except StudyError:  # another process told a row meanwhile; it reports when it ends
        return
    except FAULTS as error:
        failed(reason_of(error))


def _warn_of_unsaved(study: Study, trainer: Trainer) -> None:
    """Before the first training: what is stored should not outlive its policies unnoticed.

    Raises:
        StorageError: they cannot be written where they are to be kept.
    """
    saves = getattr(trainer, "saves", True)
    if study.is_finished:
        return
    if saves and study.artifacts is not None:
        study.artifacts.check()
    if not study.is_durable:
        return
    if not saves:
        fix = "give save and load functions, or make the study without storage"
    elif study.artifacts is None:
        fix = "its database is no file, so give artifacts=<a folder or URL> where the study is made"
    else:
        return
    words = f"this study is stored, but its policies will be in memory only: {fix}"
    warnings.warn(words, UnsavedPolicies, stacklevel=4)


def _announce_others(study: Study, announce: Callable[..., None]) -> None:
    """A second process joins on purpose or by mistake; people should know which."""
    others = ask.others(study.refresh(), study.watch(), study.worker)
    if others:
        works = "works" if len(others) == 1 else "work"
        words = f"{', '.join(others)} {works} on this study, too: joining, each trains other picks"
        announce("on_note", words)


def _announce_lost(study: Study, announce: Callable[..., None]) -> bool:
    """Whether policies are not where they were: a mistyped place must not be found at the end."""
    store, kept = study.artifacts, _kept(study)
    last = max(kept, default=None)
    if store is None or last is None or store.receipt(kept[last][0]) is not None:
        return False
    where = store.root if isinstance(store, FolderStore) else store.url
    announce(
        "on_note",
        f"the policy of training {last + 1} is not in {where}: nothing can begin with it, nor is "
        "it evaluated again; is artifacts (--artifacts) what it was?",
    )
    return True


def _kept(study: Study) -> dict[int, tuple[str, str]]:
    """Place and hash of the policies that a run has kept, by their rows."""
    rows = enumerate(study.state.rows)
    return {i: (row.policy, row.sha256) for i, row in rows if row.policy and row.sha256}


def _check_kept(study: Study) -> None:
    """Before anything is paid: without the policies told so far there is no portfolio after all.

    Only those in a folder: to read an object store takes long, and costs.

    Raises:
        StorageError: files of one have changed.
    """
    store = study.artifacts
    if isinstance(store, FolderStore):
        for place, sha256 in _kept(study).values():
            store.read(place, sha256)


def _announce_dear_rows(study: Study, announce: Callable[..., None]) -> None:
    """Before the first pick, where most of the budget would go to evaluations."""
    state = study.state
    if state.spec.steps is None or state.picks or state.row_steps <= state.unit_steps:
        return
    on, row = state.spec.eval_targets or study.space.n, counted(state.row_steps)
    announce(
        "on_note",
        f"a policy's evaluation on {on} contexts may cost {row} steps, a training costs "
        f"{counted(state.unit_steps)}: for more trainings, evaluate on fewer contexts, with "
        "evaluation=mbtl.Evaluation(n) (--eval-targets n)",
    )


def _check_can_travel(executor: Executor | None, trainer: Trainer) -> None:
    if isinstance(executor, (ProcessPoolExecutor, SeparateWorkers)):
        try:
            pickle.dumps(trainer)
        except Exception as error:
            raise InvalidInput(
                "training in other processes needs functions of a module that they can import, got "
                f"one that cannot be sent ({error}); move it to a module, or use Workers(1)"
            ) from error


def _play(
    study: Study,
    trainer: Trainer,
    plan: ReportPlan,
    baselines: Mapping[str, Any],
    announce: Callable[..., None],
    limit: Callable[[], AbstractContextManager[None]],
) -> None:
    """Evaluate what the plan says on fresh seeds, and record it.

    Args:
        study: that the plan is of.
        trainer: reads and evaluates the policies.
        plan: see `plan_of`.
        baselines: what is played beside them, by name.
        announce: tells people.
        limit: of the time for each policy.
    """
    rows, portfolio, n = len(study.state.rows), study.portfolio(trainer), study.space.n
    names = tuple(study.beside.metrics)

    def play(policy: Any, targets: Indices, *, own: bool = True) -> tuple[Array, Array]:
        """(N, E) returns, (measures, N) means; of a policy of the study or of a baseline.

        NaN where an episode does not count, or none is to be played.
        """
        contexts = [study.space.context(int(t)) for t in targets]
        seeds = study.evaluation_seeds(targets, Purpose.REPORT)
        told: Mapping[str, Array] = {}
        with limit():
            if isinstance(trainer, MeasuringTrainer) and (names or not own):
                told = trainer.measure(policy, contexts, seeds, names)
                returns = told[SCORE]
            else:
                returns = trainer.evaluate(policy, contexts, seeds)
        named = study.space.named(targets)
        each = checked_returns(returns, targets.size, named, gaps=own)
        found, means = np.full((n, each.shape[1]), np.nan), np.full((len(names), n), np.nan)
        found[targets] = each
        for mean, name in zip(means, names, strict=True):
            if name in told:
                mean[targets] = np.asarray(told[name]).mean(axis=1)
        return found, means

    found = {i: play(portfolio.policy(i), plan.targets(i)) for i in plan.policies}
    episodes = min(returns.shape[1] for returns, _ in found.values())
    served, own_means = np.full((n, episodes), np.nan), np.full((len(names), n), np.nan)
    for i, (returns, means) in found.items():
        mine = plan.route == i
        served[mine], own_means[:, mine] = returns[mine, :episodes], means[:, mine]
    there = np.asarray(np.isfinite(served).any(axis=1))
    others: dict[str, tuple[Array, Array]] = {}
    for name, policy in baselines.items():
        try:
            theirs = play(policy, plan.contexts, own=False)
            completed(theirs[0][there])  # where the policies played
            others[name] = theirs
        except FAULTS as error:  # V must not be lost by it
            announce("on_note", f"{name!r} could not be compared: {reason_of(error)}")
    episodes = min([episodes, *(returns.shape[1] for returns, _ in others.values())])
    served = served[:, :episodes]  # as many of each, so that luck cancels
    there = np.asarray(np.isfinite(served).any(axis=1))
    lost = plan.contexts[~there[plan.contexts]]
    if lost.size == plan.contexts.size:
        raise TrainingFailed(f"no fresh episode counts, got NaN in all of {lost.size} contexts")
    if lost.size:
        words = f"{lost.size} of {plan.contexts.size} contexts had no fresh episode that counts"
        announce("on_note", f"{words}: of these V is as believed")
    if missing := [n for n, told in zip(names, own_means, strict=True) if np.isnan(told).all()]:
        announce("on_note", f"no episode told the metrics {', '.join(missing)}; mind their names")
    study.record_fresh_returns(
        served,
        found[plan.best_single][0][:, :episodes],
        best_single=plan.best_single,
        baselines={name: returns[:, :episodes] for name, (returns, _) in others.items()},
        metrics=np.array([own_means, *(m for _, m in others.values())]) if names else None,
        rows=rows,
        lost=lost.tolist(),
    )


def _baselines(study: Study, trainer: Trainer) -> dict[str, Any]:
    """What V is compared with, by name: what the system can do by itself, and the user's own.

    Random actions where there is neither, so that it is said whether training is worth it.

    Raises:
        UnknownName: the user's own is a name that the system does not know.
    """
    ways: tuple[str, ...] = ()  # where the trainer does not know how it goes without a policy
    if isinstance(trainer, MeasuringTrainer):
        ways = trainer.ways([study.space.context(0)])
    for one in study.beside.baselines.values():
        if ways and isinstance(one, str):  # functions take anything for a policy
            check_known("baseline of this system", one, ways)
    found: dict[str, Any] = {way: way for way in ways if way != RANDOM_ACTIONS}
    found |= study.beside.baselines
    if ways and not found:
        found = {"random actions": RANDOM_ACTIONS}
    return found
