"""A study that is paid in steps: a strategy says what to train on, how long, and where to look.

    study = mbtl.create_study(mbtl.get_cmdp("cartpole-length"), cost="steps", budget=2_000_000)
    result = study.run()
    study.portfolio().policy_for({"length": 0.7})

Every environment step is charged: of trainings, of extensions, of the evaluations that trainings
make of themselves, and of episodes on targets. The log of events is the study, as everywhere: a run
that is killed goes on where it was.
"""

from __future__ import annotations

import contextlib
import shutil
import tempfile
import weakref
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mbtl.actions import Policy, Strategy, Trail
from mbtl.actions.base import filled_rows
from mbtl.arrays import Array
from mbtl.contexts import ContextSpace
from mbtl.errors import InvalidInput, StudyError
from mbtl.objective import Bounds
from mbtl.portfolio import Portfolio
from mbtl.study.artifacts import ArtifactStore
from mbtl.study.events import OPENED, Event, Kind
from mbtl.study.leases import Lease, Watch, check_holds, new_worker
from mbtl.study.listing import chosen_name, database_at
from mbtl.study.places import database_file, policy_store
from mbtl.study.presence import Presence
from mbtl.study.steps.claims import LEASE
from mbtl.study.steps.spec import StepSpec
from mbtl.study.steps.state import StepState
from mbtl.study.steps.strategies import DEFAULT, STRATEGIES, strategy_named
from mbtl.study.storage import Conflict, EventLog, SqlLog
from mbtl.trainer import FunctionTrainer, Trainer

if TYPE_CHECKING:
    from mbtl.study.steps.callbacks import StepCallback
    from mbtl.study.steps.summary import StepResult, StepSummary


class StepStudy:
    """One study over an event log. Make one with `mbtl.create_study(..., cost="steps")`.

    Attributes:
        name: within its storage.
        artifacts: keeps the policies; None: they cannot be kept.
        trainer: trains and reads policies where no other is given.
        policies: (training, mark) -> policy, of this process.
        worker: name by which this object holds actions.
        presence: who surely is gone, where that can be known.
    """

    def __init__(
        self,
        log: EventLog,
        strategy: Strategy,
        *,
        store: ArtifactStore | None = None,
        name: str = "study",
        trainer: Trainer | None = None,
    ) -> None:
        """The log must hold an `opened` event."""
        self.name, self.artifacts, self.trainer = name, store, trainer
        self.worker = new_worker()
        self.presence = Presence(database_file(getattr(log, "url", "")))
        self.strategy = strategy
        self.policies: dict[tuple[int, int], Any] = {}
        self._log, self._state = log, StepState()
        self.refresh()

    @classmethod
    def load(
        cls,
        storage: str | Path,
        name: str | None = None,
        *,
        trainer: Trainer | None = None,
        strategy: str | Strategy | None = None,
        artifacts: str | Path | None = None,
    ) -> StepStudy:
        """Open an existing study that is paid in steps.

        Args:
            storage: path of the SQLite file (or of the folder that holds `study.db`), or a URL.
            name: name of the study; needed only when the storage holds several.
            trainer: what `run` trains with, and what reads the policies.
            strategy: as it was given to `create_study`; needed only for one of your own.
            artifacts: folder or URL of the policies, as it was given to `create_study`.

        Raises:
            StudyError: no such study, or one that is paid in trainings.
            StorageError: no database there, or a damaged one.
        """
        place = database_at(storage)
        name = chosen_name(place, name)
        log = SqlLog(place, name)
        first = next(iter(log.read()), None)
        if first is None or first.kind != OPENED:
            raise StudyError(
                f"{name!r} in {place} is paid in trainings, not in steps; open it with "
                "mbtl.load_study"
            )
        store = policy_store(place, artifacts)
        if strategy is None:
            known = str(first.data["spec"]["strategy"]["name"])
            strategy = known if known in STRATEGIES else DEFAULT
        return cls(log, strategy_named(strategy), store=store, name=name, trainer=trainer)

    # ---- reading -----------------------------------------------------------------------------

    def refresh(self) -> StepState:
        """Apply what was appended since, and return the state."""
        for event in self._log.read(self._state.seq):
            self._state.apply(event)
        if self._state.spec is None:
            raise StudyError(f"there is no study {self.name!r} in this storage; create it first")
        return self._state

    def events(self) -> Iterable[Event]:
        """The log from its beginning."""
        return self._log.read()

    @property
    def log(self) -> EventLog:
        """Where the events are."""
        return self._log

    @property
    def leases(self) -> list[Lease]:
        """Those in force, as of the last `refresh`."""
        held = self._state.under_way.values()
        return [one.lease for one in held if one.lease is not None]

    def release_all(self, worker: str) -> int:
        """Give back all that a worker holds; see `mbtl.Study.release_all`."""
        self.refresh()
        check_holds(worker, self.leases)
        count = 0
        while True:
            state = self.refresh()
            held = ((n, one.lease) for n, one in state.under_way.items())
            theirs = [(n, one.token) for n, one in held if one and one.worker == worker]
            if not theirs:
                self.presence.succeed(worker, self.leases)
                return count
            decision, token = theirs[0]
            with contextlib.suppress(Conflict):
                self.append("released", {"decision": decision, "token": token}, after=state.seq)
                count += 1

    def watch(self) -> Watch:
        """Which workers are silent for too long at this moment."""
        return Watch(self._log, self.presence.is_gone)

    @property
    def spec(self) -> StepSpec:
        """What the study was opened with."""
        return self._state.the_spec

    @property
    def state(self) -> StepState:
        """Everything recorded, as of the last `refresh`."""
        return self._state

    @property
    def space(self) -> ContextSpace:
        """The contexts."""
        return self.spec.space

    @property
    def bounds(self) -> Bounds:
        """Normalisation in force: given, or the range of the returns seen so far."""
        return self._state.bounds()

    @property
    def trail(self) -> Trail:
        """What the strategy sees."""
        return self._state.trail()

    @property
    def is_durable(self) -> bool:
        """True when the study outlives this process."""
        return isinstance(self._log, SqlLog)

    @property
    def is_finished(self) -> bool:
        """True when nothing more is to be done."""
        return self._state.stopped is not None

    @property
    def value(self) -> float:
        """V by the rows that route the policies, performance; -inf before the first one."""
        return self._state.value()

    def summary(self) -> StepSummary:
        """The study in numbers: trainings, price list, V."""
        from mbtl.study.steps.summary import summarise

        return summarise(self)

    def __repr__(self) -> str:
        spec, state = self.spec, self._state
        return (
            f"StepStudy({self.name!r}: {state.spent:,.0f} of {spec.budget:,} steps, "
            f"{len(state.policies)} policies, {spec.space!r})"
        )

    def _repr_html_(self) -> str:
        return self.summary().html()

    def portfolio(self, trainer: Trainer | None = None, *, trust: bool = False) -> Portfolio:
        """All policies that were evaluated, with their router.

        Where one was not evaluated its return lies between those of its neighbours that were.

        Args:
            trainer: reads the saved policies; None: the study's own.
            trust: without a trainer, also read files that can execute code.

        Raises:
            StudyError: no policy was evaluated so far.
        """
        state, spec = self.refresh(), self.spec
        if not state.policies:
            raise StudyError("a portfolio needs a policy that was evaluated, and none was so far")
        trainer = self.trainer if trainer is None else trainer
        keys = [self.key(policy) for policy in state.policies]
        marks = [state.trainings[j].marks[mark] for j, mark in keys]
        folders = [
            self.artifacts.read(mark.place, mark.sha256) if self.artifacts and mark.place else None
            for mark in marks
        ]
        format_ = "custom" if trainer is None else trainer.policy_format
        return Portfolio(
            self.space,
            tuple(state.trainings[j].source for j, _ in keys),
            filled_rows(np.array(state.returns), self.space.steps),
            self.bounds,
            spec.problem_without(()).selection.theta,
            policy_folders=folders,
            policy_format=str(spec.settings.get("policy_format", format_)),
            load=None if trainer is None else trainer.load,
            in_memory={i: self.policies[key] for i, key in enumerate(keys) if key in self.policies},
            sets={
                i: state.trainings[j].on for i, (j, _) in enumerate(keys) if state.trainings[j].on
            },
            cmdp=spec.problem or None,
            metadata={
                "study": self.name,
                "strategy": dict(spec.strategy),
                "settings": dict(spec.settings),
                "steps": [mark.steps for mark in marks],
                "evaluated": [int(np.isfinite(row).sum()) for row in state.returns],
            },
            trust=trust,
        )

    def key(self, policy: Policy) -> tuple[int, int]:
        """Training and mark whose weights a policy has."""
        return policy.training, self._state.trainings[policy.training].at(policy.length)[0]

    # ---- changing ----------------------------------------------------------------------------

    def extend(self, budget: int) -> None:
        """Raise the budget to so many environment steps in all.

        Raises:
            InvalidInput: it is not larger than now.
        """
        if budget <= self.refresh().the_spec.budget:
            raise InvalidInput(
                f"a budget can only be raised, from {self.spec.budget:,} steps, got {budget:,}"
            )
        self.append("extended", {"budget": int(budget)})

    def append(
        self,
        kind: Kind,
        data: Mapping[str, Any],
        arrays: Mapping[str, Array] | None = None,
        *,
        after: int | None = None,
    ) -> None:
        """Record an event.

        Args:
            kind: of it.
            data: its facts.
            arrays: its numbers.
            after: the event that it follows from; None: it holds whatever others have recorded.

        Raises:
            Conflict: others have recorded something after `after`.
        """
        while True:
            seq = self._state.seq if after is None else after
            try:
                self._log.append(Event(kind, data, arrays or {}), after=seq)
            except Conflict:
                if after is not None:
                    raise
                self.refresh()
                continue
            self.refresh()
            return

    @cached_property
    def scratch(self) -> Path:
        """A folder for trainings under way where the store has no room for them."""
        folder = tempfile.mkdtemp(prefix="mbtl-steps-")
        weakref.finalize(self, shutil.rmtree, folder, ignore_errors=True)
        return Path(folder)

    def run(
        self,
        train: Callable[..., Any] | None = None,
        evaluate: Callable[..., Any] | None = None,
        *,
        save: Callable[[Any, Path], None] | None = None,
        load: Callable[[Path], Any] | None = None,
        trainer: Trainer | None = None,
        progress: bool = True,
        callbacks: Sequence[StepCallback] = (),
        report: bool = True,
        stop_after_failures: int = 3,
        lease: float = LEASE,
        wait: bool = True,
        accept_changes: bool = False,
        timeout: float | None = None,
    ) -> StepResult:
        """Spend the steps; interrupted, it goes on where it was when called again.

        Several processes may run a stored study at the same time: each takes the next action, where
        the strategy says that it can decide while others are at work, and waits otherwise.

        Args:
            train: `train(contexts, seed, *, start=None, length=None) -> policy`, see
                `mbtl.trainer.FunctionTrainer`; a length of 1.0 is the last of the study's. A
                function `train(context, seed)` will do where the study has one length.
            evaluate: policy, contexts, seeds -> returns, (n_targets,) or (n_targets, n_episodes);
                one seed per context, see `mbtl.trainer.FunctionTrainer`.
            save: policy, empty folder -> None; needed by studies that are stored.
            load: folder -> policy.
            trainer: instead of these functions; None: the one that the study was made with.
            progress: print a line per piece of work to standard error.
            callbacks: told what happens.
            report: evaluate the routed policies on as many fresh episodes at the end; not charged.
            stop_after_failures: so many trainings or evaluations that fail in a row end the run.
            lease: seconds without a sign of life after which others take an action over. On one
                machine they do so at once when the process has ended.
            wait: stay while others are at the last actions, to take over from those that die.
            accept_changes: go on although own functions have changed since the study was begun.
            timeout: seconds that a training to its next mark, or an evaluation, may take; longer
                ones are ended and count as failed. Native code ends when it returns.

        Raises:
            InvalidInput: the trainer cannot do what the study asks: other lengths than its own,
                trainings that go on, policies that outlive the process.
            TrainingFailed: failures ended the run.
        """
        from mbtl.study.steps.callbacks import PrintSteps
        from mbtl.study.steps.runner import run  # it joins study, strategy and trainer

        if train is not None or evaluate is not None:
            if trainer is not None or train is None or evaluate is None:
                raise InvalidInput("run takes train and evaluate functions, or a trainer")
            trainer = FunctionTrainer(train, evaluate, save, load)
        trainer = self.trainer if trainer is None else trainer
        if trainer is None:
            raise InvalidInput("run needs train and evaluate functions, or a trainer")
        told = (*callbacks, *([PrintSteps()] if progress else []))
        return run(
            self, trainer, callbacks=told, report=report, stop_after_failures=stop_after_failures,
            lease=lease, wait=wait, accept_changes=accept_changes, timeout=timeout,
        )  # fmt: skip
