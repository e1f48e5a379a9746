"""The study: ask for the next source, tell its transfer row, repeat.

It decides; it trains nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from mbtl.arrays import Array
from mbtl.contexts import Context, ContextSpace
from mbtl.errors import InvalidInput, StudyError
from mbtl.history import History
from mbtl.objective import Bounds, value, value_curve
from mbtl.seeds import selection_rng, training_seed
from mbtl.selectors import Exhausted, SelectionProblem, Selector
from mbtl.study.events import Event, Kind
from mbtl.study.pick import Pick, StudyFinished
from mbtl.study.state import PickRecord, StudySpec, StudyState
from mbtl.study.storage import Conflict, EventLog
from mbtl.study.worker import this_worker
from mbtl.trainer import Trainer, checked_returns

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
        """Source -> policy object, for policies of this process that no trainer could save."""
        self._log = log
        self._state = StudyState()
        self.refresh()

    # ---- ask and tell ------------------------------------------------------------------------

    def ask(self, *, take_over: bool = False) -> Pick:
        """Propose the next source and reserve it for this process.

        A pick that somebody gave back is handed out again before a new one is proposed.

        Args:
            take_over: also hand out picks whose process is gone (a killed run). Leave it off when
                the trainings go on elsewhere after the asking process has ended.

        Raises:
            StudyFinished: the budget is spent, a stopping rule is met, or no context is left.
        """
        asked = self._commit(lambda state: self._next_event(state, take_over))
        return self._pick(self._state.picks[asked.data["pick"]])

    def tell(
        self,
        pick: Pick | int | Mapping[str, Any],
        returns: ArrayLike,
        *,
        cost: float = 1.0,
        seconds: float | None = None,
        policy: str | None = None,
        policy_object: Any = None,
    ) -> None:
        """Record the transfer row of one trained policy.

        Args:
            pick: what `ask` gave, or the context (or its index) of a policy you already have; rows
                that nobody asked for do not count towards the budget.
            returns: (N,) or (N, n_episodes) undiscounted returns on all contexts, raw units.
            cost: cost of the training, in the unit of the cost budget.
            seconds: wall time of training and evaluation.
            policy: folder of the saved policy, relative to the study's folder.
            policy_object: the policy itself, kept in this process only.

        Raises:
            TrainingFailed: returns of wrong shape, NaN or infinite. Nothing is recorded; tell
                again, or record it with `fail`.
            StudyError: the pick was answered before.
        """
        n = self.space.n
        rows = checked_returns(returns, n)
        if not (np.isfinite(cost) and cost >= 0):
            raise InvalidInput(f"cost must be finite and >= 0, got {cost!r}")
        source = self._source(pick)
        arrays = {"returns": rows.mean(axis=1), "std": rows.std(axis=1)}
        data = {
            "source": source,
            "episodes": rows.shape[1],
            "cost": float(cost),
            "seconds": seconds,
            "policy": policy,
        }

        def told(state: StudyState) -> Event:
            return Event("told", {**data, "pick": self._answered(state, pick, source)}, arrays)

        self._commit(told)
        if policy_object is not None:
            self.policies[source] = policy_object

    def fail(self, pick: Pick, reason: str) -> None:
        """Record that a pick gave nothing usable; it spends budget and is never proposed again."""
        self._settle("failed", pick, {"source": pick.source, "reason": reason})

    def extend(self, budget: int) -> None:
        """Raise the budget to `budget` trainings in all, for a few more picks.

        Raises:
            InvalidInput: it is not larger than now, or exceeds the number of contexts.
        """

        def extended(state: StudyState) -> Event:
            now = self.spec.budget
            if not now < budget <= self.space.n:
                raise InvalidInput(
                    f"a budget can only be raised, from {now} up to the {self.space.n} contexts, "
                    f"got {budget}"
                )
            return Event("extended", {"budget": int(budget)})

        self._commit(extended)

    def release(self, pick: Pick) -> None:
        """Give a pick back untrained; the next `ask` hands it out again."""
        self._settle("released", pick, {})

    def record_fresh_returns(self, returns: Array) -> None:
        """Record (k, N) returns on fresh evaluation seeds; NaN where a policy serves nobody.

        Raises:
            StudyError: rows were told since; the report would not fit them.
        """
        returns = np.asarray(returns, dtype=np.float64)

        def reported(state: StudyState) -> Event:
            expected = (len(state.rows), self.space.n)
            if returns.shape != expected:
                raise StudyError(
                    f"fresh returns must have shape {expected}, a row per policy told, got "
                    f"{returns.shape}; evaluate again"
                )
            return Event("reported", {}, {"returns": returns})

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
        return SelectionProblem.of(self.space, budget=self.spec.budget, theta=self.spec.theta)

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
        """V of the told rows, performance; -inf before the first. Biased upwards by noise."""
        return value(self.history.best, self.space.weights)

    @property
    def curve(self) -> Array:
        """(k,) V after each row, performance, on the episodes that selected."""
        return value_curve(self.history.rows, self.space.weights)

    @property
    def stop_reason(self) -> str | None:
        """Why nothing more can be asked; None while something can."""
        if self._early_stop is not None:
            return self._early_stop
        if len(self._state.picks) >= self.spec.budget:
            return f"the budget of {self.spec.budget} trainings is spent"
        if not self.history.open_mask(self.space.n).any():
            return f"all {self.space.n} contexts are taken"
        return None

    @property
    def _early_stop(self) -> str | None:
        """The level or the cost budget that was reached; picks given back are not trained then."""
        state, spec = self._state, self.spec
        if spec.stop_value is not None and state.rows and self.value >= spec.stop_value:
            return f"V = {self.value:.4f} reaches the level {spec.stop_value:g}"
        if spec.cost_budget is not None and state.cost >= spec.cost_budget:
            return f"the cost {state.cost:g} reaches the budget of {spec.cost_budget:g}"
        return None

    @property
    def is_finished(self) -> bool:
        """True when nothing can be asked and nobody works on a pick."""
        held = len(self._state.open_picks) - len(self._given_back)
        open_picks = held if self._early_stop else len(self._state.open_picks)
        return self.stop_reason is not None and not open_picks

    @property
    def orphans(self) -> list[int]:
        """Numbers of open picks that nobody works on: given back, or their process is gone."""
        picks = sorted(self._state.open_picks.items())
        return [number for number, p in picks if p.worker is None or p.worker.is_gone]

    def portfolio(self, trainer: Trainer | None = None) -> Portfolio:
        """The trained policies with their router.

        Args:
            trainer: reads saved policies of a format of its own ("custom").
        """
        from mbtl.portfolio import Portfolio

        rows = self.refresh().rows
        folders = [self.folder / r.policy if self.folder and r.policy else None for r in rows]
        sources = [row.source for row in rows]
        kept = {i: self.policies[s] for i, s in enumerate(sources) if s in self.policies}
        return Portfolio(
            self.space,
            tuple(sources),
            np.array([row.returns for row in rows]).reshape(-1, self.space.n),
            self.bounds,
            self.problem.theta,
            policy_folders=folders,
            policy_format=str(self.spec.settings.get("policy_format", "custom")),
            load=trainer.load if trainer is not None else None,
            in_memory=kept,
            cmdp=self.spec.problem or None,
            metadata={"study": self.name, "selector": dict(self.spec.selector)},
        )

    # ---- inside ------------------------------------------------------------------------------

    @property
    def _given_back(self) -> list[int]:
        return sorted(n for n, pick in self._state.open_picks.items() if pick.worker is None)

    def _next_event(self, state: StudyState, take_over: bool) -> Event:
        if self._early_stop is not None:
            raise StudyFinished(f"the study is finished: {self._early_stop}")
        orphans = self.orphans if take_over else self._given_back
        if not orphans:
            return self._proposal(state)
        return Event("claimed", {"pick": orphans[0], "worker": this_worker().to_json()})

    def _proposal(self, state: StudyState) -> Event:
        reason = self.stop_reason
        if reason is not None:
            held = len(state.open_picks)
            waiting = f"; {held} picks are still under way" if held else ""
            raise StudyFinished(f"the study is finished: {reason}{waiting}")
        number = len(state.picks)
        rng = selection_rng(self.spec.seed, self.spec.trial, number)
        try:
            proposal = self.selector.propose(self.problem, state.history(), rng)
        except Exhausted as error:
            raise StudyFinished(f"the study is finished: {error}") from error
        data = {
            "pick": number,
            "source": int(proposal.source),
            "reason": proposal.reason,
            "acquisition": proposal.acquisition,
            "notes": list(proposal.notes),
            "worker": this_worker().to_json(),
        }
        return Event("asked", data)

    def _pick(self, record: PickRecord) -> Pick:
        source = record.source
        seed = training_seed(self.spec.seed, self.spec.trial, source)
        return Pick(record.number, source, self.space.context(source), seed, record.reason)

    def _source(self, pick: Pick | int | Mapping[str, Any]) -> int:
        if isinstance(pick, Pick):
            return pick.source
        if isinstance(pick, Mapping):
            return self.space.index(pick)
        if not isinstance(pick, (int, np.integer)):
            raise InvalidInput(
                f"tell takes what ask gave, a context or its index, got {type(pick).__name__} "
                f"{pick!r}"
            )
        if not 0 <= int(pick) < self.space.n:
            raise InvalidInput(f"context indices run from 0 to {self.space.n - 1}, got {pick}")
        return int(pick)

    def _answered(self, state: StudyState, pick: Any, source: int) -> int | None:
        """Number of the open pick that this row answers; None for a row nobody asked for."""
        if isinstance(pick, Pick):
            return self._open_number(state, pick)
        for number, record in state.open_picks.items():
            if record.source == source:
                return number
        if any(row.source == source for row in state.rows):
            raise StudyError(f"context {source} was told before; a study keeps one row per source")
        return None

    def _settle(self, kind: Kind, pick: Pick, data: dict[str, Any]) -> None:
        def settled(state: StudyState) -> Event:
            return Event(kind, {"pick": self._open_number(state, pick), **data})

        self._commit(settled)

    @staticmethod
    def _open_number(state: StudyState, pick: Pick) -> int:
        if pick.number not in state.open_picks:
            raise StudyError(f"pick {pick.number} is not open: it was answered before, or given up")
        return pick.number

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
