"""The runner joins a study that is paid in steps, its strategy and a trainer, until all is spent.

Several runs of one study are workers of it: each carries out one action at a time (`claims`).

Every decision is in the log before it is carried out, and every piece of work after it: of a
training each mark, with its policy and the state to go on from. So a kill loses no more than the
piece under way, and where the trainer saves its state now and then, seconds of it. What is done
twice for that is charged once.
"""

from __future__ import annotations

import contextlib
import shutil
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mbtl.actions import Action, Evaluate, Extend, Policy, Start, StartOn, Stop, Wait
from mbtl.actions.base import middle_of
from mbtl.actions.evaluation import WHERE_IT_MATTERS, Evaluation, target_price
from mbtl.errors import InvalidInput, MissingExtra, StorageError, TrainingFailed
from mbtl.faults import FAULTS, reason_of
from mbtl.seeds import selection_rng, training_seed
from mbtl.selectors.targets import spread_targets
from mbtl.study.limits import at_most, check_limits
from mbtl.study.steps.callbacks import StepCallback
from mbtl.study.steps.checks import check_start, check_trainer, with_episodes
from mbtl.study.steps.claims import LEASE, Claim, Claims, Lost
from mbtl.study.steps.evaluation import evaluated, report_fresh, weights_of
from mbtl.study.steps.prices import in_units, next_mark, price_of
from mbtl.study.steps.record import Work, failure
from mbtl.study.steps.state import UnderWay
from mbtl.study.steps.summary import StepResult, verdict_of
from mbtl.study.storage import Conflict
from mbtl.trainer import Progress, Trained, Trainer

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
    lease: float = LEASE,
    wait: bool = True,
    accept_changes: bool = False,
    timeout: float | None = None,
) -> StepResult:
    """Spend the steps of a study; see `StepStudy.run`."""
    check_trainer(study, trainer, accept_changes=accept_changes)
    check_limits(lease, timeout)
    began = time.monotonic()
    try:
        with Claims(study, lease) as claims:
            worker = _Worker(study, trainer, callbacks, stop_after_failures, claims, timeout)
            worker.work(wait=wait)
        done = study.state.stopped is not None and study.state.policies
        if report and done and study.state.fresh is None:
            for callback in callbacks:
                callback.on_report(study)
            try:
                report_fresh(study, worker.evaluator)
            except SystemExit as error:
                raise TrainingFailed(
                    f"the evaluation on fresh episodes failed: {reason_of(error)}"
                ) from error
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
        claims: Claims,
        timeout: float | None,
    ) -> None:
        self.study, self.trainer, self.callbacks = study, trainer, callbacks
        self.evaluator = with_episodes(trainer, study.spec.episodes)
        self.most = stop_after_failures
        self.claims, self.timeout = claims, timeout
        self._doing: int | None = None
        self._latest: Policy | None = None
        """The policy that this worker has evaluated last, while it may go on with that."""

    def work(self, *, wait: bool) -> None:
        """One action after another, until the study is finished, or others have the last ones."""
        waiting = False
        while self.study.refresh().stopped is None:
            seq = self.study.state.seq
            claim = self.claims.abandoned() or self._decide()
            if claim is not None:
                waiting = False
                self.claims.work_again()
                self._carry_out(claim)
            elif self.study.state.seq > seq:
                continue  # others were faster, or the study was stopped
            elif self.study.state.under_way:
                if not wait:
                    return
                if not waiting:
                    waiting = True
                    self._tell("on_waiting")
                self.claims.wait()

    # ---- deciding ----------------------------------------------------------------------------

    def _decide(self) -> Claim | None:
        """The next action, in the log; None: there is none now, or others were faster."""
        study, state = self.study, self.study.state
        spec, seq, others = study.spec, state.seq, bool(state.under_way)
        if others and not getattr(study.strategy, "in_parallel", False):
            return None
        trail = study.trail
        problem = spec.problem_without(tuple(state.dead), on_sets=not state.dead_on_sets)
        began = time.perf_counter()
        action: Action
        rule: Evaluation = getattr(study.strategy, "evaluation", WHERE_IT_MATTERS)
        further = rule.more(problem, trail, self._latest) if self._latest else None
        if further is not None:
            action = further
        elif state.halted:
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
        if isinstance(action, Wait) and not others:
            raise InvalidInput(
                f"a strategy may wait only while something is under way, got {action} of "
                f"{study.strategy.name!r}; give another action"
            )
        if further is None:
            self._latest = None
        if isinstance(action, (Wait, Stop)):
            if not others:
                found = verdict_of(study)
                reason = _SPENT.format(spec.budget) if spent else found or _NO_MORE
                with contextlib.suppress(Conflict):
                    study.append("stopped", {"reason": reason}, after=seq)
            return None
        if isinstance(action, Start) and action.start is not None:
            check_start(study, self.trainer, action.start)
        if others and not self._is_paid(action):
            return None  # others may end early, or leave so much that this is the last training
        return self.claims.decided(action, seconds, seq, self._is_paid)

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

    def _is_paid(self, action: Work) -> bool:
        """Whether the steps for an action are there, beside what others are at."""
        if isinstance(action, Evaluate):
            return self._affordable(action) == action
        training = action.training if isinstance(action, Extend) else None
        return self._has_room(UnderWay(action, training))

    @property
    def _left(self) -> float:
        """Steps that nobody has spent, and others are not just spending."""
        state = self.study.state
        theirs = sum(
            price_of(self.study, held) for n, held in state.under_way.items() if n != self._doing
        )
        return self.study.spec.budget - state.spent - theirs

    def _has_room(self, held: UnderWay) -> bool:
        """Whether its next piece, and an evaluation afterwards, can be paid."""
        return price_of(self.study, held) <= self._left

    # ---- doing -------------------------------------------------------------------------------

    def _carry_out(self, claim: Claim) -> None:
        """Do it, or what is left of it; another worker may take it over meanwhile."""
        self._doing = claim.number
        try:
            work = self.claims.held(claim).work
            if isinstance(work, Evaluate):
                self._evaluate(claim, work.policy, work.targets)
            else:
                self._train(claim, work)
        except Lost:
            self.claims.drop(claim)
        except BaseException:
            self.claims.give_back(claim)
            raise
        finally:
            self._doing = None

    def _train(self, claim: Claim, action: Start | StartOn | Extend) -> None:
        """Mark by mark, while there are steps for it and for an evaluation afterwards."""
        study, claims = self.study, self.claims
        held = claims.held(claim)
        number = study.state.number_of(held)
        source, _ = self._where(held)
        self._tell("on_training", number, source, study.state.marks_of(held)[action.length])
        while claims.is_open(claim):
            held = claims.held(claim)
            mark = next_mark(study.state, held)
            if not self._has_room(held):
                claims.answer(claim, "halted", {})
                self._tell("on_trained", number)
                return
            began, progress = time.monotonic(), _Latest(self, claim, number)
            try:
                with at_most(self.timeout):
                    reached = self._piece(claim, held, mark, progress)
                artifact = self._keep(claim, held, mark, reached)
            except (StorageError, InvalidInput, MissingExtra, Lost):
                raise
            except FAULTS as error:
                done = 0 if held.training is None else study.state.trainings[held.training].steps
                self._failed(claim, error, max(progress.steps - done, 0), source)
                self._tell("on_trained", number)
                return
            claims.answer(
                claim,
                "trained",
                {"source": source, "mark": mark, "steps": reached.steps,
                 "checks": reached.checks, "ended": reached.ended,
                 "seconds": time.monotonic() - began, **artifact},
            )  # fmt: skip
            if held.training is None:
                number = next(j for j, t in enumerate(study.state.trainings)
                              if t.decision == claim.number)  # fmt: skip
            if artifact["policy"] is None:
                study.policies[number, mark] = reached.policy
            self._tell("on_trained", number)
        self._forget(number)

    def _where(self, held: UnderWay) -> tuple[int, tuple[int, ...]]:
        """The context of a training and, of one on several, those; then it is the middle one."""
        if held.training is not None:
            course = self.study.state.trainings[held.training]
            return course.source, course.on
        if isinstance(held.work, StartOn):
            return middle_of(held.work.sources, self.study.space.steps), held.work.sources
        assert isinstance(held.work, Start)
        return held.work.source, ()

    def _piece(self, claim: Claim, held: UnderWay, mark: int, progress: _Latest) -> Trained:
        """A training to a mark, from where it is: from its state, or from its latest policy."""
        study, spec, state, trainer = self.study, self.study.spec, self.study.state, self.trainer
        source, on = self._where(held)
        known = None if held.training is None else state.trainings[held.training]
        repeat = state.repeats(source, on=bool(on)) if known is None else known.repeat
        # sources are 0..N-1, so the seed of a set is none of theirs
        seed = training_seed(spec.seed, spec.trial, spec.space.n if on else source, repeat)
        contexts, marks = [spec.space.context(i) for i in on or (source,)], state.marks_of(held)
        begun, asked = state.start_of(held), dict[str, Any]()
        if "length" in trainer.takes:
            units = [in_units(one, trainer, spec, on_many=bool(on)) for one in marks]
            first = mark if known is None else min(known.marks)
            asked = {"length": units[mark], "marks": units[first:] if on else ()}
            if "state" in trainer.takes:
                # where that is lost, it is trained again from where it began
                asked["state"] = self._file(self._called(claim, held))
            elif held.training is not None and "start" in trainer.takes:
                latest = state.reached(held.training)
                begun, asked["done"] = Policy(held.training, latest), units[latest]
        start = None if begun is None else weights_of(study, trainer, begun)
        found = trainer.train(contexts, seed, start=start, on_progress=progress, **asked)
        return replace(found, steps=marks[mark]) if found.steps is None else found

    def _called(self, claim: Claim, held: UnderWay) -> str:
        """The name of a training's files: by the decision that began it, which never changes."""
        known = held.training is not None
        began = self.study.state.trainings[held.training or 0].decision if known else claim.number
        return f"training-{began + 1:04d}"

    def _file(self, called: str) -> Path:
        """Of the state of a training."""
        study = self.study
        name = f"policies/{study.state.uid}/{called}"
        kept = None if study.artifacts is None else study.artifacts.partial(name)
        return kept if kept is not None else study.scratch / f"{called}.partial"

    def _forget(self, number: int) -> None:
        """The state of a training that cannot go on any more."""
        course = self.study.state.trainings[number]
        whole = course.length == len(self.study.spec.lengths) - 1 and not course.on
        if course.ended or whole:
            file = self._file(f"training-{course.decision + 1:04d}")
            shutil.rmtree(file, ignore_errors=True)  # a trainer may make it a folder
            file.unlink(missing_ok=True)

    def _keep(self, claim: Claim, held: UnderWay, mark: int, reached: Trained) -> dict[str, Any]:
        """Where the policy is, as the log says it; None: in memory only."""
        study, (source, on) = self.study, self._where(held)
        artifact = None
        if study.artifacts is not None and getattr(self.trainer, "saves", True):
            called = self._called(claim, held)  # and by the lease, so that nobody else writes there
            end = f"-{claim.token}" if claim.token else ""
            place = f"policies/{study.state.uid}/{called}-mark-{mark}{end}"
            where = {"contexts": list(on)} if on else {"context": dict(study.space.context(source))}
            receipt: dict[str, Any] = {**where, "steps": reached.steps}
            if (begun := study.state.start_of(held)) is not None:
                receipt["start"] = {"training": begun.training + 1, "mark": study.key(begun)[1]}
            artifact = study.artifacts.write(
                place, lambda folder: self.trainer.save(reached.policy, folder), receipt
            )
        if artifact is None:
            return {"policy": None, "sha256": None}
        return {"policy": artifact.place, "sha256": artifact.sha256}

    def _evaluate(self, claim: Claim, policy: Policy, targets: Sequence[int]) -> None:
        study = self.study
        self._tell("on_evaluation", policy, targets)
        began = time.monotonic()
        try:
            with at_most(self.timeout):
                found, steps = evaluated(study, self.evaluator, policy, targets)
        except (StorageError, InvalidInput, MissingExtra):
            raise
        except FAULTS as error:
            source = study.state.trainings[policy.training].source
            self._failed(claim, error, 0, source)
            return
        self.claims.answer(
            claim,
            "evaluated",
            {"training": policy.training, "length": policy.length, "targets": list(targets),
             "episodes": found.shape[1], "steps": float(steps.sum()),
             "seconds": time.monotonic() - began},
            {"returns": found.mean(axis=1)},
        )  # fmt: skip
        parallel = getattr(study.strategy, "in_parallel", False)
        self._latest = policy if parallel and hasattr(study.strategy, "evaluation") else None
        self._tell("on_evaluated", policy)

    # ---- failures ----------------------------------------------------------------------------

    def _failed(self, claim: Claim, error: BaseException, steps: float, source: int) -> None:
        self.claims.answer(claim, "failed", failure(error, steps, source))
        self._check_failures(error)

    def _check_failures(self, error: BaseException) -> None:
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

    def __init__(self, worker: _Worker, claim: Claim, training: int) -> None:
        self._worker, self._claim, self._training = worker, claim, training
        self.steps = 0

    def __call__(self, progress: Progress) -> None:
        self.steps = progress.step if progress.unit == "steps" else self.steps
        self._worker.claims.said(self._claim, progress)
        self._worker._tell("on_progress", self._training, progress)
