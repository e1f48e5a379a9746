"""Ask for the next training, tell its transfer row, repeat.

It decides; it trains nothing. Its log of events is the study, its state a replay of them.
"""

from __future__ import annotations

import contextlib
import math
import random
import threading
import time
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial, wraps
from pathlib import Path
from typing import Any, Concatenate, ParamSpec, TypeVar, overload

import numpy as np
from numpy.typing import ArrayLike

from mbtl.arrays import Array
from mbtl.contexts import ContextSpace
from mbtl.errors import InvalidInput, Notice, StorageError, StudyError, StudyMismatch, few
from mbtl.history import History
from mbtl.objective import Bounds
from mbtl.plain import finite, is_finite, short, whole
from mbtl.portfolio import Portfolio
from mbtl.routing import Routing
from mbtl.seeds import Purpose, evaluation_seeds
from mbtl.selectors import SelectionProblem, Selector
from mbtl.settings import changed_code, first_difference
from mbtl.study import ask, tell
from mbtl.study.artifacts import Artifact, ArtifactStore, FolderStore
from mbtl.study.budget import Cost, Steps
from mbtl.study.checks import advance, check_event, is_policy_place
from mbtl.study.closing_report import value_of
from mbtl.study.database import database_file
from mbtl.study.events import Event, Kind
from mbtl.study.job import Kept
from mbtl.study.leases import Lease, Presence, Watch, new_worker
from mbtl.study.problem import Beside, Problem, trainer_of
from mbtl.study.records import Pick, PickRecord, StudyFinished, ToldRow
from mbtl.study.spec import StudySpec
from mbtl.study.state import ABILITIES, StudyState
from mbtl.study.storage import Conflict, EventLog, MemoryLog
from mbtl.study.trainings import Training, trainings_of
from mbtl.trainers.contract import (
    Trainer,
    checked_returns,
    checked_targets,
    code_of,
    equipment_of,
    recipe_digest,
)

P = ParamSpec("P")

T = TypeVar("T")

Decided = TypeVar("Decided", bound=Event | None)


def _alone(method: Callable[Concatenate[AskTell, P], T]) -> Callable[Concatenate[AskTell, P], T]:
    """What reads the state, while no other thread of this process changes it."""

    @wraps(method)
    def locked(self: AskTell, /, *args: P.args, **named: P.kwargs) -> T:
        with self._lock:
            return method(self, *args, **named)

    return locked


_PAUSE, _LONGEST_PAUSE, _LONGEST_COMMIT = 0.01, 1.0, 0.1

"""Seconds between looks while somebody else proposes, or writes: few at first, since most wait for
a moment, then ever more, since many who look at once only disturb each other."""

_WATCH = 1.0

"""Seconds for which an asker believes what it knows of heartbeats: many wait at the same time."""


class AskTell:
    """A study but for its runs: a log of events, asked for trainings and told what they gave.

    Its attributes are described at `mbtl.Study`.
    """

    def __init__(
        self,
        log: EventLog,
        selector: Selector,
        *,
        folder: Path | ArtifactStore | None,
        name: str = "study",
        trainer: Trainer | None = None,
        beside: Beside | None = None,
        state: StudyState | None = None,
    ) -> None:
        """Use `create_study` or `load_study`; the log must hold a `created` event.

        `state` is what was read of it before.
        """
        self.name = name
        self.artifacts = FolderStore(folder.absolute()) if isinstance(folder, Path) else folder
        self.trainer = trainer
        self.beside = beside or Beside()
        self.policies: dict[int, Any] = {}
        self.untold: dict[int, Kept] = {}
        self.stopping: str | None = None
        self._made: str | None = None  # digest of what this object's policies are made with
        self.worker = new_worker()
        self.database = database_file(getattr(log, "url", ""))
        self.presence = Presence(self.database)
        self.log = log
        self._lock = threading.RLock()
        self._state = StudyState() if state is None else state
        self.selector = selector
        self.refresh()

    def __repr__(self) -> str:
        told, state, spec = len(self._state.rows), self._state, self.spec
        usual = spec.in_units and not spec.any_training
        how = f"{told} of {spec.budget} trainings told" if usual else (
            f"{told} policies told, {state.spent_words()}"
        )  # fmt: skip
        return f"Study({self.name!r}: {how}, {spec.space!r})"

    # ---- reading ------------------------------------------------------------------------------

    @_alone
    def refresh(self) -> StudyState:
        """Apply what other processes appended, and return the state."""
        for event in self.log.read(self._state.seq):
            gone = self._state.place_of(event.data.get("told")) if event.kind == "voided" else None
            advance(self._state, event)
            if gone is not None:  # policies are kept by the place of their row
                kept = {i: p for i, p in self.policies.items() if i != gone}
                self.policies = {i - (i > gone): policy for i, policy in kept.items()}
        if not self._state.seq:
            raise StudyError(f"there is no study {self.name!r} in this storage; create it first")
        return self._state

    @property
    def folder(self) -> Path | None:
        """Policies are saved below it; None where they are elsewhere, or nowhere."""
        return self.artifacts.root if isinstance(self.artifacts, FolderStore) else None

    @property
    def spec(self) -> StudySpec:
        """What the study was created with."""
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
        """What the strategy may know before any training."""
        return self._state.problem()

    @property
    @_alone
    def history(self) -> History:
        """The rows told so far, as performance."""
        return self._state.history()

    @property
    @_alone
    def bounds(self) -> Bounds:
        """Normalisation in force: given, or the range of the returns told so far."""
        return self._state.bounds()

    @property
    @_alone
    def value(self) -> float:
        """V, performance: on fresh episodes once they were played, else the running estimate.

        -inf before the first row. How sure the running estimate is: `study.routing.value`.
        """
        return value_of(self._state)

    @property
    @_alone
    def routing(self) -> Routing:
        """Who serves which context after every training, what that is worth, and how sure.

        Raises:
            StudyError: no row was told.
        """
        return self._state.routing()

    @property
    @_alone
    def curve(self) -> Array:
        """(k,) the running estimate of V after each row, performance."""
        return self._state.curve()

    @property
    def is_durable(self) -> bool:
        """True when the study outlives this process."""
        return not isinstance(self.log, MemoryLog)

    @property
    @_alone
    def stop_reason(self) -> str | None:
        """Why nothing more can be asked; None while something can."""
        return ask.stop_reason(self._state)

    @property
    @_alone
    def is_finished(self) -> bool:
        """True when nothing can be asked and nobody works on a pick."""
        return ask.is_finished(self._state)

    @property
    @_alone
    def has_succeeded(self) -> bool:
        """True when a pick was told; rows that nobody asked for show no training at work."""
        return any(row.pick is not None for row in self._state.rows)

    @property
    @_alone
    def trainings(self) -> tuple[Training, ...]:
        """What became of each pick, and of rows that nobody asked for, one typed line each."""
        return trainings_of(self.refresh(), self.watch())

    @property
    @_alone
    def orphans(self) -> list[int]:
        """Numbers of open picks that nobody works on: given back, or their lease is stale."""
        return ask.left_alone(self._state, self.watch())

    @property
    def leases(self) -> list[Lease]:
        """Those in force, as of the last `refresh`: of open picks, and of the one to come."""
        held = [pick.lease for pick in self._state.open_picks.values()]
        return [lease for lease in (*held, self._state.proposing) if lease is not None]

    def watch(self) -> Watch:
        """Which leases are stale now."""
        return Watch(self.log, self.presence.is_gone)

    @_alone
    def portfolio(self, trainer: Trainer | None = None, *, trust: bool = False) -> Portfolio:
        """The trained policies with their router.

        Args:
            trainer: reads the saved policies, all of them: give the one that wrote them. None: the
                study's own, if they are of a format of its own ("custom").
            trust: without a trainer, also read files that can execute code; set it if the study
                is your own, or of somebody you trust.

        Raises:
            StudyError: no row was told.
            StorageError: a policy's folder is not inside the study's, or is reached by a link, or
                a policy is not the one that was told.
        """
        rows, spec = self.refresh().rows, self.spec
        if not rows:
            raise StudyError(
                "a portfolio needs the row of at least one policy, and none was told; train one"
            )
        folders = [
            self.artifacts.read(r.policy, r.sha256) if self.artifacts and r.policy else None
            for r in rows
        ]
        made = {"selector": dict(spec.selector), "settings": dict(spec.settings)}
        policy_format = str((self.state.equipment or {}).get("policy_format", "custom"))
        if trainer is None and policy_format == "custom":
            trainer = self.trainer
        return Portfolio(
            self.space,
            tuple(row.source for row in rows),
            np.array([row.returns for row in rows]).reshape(-1, self.space.n),
            self.bounds,
            episodes=tuple(row.each for row in rows),
            risk=spec.risk,
            policy_folders=folders,
            policy_format=policy_format,
            load=trainer.load if trainer is not None else None,
            in_memory=dict(self.policies),
            sets={i: row.sources for i, row in enumerate(rows) if len(row.sources) > 1},
            cmdp=spec.problem or None,
            metadata={"study": self.name, **made},
            trust=trust,
        )

    # ---- asking -------------------------------------------------------------------------------

    @overload
    def ask(self, n: None = None, *, lease: float | None = None) -> Pick: ...

    @overload
    def ask(self, n: int, *, lease: float | None = None) -> list[Pick]: ...

    def ask(self, n: int | None = None, *, lease: float | None = None) -> Pick | list[Pick]:
        """Propose the next training, or the next `n`, and lease them to this worker.

        Each of several is proposed as if those before it had given what is expected of them. A pick
        that somebody gave back, or whose lease has ended, is handed out again before a new one is
        proposed.

        Args:
            n: number of picks, for as many parallel trainings; fewer where fewer are left. None:
                one pick, not in a list.
            lease: seconds after which others may take the pick over, unless `heartbeat` is called
                meanwhile; None: never, until it is told, failed or given back (`release`).

        Raises:
            StudyFinished: the budget is spent, a stopping rule is met, or no context is left.
            StudyWaiting: what is best next depends on a pick that is under way; ask again then.
            InvalidInput: n < 1, or a lease that is not > 0.
        """
        if lease is not None and not (is_finite(lease) and lease > 0):
            raise InvalidInput(
                f"a lease lasts a number of seconds > 0, or None, got {short(lease)}"
            )
        if n is None:
            return self._ask(lease)
        if whole("the number n of picks", n) < 1:
            raise InvalidInput(f"ask gives a whole number of picks, 1 or more, got n = {n!r}")
        picks = [self._ask(lease)]
        with contextlib.suppress(StudyFinished):
            while len(picks) < n:
                picks.append(self._ask(lease))
        return picks

    def heartbeat(self, pick: Pick) -> bool:
        """Say that a training goes on, and hear whether it should.

        Args:
            pick: what `ask` gave.

        Returns:
            True: go on; the lease begins anew. False: stop, because the pick was given back,
            answered, or taken over.
        """
        held = self.refresh().open_picks.get(pick.number)
        if held is None or held.lease is None or held.lease.token != pick.token:
            return False
        self.log.beat(pick.token, held.lease.seconds or 0.0)
        return True

    def pick(self, number: int) -> Pick:
        """A pick by its 0-based number, as whoever holds it has it: to answer it elsewhere.

        Raises:
            StudyError: so many were not asked for.
        """
        picks, number = self.refresh().picks, whole("the number of a pick", number)
        if not 0 <= number < len(picks):
            raise StudyError(f"pick numbers run from 0 to {len(picks) - 1} so far, got {number}")
        return self._pick(picks[number])

    def open_picks(self) -> list[Pick]:
        """The picks that wait for an answer, in order; `state.open_picks` says who holds them."""
        with self._lock:
            return [self._pick(record) for _, record in sorted(self.refresh().open_picks.items())]

    def release(self, pick: Pick | int) -> None:
        """Give a pick back untrained; the next `ask` hands it out again.

        Args:
            pick: what `ask` gave; or the number of any open pick, whoever holds it: its training
                is told to stop by its next heartbeat.

        Raises:
            StudyError: it is not open, or somebody took it over.
        """
        self._commit(lambda state: Event("released", {"pick": tell.held_number(state, pick)}))

    # ---- telling ------------------------------------------------------------------------------

    def tell(
        self,
        pick: tell.Told,
        returns: ArrayLike,
        *,
        targets: Sequence[int] | None = None,
        cost: float | None = None,
        seconds: float | None = None,
        steps: float | None = None,
        policy: str | Artifact | None = None,
        policy_object: Any = None,
        training_state: Artifact | None = None,
        evaluation_steps: float | None = None,
    ) -> bool:
        """Record the transfer row of one trained policy.

        Args:
            pick: what `ask` gave (of one that evaluates only: further entries of a row), or the
                context (or its index) of a policy you already have, or all of them, of one trained
                on several. That answers the open pick on these from scratch, if there is one; rows
                that nobody asked for do not count towards the budget.
            returns: (T,) or (T, n_episodes) undiscounted returns on the targets, raw units. NaN is
                an episode that has none, and counts as not played.
            targets: T indices of the contexts evaluated on; None: those that the pick asks for,
                which are all N unless the study was made with `Evaluation(targets)`. What is left
                out is predicted, and cannot be told later.
            cost: cost of the training, in the unit of the cost budget; None: what `costs` says of
                the source, or 1; 0 for a row that nobody asked for.
            seconds: wall time of training and evaluation.
            steps: environment steps of the training; of one that goes on those before it, too.
            policy: folder of the saved policy, relative to the study's folder; as an `Artifact`
                with its hash, which is then checked whenever it is read.
            policy_object: the policy itself, kept in this process only.
            training_state: saved state of the training, to go on from exactly.
            evaluation_steps: of the evaluation told here; None: each episode counts as the longest.

        Returns:
            True: recorded. False: too late, because somebody took the pick over or answered it
            meanwhile; the returns are in the log, and count for nothing.

        Raises:
            TrainingFailed: returns of wrong shape, all NaN, or beyond 1e30. Nothing is recorded;
                tell again, or record it with `fail`.
            InvalidInput: `policy` leads out of the study's folder, or another fact is not what it
                should be. Nothing is recorded.
            StudyError: the pick was answered before, or is another study's.
        """
        sources = tell.sources_of(self.space, pick)
        place = policy.place if isinstance(policy, Artifact) else policy
        if place is not None and not is_policy_place(place):
            raise InvalidInput(
                "`policy` must be a folder inside the study's own, as a relative path, got "
                f"{short(place)}"
            )
        price = finite("cost", cost, 0.0)
        if targets is None and isinstance(pick, Pick):
            targets = pick.targets
        elif targets is None:
            with self._lock:
                asked = tell.from_scratch(self.refresh(), sources)
            targets = None if asked is None else asked.targets
        evaluated = checked_targets(targets, self.space.n)
        rows = checked_returns(returns, len(evaluated), self.space.named(evaluated))
        order = np.argsort(evaluated)
        arrays = {"returns": rows[order]}
        data: dict[str, Any] = {
            "sources": list(sources),
            "targets": None if targets is None else [evaluated[i] for i in order],
            "episodes": rows.shape[1],
            "seconds": finite("seconds", seconds, 0.0),
            "steps": finite("steps", steps, 0.0),
            "policy": place,
            "sha256": policy.sha256 if isinstance(policy, Artifact) else None,
            "state": None if training_state is None else training_state.place,
            "state_sha256": None if training_state is None else training_state.sha256,
            "evaluation_steps": finite("evaluation_steps", evaluation_steps, 0.0),
        }
        row = 0

        def told(state: StudyState) -> dict[str, Any]:
            nonlocal row
            row = len(state.rows)
            number = tell.answered(state, pick, sources)
            expected = 0.0 if number is None else state.usual_cost(state.picks[number])
            spent = expected if price is None else price
            made = self._made
            if made is None and state.equipment is not None:
                made = recipe_digest(state.equipment)
            return {"pick": number, "cost": spent, "recipe": made}

        with self._lock:  # so that no other thread takes a row away meanwhile
            in_time = self._answer("told", pick, data, told, arrays)
            if policy_object is not None and in_time:
                self.policies[row] = policy_object
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

    def fail(
        self,
        pick: Pick,
        reason: str,
        *,
        traceback: str = "",
        pruned: bool = False,
        steps: float | None = None,
        again: bool = False,
    ) -> bool:
        """Record that a pick gave no policy; it spends budget and is not proposed again.

        Args:
            pick: what `ask` gave.
            reason: why, in one line.
            traceback: where that came from, for people.
            pruned: it was ended early on purpose, so nothing went wrong.
            steps: environment steps that it had; None: not known.
            again: the next `ask` hands the pick out once more, with another seed, since with its
                own the training might fail again.

        Returns:
            False where it came too late; see `tell`.
        """
        data: dict[str, Any] = {"reason": reason, "traceback": traceback}
        data |= {"steps": finite("steps", steps, 0.0), "pruned": pruned, "again": again}
        return self._answer("failed", pick, data)

    def defer(
        self, pick: Pick, reason: str, *, traceback: str = "", steps: float | None = None
    ) -> bool:
        """Record that a policy is trained and could not be evaluated; the pick stays open.

        Its training has had `steps` environment steps; None: not known.
        """
        data = {"reason": reason, "traceback": traceback, "steps": finite("steps", steps, 0.0)}
        return self._answer("deferred", pick, data)

    def retry(self, pick: Pick | int) -> None:
        """Open a failed pick again: the next `ask` hands it out, and it spends no further unit.

        Its seed is another one, since with its own it might fail again. Likewise for one whose
        policy is trained and could not be evaluated: that policy is given up.

        Args:
            pick: what `ask` gave, or its 0-based number (`Pick.number`).

        Raises:
            StudyError: that pick did not fail, or its source was told since.
        """
        event = self._commit(lambda state: tell.reopening(state, pick))
        self.untold.pop(event.data["pick"], None)

    def equip(self, trainer: Trainer | Problem, *, accept_changes: bool = False) -> None:
        """Record what the policies of this study are made with, or check that it is the same.

        Args:
            trainer: makes them; or the problem that has it.
            accept_changes: a user's own functions may have changed since; the log says so then.

        Raises:
            StudyMismatch: policies were made with another recipe, format or code before.
        """
        trainer = trainer_of(trainer)
        code, state = code_of(trainer), self.refresh()
        given, known = equipment_of(trainer), state.equipment or {}
        given |= {"code": code} if code or "code" in known else {}
        given["abilities"] = sorted(set(ABILITIES) & trainer.takes)
        self._made = recipe_digest(given)
        if known == given:
            return
        begun, changes = self.has_succeeded or bool(state.deferred), list[str]()
        if begun and known:
            own: dict[str, Any] = {"code": None, "abilities": None}
            if found := first_difference({**known, **own}, {**given, **own}):
                key, was, now = found
                raise StudyMismatch(
                    f"the policies of a study are made with one recipe: {key} was {short(was)}, "
                    f"got {short(now)}; use the same trainer, or start another study (--new, or "
                    "another name)"
                )
            if self.has_succeeded and "code" in known:  # what only failed may be mended
                changes = changed_code(known["code"], code)
            if changes and not accept_changes:
                raise StudyMismatch(
                    "the policies of a study are made and evaluated by one code, and since it was "
                    f"last recorded {few(changes)} changed; take the recorded code back, start "
                    "another study (--new, or another name), or mix them knowingly, "
                    "study.equip(trainer, accept_changes=True) (--accept-changes)"
                )
        facts = {**given, **({"accepted": changes} if changes else {})}
        self._commit(lambda _: Event("equipped", facts))
        if not begun:
            self.untold.clear()  # of another recipe

    def extend(self, budget: int | Steps | Cost) -> None:
        """Raise the budget to so many trainings, or steps, or a cost, in all, for more picks.

        Args:
            budget: in all. A `Cost` without `trainings` leaves their number as it is, and a number
                leaves the cost.

        Raises:
            InvalidInput: it is not larger than now, counts something else, or asks a selector for
                more trainings than there are contexts.
        """
        given = budget if isinstance(budget, (Steps, Cost)) else whole("budget", budget)

        def extended(state: StudyState) -> Event:
            spec = state.spec
            most = math.inf if spec.any_training else spec.space.n  # trainings
            facts: dict[str, float] = {}
            if isinstance(given, Steps) and spec.steps is not None:
                more = given.total // (spec.unit or given.total)
                wanted, facts = given.total > spec.steps, {"steps": given.total}
            elif isinstance(given, Cost) and spec.cost_budget is not None:
                more = spec.budget if given.trainings is None else given.trainings
                facts = {"cost_budget": float(given.total)}
                larger = (given.total, more) > (spec.cost_budget, spec.budget)
                wanted = larger and given.total >= spec.cost_budget and more >= spec.budget
            elif isinstance(given, int) and spec.steps is None:
                more = given
                wanted = spec.budget < given <= most
            else:
                wanted = False
            if not wanted:
                raise InvalidInput(
                    f"a budget can only be raised, and counts what it counted before, from "
                    f"{spec.size} (a selector's trainings up to one on each of {spec.space.n} "
                    f"contexts), got {given}{' trainings' * isinstance(given, int)}"
                )
            return Event("extended", {"budget": int(min(max(more, spec.budget), most)), **facts})

        self._commit(extended)

    def spend_all(self) -> None:
        """From now on end only when the budget is spent, whatever `Stopping` said."""
        self.end_as(replace(self.spec, stop_left=None, stop_value=None))

    def end_as(self, spec: StudySpec) -> None:
        """From now on end at the level of `spec`, and for want of gain only if that does."""
        ends: dict[str, Any] = {"stop_value": spec.stop_value}
        if spec.stop_left is None:
            ends["to_the_end"] = True
        self._commit(lambda state: Event("extended", {"budget": state.spec.budget, **ends}))

    def record_fresh_returns(
        self,
        served: ArrayLike,
        alone: ArrayLike,
        *,
        best_single: int,
        baselines: Mapping[str, Array] | None = None,
        metrics: Array | None = None,
        rows: int | None = None,
        lost: Sequence[int] = (),
    ) -> None:
        """Record returns on fresh evaluation seeds.

        Args:
            served: (N, E) of the policies that serve, raw units; NaN where an episode gave none or
                a context was not played, as `mbtl.study.closing_report` draws them.
            alone: (N, E) of the best single policy, on the same episodes.
            best_single: its place among the rows.
            baselines: name -> (N, E) on the same episodes of what V is compared with.
            metrics: (1 + baselines, measures, N) means of the study's `beside.metrics`, of the
                policies that serve and of each baseline; None where nothing is measured.
            rows: how many rows these are the routes of; None: those there are.
            lost: contexts that were to be played, and gave no episode that counts.

        Raises:
            StudyError: rows were told since, which the report would not fit.
            InvalidInput: they are of another shape.
        """
        others, units = dict(baselines or {}), {} if metrics is None else dict(self.beside.metrics)
        arrays = {"served": np.asarray(served, float), "alone": np.asarray(alone, float)}
        data = {"episodes": arrays["served"].shape[-1], "best_single": int(best_single)}
        more = {"baselines": [*others], "metrics": units, "lost": [int(target) for target in lost]}
        rows = len(self.refresh().rows) if rows is None else rows
        if others:
            arrays["baselines"] = np.array([*others.values()], float)
        if units:
            arrays["metrics"] = np.asarray(metrics, float)

        def reported(state: StudyState) -> Event:
            if (told := len(state.rows)) != rows:
                raise StudyError(
                    f"fresh returns are of the {told} policies told, got those of {rows}; evaluate "
                    "again"
                )
            given = {name: facts for name, facts in more.items() if facts}
            return Event("reported", {**data, **given}, arrays)

        self._commit(reported)

    def stop(self, reason: str = "it was stopped") -> None:
        """End the run of this object that goes on, from a callback or another thread.

        What is under way is finished and told; no more is asked for. The study itself is not
        finished: the next `run` goes on.

        Args:
            reason: for people.
        """
        self.stopping = reason

    # ---- inside -------------------------------------------------------------------------------

    def _ask(self, lease: float | None) -> Pick:
        turn = _Turn(_LONGEST_PAUSE)
        watch, watched = self.watch(), time.monotonic()

        def wanted(state: StudyState) -> Event | None:
            return ask.claim(state, watch, lease, self.worker)

        while True:
            if time.monotonic() - watched > _WATCH:
                watch, watched = self.watch(), time.monotonic()
            claim = self._commit(wanted)
            if claim is None:  # somebody proposes just now
                turn.wait()
                continue
            if claim.kind == "released":
                continue
            number, token = claim.data["pick"], claim.data["token"]
            if number == len(self._state.picks) and not self._propose(token, lease):
                continue
            given = self._pick(self._state.picks[number])
            if given.token == token:
                self._warn_by_hand(given)
                return given

    def _warn_by_hand(self, pick: Pick) -> None:
        """Before the first training: what is not tried; nobody else says it."""
        by_hand = self.trainer is not None and self.spec.any_training
        if pick.number or not (by_hand and self._state.problem().assumed):
            return
        for note in self._state.picks[0].notes:
            try:
                warnings.warn(note, Notice, stacklevel=4)
            except Notice:  # where warnings are errors
                self.release(pick)
                raise

    def _propose(self, token: str, lease: float | None) -> bool:
        """Find and record the source of the next pick; False where somebody else has done so.

        Raises:
            StudyFinished: there is none, or it would not be worth it.
        """
        holder = {"worker": self.worker, "token": token, "seconds": lease}
        event: Event | None = None
        try:
            while event is None:
                with self._lock:
                    if not self.refresh().is_proposed_with(token):
                        return False
                    moment = self._state.copied()
                found = ask.propose(moment, self.selector)  # others may tell meanwhile
                event = self._commit(
                    partial(ask.settled, moment=moment, found=found, holder=holder)
                )
        finally:
            if event is None:
                self._stop_proposing(token)
        return event.kind == "asked"  # else who asks again hears why, or of what was told meanwhile

    def _stop_proposing(self, token: str) -> None:
        """Let the next asker propose at once, whatever has happened here."""

        def released(state: StudyState) -> Event | None:
            mine = state.is_proposed_with(token)
            return Event("released", {"pick": len(state.picks)}) if mine else None

        with contextlib.suppress(StorageError):  # it ends by the clock, too
            self._commit(released)

    def _pick(self, record: PickRecord) -> Pick:
        return Pick(
            record.number,
            record.source,
            self.space.context(record.source),
            self._state.seed_of(record),
            record.reason,
            record.targets,
            record.sources,
            tuple(self.space.context(source) for source in record.sources),
            record.start,
            record.done,
            None if record.whole else record.length,
            record.tokens[-1] if record.leases else "",
        )

    def _commit(self, decide: Callable[[StudyState], Decided]) -> Decided:
        """Append what `decide` makes of the newest state; decide anew if somebody was faster."""
        turn = _Turn(_LONGEST_COMMIT)
        while True:
            try:
                return self._attempt(decide)
            except Conflict:
                turn.wait()

    def _attempt(self, decide: Callable[[StudyState], Decided]) -> Decided:
        """Append what `decide` makes of the newest state, which no other thread changes meanwhile.

        Returns:
            The event; None where there is nothing to append.

        Raises:
            Conflict: another process was faster.
            StudyError: the study was deleted.
        """
        with self._lock:
            event = decide(self.refresh())
            if event is None:
                return event
            check_event(event, self._state)
            before = self._holder(event)
            try:
                self.log.append(event, after=self._state.seq)
            except Conflict:
                if not self.log.read(self._state.seq):  # nobody was faster
                    raise StudyError(f"the study {self.name!r} is gone: it was deleted") from None
                raise
            self.refresh()
            if before is not None:
                self.presence.succeed(before, self.leases)
            return event

    def _holder(self, event: Event) -> str | None:
        """Name of the worker whose pick an event gives to somebody else; None: nobody's."""
        if event.kind not in ("claimed", "released"):
            return None
        held = self._state.open_picks.get(event.data["pick"])
        lease = self._state.proposing if held is None else held.lease
        return None if lease is None else lease.worker

    def _answer(
        self,
        kind: Kind,
        pick: Any,
        data: dict[str, Any],
        more: Callable[[StudyState], dict[str, Any]] | None = None,
        arrays: Mapping[str, Array] = {},
    ) -> bool:
        """Record an answer; False: it comes too late.

        Args:
            kind: of the event.
            pick: what is answered.
            data: facts.
            more: those that the newest state decides; None: which open pick it is, alone.
            arrays: of the event.
        """
        if isinstance(pick, Pick) and pick.token:
            data = {**data, "token": pick.token}

        def answered(state: StudyState) -> Event:
            if isinstance(pick, Pick) and tell.is_late(state, pick):
                return Event("late", {**data, "pick": pick.number, "outcome": kind}, arrays)
            last = {"pick": tell.open_number(state, pick)} if more is None else more(state)
            return Event(kind, {**data, **last}, arrays)

        return self._commit(answered).kind == kind


class _Turn:
    """Waits for a moment, and for longer each time."""

    def __init__(self, longest: float) -> None:
        self._pause, self._longest = _PAUSE, longest

    def wait(self) -> None:
        time.sleep(self._pause * random.random())
        self._pause = min(2 * self._pause, self._longest)
