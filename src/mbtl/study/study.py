"""The study: ask for the next source, tell its transfer row, repeat.

It decides; it trains nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from mbtl.errors import InvalidInput, StudyError, StudyMismatch
from mbtl.plain import finite, whole
from mbtl.seeds import Purpose, evaluation_seeds
from mbtl.settings import first_difference
from mbtl.study import telling
from mbtl.study.artifacts import Artifact
from mbtl.study.described import changed_code, code_mismatch
from mbtl.study.events import Event, Kind
from mbtl.study.leasing import LeasingStudy
from mbtl.study.pick import Pick
from mbtl.study.records import ToldRow
from mbtl.study.state import StudyState
from mbtl.trainer import (
    FunctionTrainer,
    Trainer,
    checked_returns,
    checked_targets,
    code_of,
    equipment_of,
    recipe_digest,
)

if TYPE_CHECKING:
    from mbtl.study.callbacks import Callback
    from mbtl.study.result import RunResult


class Study(LeasingStudy):
    """One selection run over an event log. Make one with `create_study` or `load_study`."""

    def tell(
        self,
        pick: Pick | int | Mapping[str, Any],
        returns: ArrayLike,
        *,
        targets: Sequence[int] | None = None,
        cost: float | None = None,
        seconds: float | None = None,
        steps: float | None = None,
        policy: str | Artifact | None = None,
        policy_object: Any = None,
    ) -> bool:
        """Record the transfer row of one trained policy.

        Args:
            pick: what `ask` gave, or the context (or its index) of a policy you already have; rows
                that nobody asked for do not count towards the budget.
            returns: (T,) or (T, n_episodes) undiscounted returns on the targets, raw units. NaN is
                an episode that has none, and counts as not played.
            targets: T indices of the contexts evaluated on; None: those that the pick asks for,
                which are all N unless the study was made with `eval_targets`.
            cost: cost of the training, in the unit of the cost budget; None: what `costs` says of
                the source, or 1; 0 for a row that nobody asked for.
            seconds: wall time of training and evaluation.
            steps: environment steps of the training.
            policy: folder of the saved policy, relative to the study's folder; as an `Artifact`
                with its hash, which is then checked whenever it is read.
            policy_object: the policy itself, kept in this process only.

        Returns:
            True: recorded. False: too late, because somebody took the pick over meanwhile; the
            returns are in the log, and count for nothing.

        Raises:
            TrainingFailed: returns of wrong shape, all NaN, or beyond 1e30. Nothing is recorded;
                tell again, or record it with `fail`.
            InvalidInput: `policy` leads out of the study's folder, or another fact is not what it
                should be. Nothing is recorded.
            StudyError: the pick was answered before, or is another study's.
        """
        source = telling.source_of(self.space, pick)
        price = finite("cost", cost, 0.0)
        usual = 1.0 if self.spec.costs is None else self.spec.costs[source]
        if targets is None and isinstance(pick, Pick):
            targets = pick.targets
        elif targets is None:
            with self._lock:
                targets = telling.asked_targets(self.refresh(), source)
        evaluated = checked_targets(targets, self.space.n)
        rows = checked_returns(returns, len(evaluated), self.space.named(evaluated))
        arrays = {"returns": np.full((self.space.n, rows.shape[1]), np.nan)}
        arrays["returns"][evaluated] = rows
        data: dict[str, Any] = {
            "source": source,
            "episodes": rows.shape[1],
            "seconds": finite("seconds", seconds, 0.0),
            "steps": finite("steps", steps, 0.0),
            "policy": policy.place if isinstance(policy, Artifact) else policy,
            "sha256": policy.sha256 if isinstance(policy, Artifact) else None,
        }
        if isinstance(pick, Pick) and pick.token:
            data["token"] = pick.token
        place = 0

        def told(state: StudyState) -> Event:
            nonlocal place
            if isinstance(pick, Pick) and telling.is_late(state, pick):
                return Event("late", {**data, "pick": pick.number, "outcome": "told"}, arrays)
            place = len(state.rows)
            number = telling.answered(state, pick, source)
            expected = 0.0 if number is None else usual
            spent = expected if price is None else price
            made = self._made
            if made is None and state.equipment is not None:
                made = recipe_digest(state.equipment)
            return Event("told", {**data, "pick": number, "cost": spent, "recipe": made}, arrays)

        with self._lock:  # so that no other thread takes a row away meanwhile
            in_time = self._commit(told).kind == "told"
            if policy_object is not None and in_time:
                self.policies[place] = policy_object
        return in_time

    def evaluation_seeds(
        self, targets: Iterable[int] | None = None, purpose: Purpose = Purpose.EVALUATION
    ) -> list[int]:
        """Seeds to evaluate a policy with, one per target and the same for every policy.

        So policies are compared in the same episodes, while each target has luck of its own, which
        averages out in V. (`Pick.seed` is for the training alone.)

        Args:
            targets: indices of contexts, such as `Pick.targets`; None: all N.
            purpose: another one has other episodes.
        """
        checked = checked_targets(None if targets is None else list(targets), self.space.n)
        return evaluation_seeds(self.spec.seed, self.spec.trial, checked, purpose)

    def void(self, row: ToldRow | int, reason: str) -> None:
        """Take a wrong row back: it counts for nothing any more, and stays in the log.

        Its pick counts as failed, so `retry` lets it be trained again. It spends budget as before.

        Args:
            row: one of `state.rows`, or its place there.
            reason: for people, e.g. "the simulator was misconfigured".

        Raises:
            StudyError: there is no such row.
        """
        rows = self.refresh().rows
        if not isinstance(row, ToldRow):
            row = whole("the place of a row", row)
            if not 0 <= row < len(rows):
                raise StudyError(f"the places of the {len(rows)} rows count from 0, got {row}")
            row = rows[row]
        told = row.event

        def voided(state: StudyState) -> Event:
            if state.place_of(told) < 0:
                raise StudyError("that row is not one of this study, or was taken back before")
            return Event("voided", {"told": told, "reason": reason})

        self._commit(voided)

    def fail(self, pick: Pick, reason: str, *, traceback: str = "", pruned: bool = False) -> bool:
        """Record that a pick gave no policy; it spends budget and is not proposed again.

        Args:
            pick: what `ask` gave.
            reason: why, in one line.
            traceback: where that came from, for people.
            pruned: it was ended early on purpose, so nothing went wrong.

        Returns:
            False where it came too late; see `tell`.
        """
        return self._answer("failed", pick, reason, traceback, pruned=pruned)

    def defer(self, pick: Pick, reason: str, *, traceback: str = "") -> bool:
        """Record that a policy is trained and could not be evaluated; the pick stays open."""
        return self._answer("deferred", pick, reason, traceback)

    def begin_again(self, pick: Pick, reason: str, *, traceback: str = "") -> Pick | None:
        """Record that a training failed and is tried once more, at once and by the same worker.

        Returns:
            The pick with another seed, since with its own it might fail again; None: too late, as
            in `tell`.
        """
        in_time = self._answer("retried", pick, reason, traceback)
        return self._pick(self.state.picks[pick.number]) if in_time else None

    def retry(self, pick: Pick | int) -> None:
        """Open a failed pick again: the next `ask` hands it out, and it spends no further budget.

        Its seed is another one, since with its own it might fail again.

        Args:
            pick: what `ask` gave, or its 0-based number (`Pick.number`).

        Raises:
            StudyError: that pick did not fail, or its source was told since.
        """
        if not isinstance(pick, Pick):
            pick = whole("the number of a pick", pick)
        self._commit(lambda state: telling.reopening(state, pick))

    def equip(self, trainer: Trainer, *, accept_changes: bool = False) -> None:
        """Record what the policies of this study are made with, or check that it is the same.

        Args:
            trainer: makes them.
            accept_changes: a user's own functions may have changed since; the log says so then.

        Raises:
            StudyMismatch: policies were made with another recipe, format or code before.
        """
        code, state = code_of(trainer), self.refresh()
        given, known = equipment_of(trainer), state.equipment or {}
        given |= {"code": code} if code or "code" in known else {}
        self._made = recipe_digest(given)
        if known == given:
            return
        begun, changes = self.has_succeeded or bool(state.deferred), list[str]()
        if begun and known:
            if found := first_difference({**known, "code": None}, {**given, "code": None}):
                key, was, now = found
                raise StudyMismatch(
                    f"the policies of a study are made with one recipe: {key} was {was!r}, got "
                    f"{now!r}; use the same trainer, or start another study (--new, or another "
                    "name)"
                )
            if self.has_succeeded and "code" in known:  # what only failed may be mended
                changes = changed_code(known["code"], code)
            if changes and not accept_changes:
                raise code_mismatch(changes)
        facts = {**given, **({"accepted": changes} if changes else {})}
        self._commit(lambda _: Event("equipped", facts))
        if not begun:
            self.untold.clear()  # of another recipe

    def extend(self, budget: int) -> None:
        """Raise the budget to `budget` trainings in all, for a few more picks.

        Raises:
            InvalidInput: it is not larger than now, or exceeds the number of contexts.
        """
        budget = whole("budget", budget)

        def extended(state: StudyState) -> Event:
            now, most = self.spec.budget, self.space.n * self.spec.repeats
            if not now < budget <= most:
                raise InvalidInput(
                    f"a budget can only be raised, from {now} up to {most} trainings of "
                    f"{self.space.n} contexts, got {budget}"
                )
            return Event("extended", {"budget": int(budget)})

        self._commit(extended)

    def record_fresh_returns(
        self, served: ArrayLike, alone: ArrayLike, *, best_single: int, rows: int | None = None
    ) -> None:
        """Record returns on fresh evaluation seeds.

        Args:
            served: (N, E) of the policies that serve, raw units.
            alone: (N, E) of the best single policy, on the same episodes.
            best_single: its place among the rows.
            rows: how many rows these are the routes of; None: those there are.

        Raises:
            StudyError: of another shape, or rows were told since, which the report would not fit.
        """
        arrays = {"served": np.asarray(served, float), "alone": np.asarray(alone, float)}
        rows = len(self.refresh().rows) if rows is None else rows

        def reported(state: StudyState) -> Event:
            shapes = [array.shape for array in arrays.values()]
            n, told = self.space.n, len(state.rows)
            if told != rows or len(set(shapes)) > 1 or len(shapes[0]) != 2 or shapes[0][0] != n:
                raise StudyError(
                    f"fresh returns must have shape ({n}, episodes) and be of the {told} policies "
                    f"told, got {shapes} of {rows}; evaluate again"
                )
            data = {"episodes": shapes[0][1], "best_single": int(best_single)}
            return Event("reported", data, arrays)

        self._commit(reported)

    def run(
        self,
        train: Callable[..., Any] | None = None,
        evaluate: Callable[..., Any] | None = None,
        *,
        save: Callable[[Any, Path], None] | None = None,
        load: Callable[[Path], Any] | None = None,
        trainer: Trainer | None = None,
        parallel: int = 1,
        executor: Executor | None = None,
        on_failure: str = "continue",
        stop_after_failures: int = 3,
        retry_failed: bool = False,
        rehearse: bool = True,
        progress: bool = True,
        callbacks: Sequence[Callback] = (),
        report: bool = True,
        lease: float = 60.0,
        deterministic: bool = False,
        retries: int = 0,
        timeout: float | None = None,
        accept_changes: bool = False,
    ) -> RunResult:
        """Train and evaluate until the study is finished; see `mbtl.study.runner.run`.

        A callback ends the run by `study.stop`, and a training early by raising `TrainingPruned`.

        Args:
            train: `train(context, seed)`, or `train(contexts, seed, *, start=None, length=None)`.
            evaluate: policy, contexts, seeds -> returns, (n_targets,) or (n_targets, n_episodes);
                one seed per context, see `mbtl.trainer.FunctionTrainer`.
            save: policy, empty folder -> None; without it policies end with this process.
            load: folder -> policy.
            trainer: instead of these functions; None: the one that the study was made with.
            parallel: see `mbtl.study.runner.run`, as for all that follows.
            executor: runs the trainings when parallel > 1.
            on_failure: "continue", or "stop" at the first failure.
            stop_after_failures: so many failures in a row end the run.
            retry_failed: train again where trainings failed.
            rehearse: try the evaluation before the first training.
            progress: print a line per pick to standard error.
            callbacks: told what happens.
            report: evaluate the routed policies on fresh seeds at the end.
            lease: seconds without a sign of life after which others take a training over.
            deterministic: with parallel > 1, wait for a whole batch before the next picks.
            retries: so often a training that failed is begun again before it counts as failed.
            timeout: seconds that a training and its evaluation may take.
            accept_changes: go on although own functions have changed since the study was begun.

        Returns:
            V after each training, all trainings, failures, and why the run ended.

        Raises:
            StudyMismatch: the study was run with another recipe, policy format or code before.
        """
        from mbtl.study.callbacks import PrintProgress
        from mbtl.study.runner import run  # the runner joins study, trainer and executor

        given = [f for f in (train, evaluate, save, load) if f is not None]
        if given and trainer is not None:
            raise InvalidInput("run takes functions or a trainer, got both; leave one out")
        trainer = self.trainer if trainer is None and not given else trainer
        if trainer is None:
            if train is None or evaluate is None:
                raise InvalidInput("run needs train and evaluate functions, or a trainer")
            trainer = FunctionTrainer(train, evaluate, save, load)
        return run(
            self,
            trainer,
            parallel=parallel,
            executor=executor,
            on_failure=on_failure,
            stop_after_failures=stop_after_failures,
            retry_failed=retry_failed,
            rehearse=rehearse,
            callbacks=(*callbacks, *([PrintProgress()] if progress else [])),
            report=report,
            lease=lease,
            deterministic=deterministic,
            retries=retries,
            timeout=timeout,
            accept_changes=accept_changes,
        )

    def stop(self, reason: str = "it was stopped") -> None:
        """End the run of this object that goes on, from a callback or another thread.

        What is under way is finished and told; no more is asked for. The study itself is not
        finished: the next `run` goes on.

        Args:
            reason: for people.
        """
        self.stopping = reason

    # ---- inside ------------------------------------------------------------------------------

    def _answer(
        self, kind: Kind, pick: Pick, reason: str, traceback: str, *, pruned: bool = False
    ) -> bool:
        data: dict[str, Any] = {"source": pick.source, "reason": reason, "traceback": traceback}
        if pruned:
            data["pruned"] = True
        if pick.token:
            data["token"] = pick.token

        def answered(state: StudyState) -> Event:
            if telling.is_late(state, pick):
                return Event("late", {**data, "pick": pick.number, "outcome": kind})
            return Event(kind, {**data, "pick": telling.open_number(state, pick)})

        return self._commit(answered).kind == kind
