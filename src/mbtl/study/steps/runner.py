"""The runner joins a study that is paid in steps, its strategy and a trainer, until all is spent.

Every decision is in the log before it is carried out, and every piece of work after it: of a
training each mark, with its policy and the state to go on from. So a kill loses no more than the
piece under way, and where the trainer saves its state now and then, seconds of it. What is done
twice for that is charged once.
"""

from __future__ import annotations

import shutil
import time
import traceback
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mbtl.actions import Action, Evaluate, Extend, Policy, Start, StartOn, Stop
from mbtl.actions.base import middle_of
from mbtl.actions.evaluation import LEAST, WHERE_IT_MATTERS, target_price
from mbtl.errors import (
    InvalidInput,
    MissingExtra,
    StorageError,
    StudyMismatch,
    TrainingFailed,
)
from mbtl.seeds import evaluation_seed, selection_rng, training_seed
from mbtl.selectors.targets import spread_targets
from mbtl.set_trainer import SetTrainer
from mbtl.settings import first_difference
from mbtl.study.steps.callbacks import StepCallback
from mbtl.study.steps.evaluation import evaluated, report_fresh, weights_of
from mbtl.study.steps.state import Work, record_of
from mbtl.study.steps.summary import StepResult, verdict_of
from mbtl.trainer import (
    Progress,
    Reached,
    SteppingTrainer,
    Trainer,
    recipe_of,
)

if TYPE_CHECKING:
    from mbtl.study.steps.study import StepStudy

_SPENT = "the budget of {:,} steps is spent"
_NO_MORE = "the strategy says that nothing more is worth its steps"
_FEWEST = 2
"""Targets on which a policy is still evaluated with the last steps."""


def run(
    study: StepStudy,
    trainer: Trainer,
    *,
    callbacks: Sequence[StepCallback] = (),
    report: bool = True,
    stop_after_failures: int = 3,
) -> StepResult:
    """Spend the steps of a study; see `StepStudy.run`."""
    _check(study, trainer)
    began = time.monotonic()
    worker = _Worker(study, trainer, callbacks, stop_after_failures)
    try:
        while study.refresh().stopped is None:
            action = study.state.pending or worker.decide()
            if action is not None:
                worker.carry_out(action)
        if report and study.state.policies and study.state.fresh is None:
            for callback in callbacks:
                callback.on_report(study)
            report_fresh(study, worker.evaluator)
    finally:
        for callback in callbacks:
            callback.on_end(study)
    return StepResult(study, study.summary(), time.monotonic() - began)


class _Worker:
    """Decides and does, one action after another."""

    def __init__(
        self,
        study: StepStudy,
        trainer: Trainer,
        callbacks: Sequence[StepCallback],
        stop_after_failures: int,
    ) -> None:
        self.study, self.trainer, self.callbacks = study, trainer, callbacks
        self.evaluator = with_episodes(trainer, study.spec.episodes)
        self.most = stop_after_failures

    # ---- deciding ----------------------------------------------------------------------------

    def decide(self) -> Work | None:
        """The next action, in the log; None: there is none, which is in the log, too."""
        study, state = self.study, self.study.state
        spec, trail = study.spec, study.trail
        problem = spec.problem_without(tuple(state.dead), on_sets=not state.dead_on_sets)
        began = time.perf_counter()
        action: Action
        if state.halted:
            rule = getattr(study.strategy, "evaluation", WHERE_IT_MATTERS)
            action = rule.next(problem, trail) or Stop()
        else:
            rng = selection_rng(spec.seed, spec.trial, state.decisions)
            action = study.strategy.decide(problem, trail, rng)
        seconds = time.perf_counter() - began
        spent = state.halted
        if isinstance(action, Evaluate):
            affordable = self._affordable(action)
            spent |= affordable is None
            action = affordable or Stop()
        if isinstance(action, Stop):
            found = verdict_of(study)
            reason = _SPENT.format(spec.budget) if spent else found or _NO_MORE
            study.append("stopped", {"reason": reason})
            return None
        if isinstance(action, Start) and action.start is not None:
            self._check_start(action.start)
        record = {"number": state.decisions, "action": record_of(action), "seconds": seconds}
        study.append("decided", record)
        return action

    def _check_start(self, start: Policy) -> None:
        if not _begins_from_others(self.trainer):
            raise _no_start(self.study.strategy.name)
        trainings = self.study.state.trainings
        known = 0 <= start.training < len(trainings)
        if not known or not 0 <= start.length <= trainings[start.training].length:
            raise InvalidInput(
                f"a training begins with the weights of a mark that a training has passed, got "
                f"{start}; the strategy must choose another one"
            )

    def _affordable(self, action: Evaluate) -> Evaluate | None:
        """The evaluation, on as many targets as there are steps for; None: on too few."""
        study, problem = self.study, self.study.spec.problem_without(())
        trail = study.trail
        price = target_price(problem, trail)
        targets = list(action.targets)
        if action.policy in trail.policies:
            row = trail.rows[trail.policies.index(action.policy)]
            targets = [t for t in targets if not np.isfinite(row[t])]
        count = int(self._left // price)
        if count >= len(targets):
            return Evaluate(action.policy, tuple(targets)) if targets else None
        if count < _FEWEST or action.policy in trail.policies:
            return None
        source = trail.trainings[action.policy.training].source
        return Evaluate(action.policy, spread_targets(problem.selection, source, count))

    @property
    def _left(self) -> float:
        return self.study.spec.budget - self.study.state.spent

    # ---- doing -------------------------------------------------------------------------------

    def carry_out(self, action: Work) -> None:
        """Do it, or what is left of it."""
        if isinstance(action, Evaluate):
            self._evaluate(action.policy, action.targets)
        else:
            self._train(action)

    def _train(self, action: Start | StartOn | Extend) -> None:
        """Mark by mark, while there are steps for it and for an evaluation afterwards."""
        study, state = self.study, self.study.state
        number = state.number_of(action)
        source, on = self._where(action, number)
        self._tell("on_training", number, source, state.lengths_of(number)[action.length])
        while study.state.pending is not None:
            mark = study.state.reached(number) + 1
            if isinstance(action, StartOn):
                mark = action.length  # its first mark: the learning rate falls to zero there
            if not self._fits(number, mark):
                study.append("halted", {"training": number})
                self._tell("on_trained", number)
                return
            began, progress = time.monotonic(), _Latest(self, number)
            try:
                reached = self._piece(number, source, on, mark, progress)
                artifact = self._keep(number, source, on, mark, reached)
            except (StorageError, InvalidInput, MissingExtra):
                raise
            except Exception as error:
                done = study.state.trainings[number].steps if mark else 0
                self._failed(error, max(progress.steps - done, 0), number, source)
                self._tell("on_trained", number)
                return
            study.append(
                "trained",
                {"training": number, "source": source, "mark": mark, "steps": reached.steps,
                 "checks": reached.checks, "ended": reached.ended,
                 "seconds": time.monotonic() - began, **artifact},
            )  # fmt: skip
            self._tell("on_trained", number)
        self._forget(number)

    def _where(self, action: Start | StartOn | Extend, number: int) -> tuple[int, tuple[int, ...]]:
        """The context of a training and, of one on several, those; then it is the middle one."""
        study = self.study
        if isinstance(action, Extend) or number < len(study.state.trainings):
            course = study.state.trainings[number]
            return course.source, course.on
        if isinstance(action, StartOn):
            return middle_of(action.sources, study.space.steps), action.sources
        return action.source, ()

    def _fits(self, number: int, mark: int) -> bool:
        spec, state = self.study.spec, self.study.state
        done = state.trainings[number].steps if number < len(state.trainings) else 0
        problem = spec.problem_without(())
        targets = min(LEAST, problem.n)
        after = targets * target_price(problem, self.study.trail)
        return state.lengths_of(number)[mark] - done + after <= self._left

    def _piece(
        self, number: int, source: int, on: tuple[int, ...], mark: int, progress: _Latest
    ) -> Reached:
        """A training to a mark, from where it is."""
        study, spec = self.study, self.study.spec
        state = study.state
        known = number < len(state.trainings)
        begun = state.start_of(number)
        repeat = state.trainings[number].repeat if known else state.repeats(source, on=bool(on))
        marks = state.lengths_of(number)
        if on:
            assert isinstance(self.trainer, SetTrainer)
            # sources are 0..N-1, so this seed is none of theirs
            seed = training_seed(spec.seed, spec.trial, spec.space.n, repeat)
            contexts = [spec.space.context(i) for i in on]
            first = min(state.trainings[number].marks) if known else mark
            return self.trainer.train_on_steps(
                contexts, seed, marks[mark], marks=marks[first:], saved=self._file(number),
                on_progress=progress,
            )  # fmt: skip
        seed = training_seed(spec.seed, spec.trial, source, repeat)
        context, steps = spec.space.context(source), marks[mark]
        if not isinstance(self.trainer, SteppingTrainer):
            return Reached(self.trainer.train(context, seed, progress), steps)
        saved = self._file(number) if len(spec.lengths) > 1 else None
        # also of one that goes on: where its state is lost, it is trained again from there
        start = None if begun is None else weights_of(study, self.trainer, begun)
        return self.trainer.train_steps(
            context, seed, steps, start=start, saved=saved, on_progress=progress
        )

    def _file(self, number: int) -> Path:
        """Of the state of a training."""
        study = self.study
        name = f"policies/{study.state.uid}/training-{number + 1:04d}"
        kept = None if study.artifacts is None else study.artifacts.partial(name)
        if kept is not None:
            return kept
        return study.scratch / f"training-{number + 1:04d}.partial"

    def _forget(self, number: int) -> None:
        """The state of a training that cannot go on any more."""
        course = self.study.state.trainings[number]
        whole = course.length == len(self.study.spec.lengths) - 1 and not course.on
        if course.ended or whole:
            file = self._file(number)
            shutil.rmtree(file, ignore_errors=True)  # of plain functions it is a folder
            file.unlink(missing_ok=True)

    def _keep(
        self, number: int, source: int, on: tuple[int, ...], mark: int, reached: Reached
    ) -> dict[str, Any]:
        """Where the policy is, as the log says it."""
        study = self.study
        artifact = None
        if study.artifacts is not None and getattr(self.trainer, "saves", True):
            place = f"policies/{study.state.uid}/training-{number + 1:04d}-mark-{mark}"
            where = {"contexts": list(on)} if on else {"context": dict(study.space.context(source))}
            receipt = {**where, "steps": reached.steps}
            if (begun := study.state.start_of(number)) is not None:
                receipt["start"] = {"training": begun.training + 1, "mark": study.key(begun)[1]}
            artifact = study.artifacts.write(
                place, lambda folder: self.trainer.save(reached.policy, folder), receipt
            )
        if artifact is None:
            study.policies[number, mark] = reached.policy
            return {"policy": None, "sha256": None}
        return {"policy": artifact.place, "sha256": artifact.sha256}

    def _evaluate(self, policy: Policy, targets: Sequence[int]) -> None:
        study, spec = self.study, self.study.spec
        self._tell("on_evaluation", policy, targets)
        began = time.monotonic()
        try:
            seed = evaluation_seed(spec.seed, spec.trial)
            found, steps = evaluated(study, self.evaluator, policy, targets, seed)
        except (StorageError, InvalidInput, MissingExtra):
            raise
        except Exception as error:
            source = study.state.trainings[policy.training].source
            study.append("failed", _trouble(error, 0, source))
            self._check_failures(error)
            return
        study.append(
            "evaluated",
            {"training": policy.training, "length": policy.length, "targets": list(targets),
             "episodes": found.shape[1], "steps": float(steps.sum()),
             "seconds": time.monotonic() - began},
            {"returns": found.mean(axis=1)},
        )  # fmt: skip
        self._tell("on_evaluated", policy)

    # ---- failures ----------------------------------------------------------------------------

    def _failed(self, error: Exception, steps: float, number: int, source: int) -> None:
        self.study.append("failed", _trouble(error, steps, source))
        self._check_failures(error)

    def _check_failures(self, error: Exception) -> None:
        failures = self.study.state.failures
        if len(failures) >= self.most:
            raise TrainingFailed(
                f"{len(failures)} trainings or evaluations in a row failed, the last with "
                f"{failures[-1]}; mend the cause and run again"
            ) from error

    def _tell(self, what: str, *about: Any) -> None:
        for callback in self.callbacks:
            getattr(callback, what)(self.study, *about)


class _Latest:
    """Passes reports of a training on, and keeps the number of steps."""

    def __init__(self, worker: _Worker, training: int) -> None:
        self._worker, self._training, self.steps = worker, training, 0

    def __call__(self, progress: Progress) -> None:
        self.steps = progress.step if progress.unit == "steps" else self.steps
        self._worker._tell("on_progress", self._training, progress)


def with_episodes(trainer: Trainer, episodes: int) -> Trainer:
    """The trainer with so many episodes per target, where it can be told."""
    record: Any = trainer
    if getattr(trainer, "eval_episodes", episodes) == episodes:
        return trainer
    changed: Trainer = replace(record, eval_episodes=episodes)
    return changed


def _trouble(error: Exception, steps: float, source: int) -> dict[str, Any]:
    text = "".join(traceback.format_exception(error))
    reason = f"{type(error).__name__}: {error}"
    return {"reason": reason, "steps": float(steps), "source": source, "traceback": text[-4000:]}


def _begins_from_others(trainer: Trainer) -> bool:
    return isinstance(trainer, SteppingTrainer) and bool(getattr(trainer, "begins_from", True))


def _no_start(strategy: str) -> InvalidInput:
    return InvalidInput(
        f"the strategy {strategy!r} begins trainings with the weights of others, and this train "
        "function takes none; give it the arguments `steps` and `start`, or choose another "
        "strategy, such as 'pilot'"
    )


def _check(study: StepStudy, trainer: Trainer) -> None:
    """Refuse, before anything is spent, a trainer that cannot do what will be asked."""
    spec = study.spec
    if not isinstance(trainer, SteppingTrainer):
        if len(spec.lengths) > 1:
            raise InvalidInput(
                f"the length of a training cannot be chosen with {type(trainer).__name__}, got "
                f"{len(spec.lengths)} lengths; give a train function that takes `steps` and "
                "`start` (docs/spending.md), or make the study with lengths=[<one>]"
            )
    elif trainer.whole_steps is None:
        raise InvalidInput(
            "only trainings that are counted in steps can be paid in steps, got a trainer that "
            "counts episodes; make the study without cost='steps'"
        )
    elif isinstance(trainer.whole_steps, int) and trainer.whole_steps < spec.lengths[-1]:
        raise InvalidInput(
            f"the last length is that of a whole training, got {spec.lengths[-1]:,} where the "
            f"trainer has {trainer.whole_steps:,}; use the same trainer"
        )
    if getattr(study.strategy, "trains_on_all", False):
        if not isinstance(trainer, SetTrainer):
            raise InvalidInput(
                f"the strategy {study.strategy.name!r} trains one policy on all contexts, and "
                f"{type(trainer).__name__} trains on one at a time; give a function "
                "train_on(contexts, seed, steps, start=None), or choose another strategy, such as "
                "'pilot'"
            )
        trainer.check_on_set()
    if getattr(study.strategy, "starts_warm", False) and not _begins_from_others(trainer):
        raise _no_start(study.strategy.name)
    known = spec.settings.get("recipe")
    if known is not None and (found := first_difference(known, recipe_of(trainer))):
        raise StudyMismatch(
            f"a study is run with the recipe it was made with: {found[0]} was {found[1]!r}, got "
            f"{found[2]!r}; use the same trainer, or start another study"
        )
    if study.is_durable and not getattr(trainer, "saves", True):
        raise InvalidInput(
            "a study that is stored goes on from saved policies, got a trainer that saves none; "
            "give save and load functions, or leave storage out"
        )
