"""The study: ask for the next source, tell its transfer row, repeat.

It decides; it trains nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

import numpy as np
from numpy.typing import ArrayLike

from mbtl.arrays import Array
from mbtl.contexts import Context
from mbtl.errors import InvalidInput, StudyError, StudyMismatch
from mbtl.seeds import training_seed
from mbtl.selectors import Selector
from mbtl.settings import first_difference
from mbtl.study import asking, telling
from mbtl.study.checks import check_event
from mbtl.study.events import Event, Kind
from mbtl.study.pick import Pick, StudyFinished
from mbtl.study.records import PickRecord
from mbtl.study.state import StudyState
from mbtl.study.storage import Conflict, EventLog
from mbtl.study.view import StudyView
from mbtl.trainer import (
    FunctionTrainer,
    Trainer,
    checked_returns,
    checked_targets,
    equipment_of,
)

if TYPE_CHECKING:
    from mbtl.study.callbacks import Callback


class Study(StudyView):
    """One selection run over an event log. Make one with `create_study` or `load_study`."""

    def __init__(
        self,
        log: EventLog,
        selector: Selector,
        *,
        folder: Path | None,
        name: str = "study",
        trainer: Trainer | None = None,
    ) -> None:
        """Use `create_study` or `load_study`; the log must hold a `created` event."""
        super().__init__(log, folder=folder, name=name, trainer=trainer)
        self.selector = selector

    # ---- ask and tell ------------------------------------------------------------------------

    @overload
    def ask(self, n: None = None, *, take_over: bool = False) -> Pick: ...

    @overload
    def ask(self, n: int, *, take_over: bool = False) -> list[Pick]: ...

    def ask(self, n: int | None = None, *, take_over: bool = False) -> Pick | list[Pick]:
        """Propose the next source, or the next `n`, and reserve them for this process.

        Each of several is proposed as if those before it had given what is expected of them. A pick
        that somebody gave back is handed out again before a new one is proposed.

        Args:
            n: number of picks, for as many parallel trainings; fewer where fewer are left. None:
                one pick, not in a list.
            take_over: also hand out picks whose process is gone (a killed run). Leave it off when
                the trainings go on elsewhere after the asking process has ended.

        Raises:
            StudyFinished: the budget is spent, a stopping rule is met, or no context is left.
            InvalidInput: n < 1.
        """
        if n is None:
            return self._ask(take_over)
        if not isinstance(n, (int, np.integer)) or n < 1:
            raise InvalidInput(f"ask gives a whole number of picks, 1 or more, got n = {n!r}")
        picks = [self._ask(take_over)]
        while len(picks) < n:
            try:
                picks.append(self._ask(take_over))
            except StudyFinished:
                break
        return picks

    def tell(
        self,
        pick: Pick | int | Mapping[str, Any],
        returns: ArrayLike,
        *,
        targets: Sequence[int] | None = None,
        cost: float | None = None,
        seconds: float | None = None,
        policy: str | None = None,
        policy_object: Any = None,
    ) -> None:
        """Record the transfer row of one trained policy.

        Args:
            pick: what `ask` gave, or the context (or its index) of a policy you already have; rows
                that nobody asked for do not count towards the budget.
            returns: (T,) or (T, n_episodes) undiscounted returns on the targets, raw units.
            targets: T indices of the contexts evaluated on; None: those that the pick asks for,
                which are all N unless the study was made with `eval_targets`.
            cost: cost of the training, in the unit of the cost budget; None: what `costs` says of
                the source, or 1; 0 for a row that nobody asked for.
            seconds: wall time of training and evaluation.
            policy: folder of the saved policy, relative to the study's folder.
            policy_object: the policy itself, kept in this process only.

        Raises:
            TrainingFailed: returns of wrong shape, NaN or infinite. Nothing is recorded; tell
                again, or record it with `fail`.
            InvalidInput: `policy` leads out of the study's folder, or another fact is not what it
                should be. Nothing is recorded.
            StudyError: the pick was answered before, or is another study's.
        """
        source = telling.source_of(self.space, pick)
        if cost is not None and not (np.isfinite(cost) and cost >= 0):
            raise InvalidInput(f"cost must be finite and >= 0, got {cost!r}")
        usual = 1.0 if self.spec.costs is None else self.spec.costs[source]
        if targets is None:
            targets = telling.asked_targets(self.refresh(), pick, source)
        evaluated = checked_targets(targets, self.space.n)
        rows = checked_returns(returns, len(evaluated))
        arrays = {name: np.full(self.space.n, np.nan) for name in ("returns", "std")}
        arrays["returns"][evaluated] = rows.mean(axis=1)
        if rows.shape[1] > 1:
            arrays["std"][evaluated] = rows.std(axis=1, ddof=1)
        data = {
            "source": source,
            "ddof": 1,
            "episodes": rows.shape[1],
            "seconds": seconds,
            "policy": policy,
        }
        place = 0

        def told(state: StudyState) -> Event:
            nonlocal place
            place = len(state.rows)
            number = telling.answered(state, pick, source)
            expected = 0.0 if number is None else usual
            spent = expected if cost is None else float(cost)
            return Event("told", {**data, "pick": number, "cost": spent}, arrays)

        self._commit(told)
        if policy_object is not None:
            self.policies[place] = policy_object

    def fail(self, pick: Pick, reason: str, *, traceback: str = "") -> None:
        """Record that a pick gave no policy; it spends budget and is not proposed again.

        Args:
            pick: what `ask` gave.
            reason: why, in one line.
            traceback: where that came from, for people.
        """
        about = {"source": pick.source, "reason": reason, "traceback": traceback}
        self._settle("failed", pick, about)

    def defer(self, pick: Pick, reason: str, *, traceback: str = "") -> None:
        """Record that a policy is trained and could not be evaluated; the pick stays open."""
        about = {"source": pick.source, "reason": reason, "traceback": traceback}
        self._settle("deferred", pick, about)

    def retry(self, pick: Pick | int) -> None:
        """Open a failed pick again: the next `ask` hands it out, and it spends no further budget.

        Args:
            pick: what `ask` gave, or its 0-based number (`Pick.number`).

        Raises:
            StudyError: that pick did not fail, or its source was told since.
        """
        self._commit(lambda state: telling.reopening(state, pick))

    def equip(self, trainer: Trainer) -> None:
        """Record what the policies of this study are made with, or check that it is the same.

        Raises:
            StudyMismatch: policies were made with another recipe or format before.
        """
        given, state = equipment_of(trainer), self.refresh()
        known = state.equipment
        if known == given:
            return
        if known is None or not (self.has_succeeded or state.deferred):
            self._commit(lambda _: Event("equipped", given))
            self.untold.clear()  # of another recipe
            return
        key, was, now = first_difference(known, given) or ("recipe", known, given)
        raise StudyMismatch(
            f"the policies of a study are made with one recipe: {key} was {was!r}, got {now!r}; "
            "use the same trainer, or start another study (--new, or another name)"
        )

    def extend(self, budget: int) -> None:
        """Raise the budget to `budget` trainings in all, for a few more picks.

        Raises:
            InvalidInput: it is not larger than now, or exceeds the number of contexts.
        """

        def extended(state: StudyState) -> Event:
            now, most = self.spec.budget, self.space.n * self.spec.repeats
            if not now < budget <= most:
                raise InvalidInput(
                    f"a budget can only be raised, from {now} up to {most} trainings of "
                    f"{self.space.n} contexts, got {budget}"
                )
            return Event("extended", {"budget": int(budget)})

        self._commit(extended)

    def release(self, pick: Pick) -> None:
        """Give a pick back untrained; the next `ask` hands it out again."""
        self._settle("released", pick, {})

    def record_fresh_returns(
        self, returns: Array, *, value_errors: Array | None = None, episodes: int | None = None
    ) -> None:
        """Record returns on fresh evaluation seeds.

        Args:
            returns: (k, N) means; NaN where a policy serves nobody.
            value_errors: (k,) standard errors of V after each training, raw units; None: unknown.
            episodes: behind each mean; None: unknown.

        Raises:
            StudyError: rows were told since; the report would not fit them.
        """
        returns = np.asarray(returns, dtype=np.float64)
        errors = None if value_errors is None else [float(error) for error in value_errors]
        data = {"value_errors": errors, "episodes": episodes}

        def reported(state: StudyState) -> Event:
            expected = (len(state.rows), self.space.n)
            if returns.shape != expected:
                raise StudyError(
                    f"fresh returns must have shape {expected}, a row per policy told, got "
                    f"{returns.shape}; evaluate again"
                )
            return Event("reported", data, {"returns": returns})

        self._commit(reported)

    def run(
        self,
        train: Callable[[Context, int], Any] | None = None,
        evaluate: Callable[[Any, Sequence[Context], int], Any] | None = None,
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
    ) -> Study:
        """Train and evaluate until the study is finished; see `mbtl.study.runner.run`.

        Args:
            train: context, seed -> policy.
            evaluate: policy, contexts, seed -> returns, (n_targets,) or (n_targets, n_episodes).
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

        Raises:
            StudyMismatch: the study was run with another recipe or policy format before.
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
        run(
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
        )
        return self

    # ---- inside ------------------------------------------------------------------------------

    def _ask(self, take_over: bool) -> Pick:
        asked = self._commit(lambda state: asking.next_event(state, self.selector, take_over))
        if asked.kind == "stopped":
            raise StudyFinished(f"the study is finished: {asked.data['reason']}")
        return self._pick(self._state.picks[asked.data["pick"]])

    def _pick(self, record: PickRecord) -> Pick:
        source, spec = record.source, self.spec
        seed = training_seed(spec.seed, spec.trial, source, record.repeat)
        context = self.space.context(source)
        return Pick(
            record.number, source, context, seed, record.reason, record.repeat, record.targets
        )

    def _settle(self, kind: Kind, pick: Pick, data: dict[str, Any]) -> None:
        def settled(state: StudyState) -> Event:
            return Event(kind, {"pick": telling.open_number(state, pick), **data})

        self._commit(settled)

    def _commit(self, decide: Callable[[StudyState], Event]) -> Event:
        """Append what `decide` makes of the newest state; decide anew if somebody was faster."""
        while True:
            state = self.refresh()
            event = decide(state)
            check_event(event, state)
            try:
                self._log.append(event, after=state.seq)
            except Conflict:
                continue
            self.refresh()
            return event
