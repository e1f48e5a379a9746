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
from mbtl.contexts import Context, ContextSpace
from mbtl.errors import InvalidInput, StudyError
from mbtl.history import History
from mbtl.objective import Bounds
from mbtl.routing import Routing
from mbtl.seeds import training_seed
from mbtl.selectors import SelectionProblem, Selector
from mbtl.study import asking, telling
from mbtl.study.events import Event, Kind
from mbtl.study.pick import Pick, StudyFinished
from mbtl.study.state import PickRecord, StudySpec, StudyState
from mbtl.study.storage import Conflict, EventLog
from mbtl.trainer import Trainer, checked_returns, checked_targets

if TYPE_CHECKING:
    from mbtl.portfolio import Portfolio
    from mbtl.study.callbacks import Callback


class Study:
    """One selection run over an event log. Make one with `create_study` or `load_study`."""

    def __init__(
        self, log: EventLog, selector: Selector, *, folder: Path | None, name: str = "study"
    ) -> None:
        """Use `create_study` or `load_study`; the log must hold a `created` event."""
        self.name = name
        self.folder = folder
        self.selector = selector
        self.policies: dict[int, Any] = {}
        """Number of the row -> policy, for policies of this process that no trainer could save."""
        self.untold: dict[int, Any] = {}
        """Number of the pick -> policy that is trained, not saved, and not evaluated so far."""
        self._log = log
        self._state = StudyState()
        self.refresh()

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
            StudyError: the pick was answered before.
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
        trainer: Trainer | None = None,
        parallel: int = 1,
        executor: Executor | None = None,
        on_failure: str = "continue",
        stop_after_failures: int = 3,
        retry_failed: bool = False,
        rehearse: bool = True,
        callbacks: Sequence[Callback] = (),
        report: bool = True,
    ) -> Study:
        """Train and evaluate until the study is finished; see `mbtl.study.runner.run`."""
        from mbtl.study.runner import run  # the runner joins study, trainer and executor

        if trainer is None:
            from mbtl.trainer import FunctionTrainer

            if train is None or evaluate is None:
                raise InvalidInput("run needs train and evaluate functions, or a trainer")
            trainer = FunctionTrainer(train, evaluate)
        run(
            self,
            trainer,
            parallel=parallel,
            executor=executor,
            on_failure=on_failure,
            stop_after_failures=stop_after_failures,
            retry_failed=retry_failed,
            rehearse=rehearse,
            callbacks=callbacks,
            report=report,
        )
        return self

    def __repr__(self) -> str:
        told, spec = len(self._state.rows), self.spec
        return f"Study({self.name!r}: {told} of {spec.budget} trainings told, {spec.space!r})"

    # ---- reading -----------------------------------------------------------------------------

    def refresh(self) -> StudyState:
        """Apply what other processes appended, and return the state."""
        for event in self._log.read(self._state.seq):
            self._state.apply(event)
        if self._state.spec is None:
            raise StudyError(f"there is no study {self.name!r} in this storage; create it first")
        return self._state

    @property
    def spec(self) -> StudySpec:
        """What the study was created with."""
        assert self._state.spec is not None
        return self._state.spec

    @property
    def state(self) -> StudyState:
        """Everything recorded, as of the last `refresh`."""
        return self._state

    @property
    def space(self) -> ContextSpace:
        """The contexts."""
        return self.spec.space

    @property
    def problem(self) -> SelectionProblem:
        """What the selector may know before any training."""
        return self.spec.selection_problem()

    @property
    def history(self) -> History:
        """The rows told so far, as performance."""
        return self._state.history()

    @property
    def bounds(self) -> Bounds:
        """Normalisation in force: given, or the range of the returns told so far."""
        return self._state.bounds()

    @property
    def value(self) -> float:
        """V of the policies as they are routed, performance; -inf before the first row.

        By the rows that routed them: noise is shrunk, and what was not evaluated is predicted by
        the transfer model. How sure that is: `study.routing.value`.
        """
        return self._state.value()

    @property
    def routing(self) -> Routing:
        """Who serves which context after every training, what that is worth, and how sure.

        Raises:
            StudyError: no row was told.
        """
        return self._state.routing()

    @property
    def curve(self) -> Array:
        """(k,) V after each row, performance, by the rows that routed the policies."""
        return self._state.curve()

    @property
    def stop_reason(self) -> str | None:
        """Why nothing more can be asked; None while something can."""
        return asking.stop_reason(self._state)

    @property
    def is_finished(self) -> bool:
        """True when nothing can be asked and nobody works on a pick."""
        return asking.is_finished(self._state)

    @property
    def has_succeeded(self) -> bool:
        """True when a pick was told; rows that nobody asked for show no training at work."""
        return any(row.pick is not None for row in self._state.rows)

    @property
    def orphans(self) -> list[int]:
        """Numbers of open picks that nobody works on: given back, or their process is gone."""
        return asking.orphans(self._state)

    def portfolio(self, trainer: Trainer | None = None) -> Portfolio:
        """The trained policies with their router.

        Args:
            trainer: reads saved policies of a format of its own ("custom").
        """
        from mbtl.portfolio import Portfolio

        rows, spec = self.refresh().rows, self.spec
        folders = [self.folder / r.policy if self.folder and r.policy else None for r in rows]
        made = {"selector": dict(spec.selector), "settings": dict(spec.settings)}
        return Portfolio(
            self.space,
            tuple(row.source for row in rows),
            np.array([row.returns for row in rows]).reshape(-1, self.space.n),
            self.bounds,
            self.problem.theta,
            deviations=np.array([row.std for row in rows]).reshape(-1, self.space.n),
            episodes=tuple(row.episodes for row in rows),
            risk=spec.risk,
            policy_folders=folders,
            policy_format=str(spec.settings.get("policy_format", "custom")),
            load=trainer.load if trainer is not None else None,
            in_memory=dict(self.policies),
            cmdp=spec.problem or None,
            metadata={"study": self.name, **made},
        )

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
            try:
                self._log.append(event, after=state.seq)
            except Conflict:
                continue
            self.refresh()
            return event
