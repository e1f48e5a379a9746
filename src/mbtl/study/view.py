"""Reading a study: what its log says, and what follows from that. Nothing here changes it."""

from __future__ import annotations

import threading
from collections.abc import Callable
from functools import partial, wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, Concatenate, ParamSpec, TypeVar

import numpy as np

from mbtl.arrays import Array
from mbtl.contexts import ContextSpace
from mbtl.errors import StudyError
from mbtl.history import History
from mbtl.objective import Bounds
from mbtl.routing import Routing
from mbtl.selectors import SelectionProblem
from mbtl.study import asking
from mbtl.study.artifacts import ArtifactStore, FolderStore
from mbtl.study.fresh import value_of
from mbtl.study.job import Kept
from mbtl.study.leases import Lease, Watch, new_worker
from mbtl.study.places import database_file
from mbtl.study.presence import Presence
from mbtl.study.spec import StudySpec
from mbtl.study.state import StudyState
from mbtl.study.storage import EventLog, MemoryLog
from mbtl.study.trainings import Trainings, trainings_of
from mbtl.trainer import Trainer

if TYPE_CHECKING:
    from mbtl.portfolio import Portfolio


P = ParamSpec("P")
T = TypeVar("T")


def _alone(
    method: Callable[Concatenate[StudyView, P], T],
) -> Callable[Concatenate[StudyView, P], T]:
    """What reads the state, while no other thread of this process changes it."""

    @wraps(method)
    def locked(self: StudyView, /, *args: P.args, **named: P.kwargs) -> T:
        with self._lock:
            return method(self, *args, **named)

    return locked


class StudyView:
    """What a study knows; `mbtl.study.Study` asks and tells.

    Threads may share one. Sent to another process (pickled), it is opened there anew, as another
    worker; policies that are in memory only stay here.

    Attributes:
        name: within its storage.
        artifacts: keeps the policies; None: they cannot be kept.
        database: its file; None: it is on a server, or in memory.
        trainer: trains and reads policies where no other is given.
        worker: name by which this object holds picks.
        presence: who surely is gone, where that can be known.
        policies: number of the row -> policy, for policies of this process that were not saved.
        untold: number of the pick -> what is trained, not saved, and not evaluated so far.
        stopping: why the run that goes on is to end (`Study.stop`); None: it is not.
    """

    def __init__(
        self,
        log: EventLog,
        *,
        folder: Path | ArtifactStore | None,
        name: str,
        trainer: Trainer | None,
        state: StudyState | None = None,
    ) -> None:
        """The log must hold a `created` event; `state` is what was read of it before."""
        self.name = name
        self.artifacts = FolderStore(folder.absolute()) if isinstance(folder, Path) else folder
        self.trainer = trainer
        self.policies: dict[int, Any] = {}
        self.untold: dict[int, Kept] = {}
        self.stopping: str | None = None
        self._made: str | None = None  # digest of what this object's policies are made with
        self.worker = new_worker()
        self.database = database_file(getattr(log, "url", ""))
        self.presence = Presence(self.database)
        self._log = log
        self._lock = threading.RLock()
        self._state = StudyState() if state is None else state
        self.refresh()

    def __repr__(self) -> str:
        told, state, spec = len(self._state.rows), self._state, self.spec
        usual = spec.steps is None and not spec.any_training
        how = f"{told} of {spec.budget} trainings told" if usual else (
            f"{told} policies told, {state.spent_words()}"
        )  # fmt: skip
        return f"Study({self.name!r}: {how}, {spec.space!r})"

    def __reduce__(self) -> tuple[Any, ...]:
        if isinstance(self._log, MemoryLog):
            raise StudyError(
                f"a study in memory lives in one process, so {self.name!r} cannot be sent to "
                "another or copied; make it with storage=<path or URL>"
            )
        given: dict[str, Any] = {
            "folder": self.artifacts,
            "name": self.name,
            "trainer": self.trainer,
        }
        return partial(type(self), **given), (self._log, *self._sent())

    def _sent(self) -> tuple[Any, ...]:
        """Further arguments with which another process opens this study."""
        return ()

    @_alone
    def refresh(self) -> StudyState:
        """Apply what other processes appended, and return the state."""
        for event in self._log.read(self._state.seq):
            gone = self._state.place_of(event.data.get("told")) if event.kind == "voided" else None
            self._state.apply(event)
            if gone is not None:  # policies are kept by the place of their row
                kept = {i: p for i, p in self.policies.items() if i != gone}
                self.policies = {i - (i > gone): policy for i, policy in kept.items()}
        if self._state.spec is None:
            raise StudyError(f"there is no study {self.name!r} in this storage; create it first")
        return self._state

    @property
    def folder(self) -> Path | None:
        """Policies are saved below it; None where they are elsewhere, or nowhere."""
        return self.artifacts.root if isinstance(self.artifacts, FolderStore) else None

    @property
    def log(self) -> EventLog:
        """Where the events are."""
        return self._log

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
        return not isinstance(self._log, MemoryLog)

    @property
    @_alone
    def stop_reason(self) -> str | None:
        """Why nothing more can be asked; None while something can."""
        return asking.stop_reason(self._state)

    @property
    @_alone
    def is_finished(self) -> bool:
        """True when nothing can be asked and nobody works on a pick."""
        return asking.is_finished(self._state)

    @property
    @_alone
    def has_succeeded(self) -> bool:
        """True when a pick was told; rows that nobody asked for show no training at work."""
        return any(row.pick is not None for row in self._state.rows)

    @property
    @_alone
    def trainings(self) -> Trainings:
        """What became of each pick, and of rows that nobody asked for, one typed line each."""
        return trainings_of(self.refresh(), self.watch())

    def to_frame(self) -> Any:
        """A pandas table of the trainings, a line each.

        Raises:
            MissingExtra: pandas is not installed.
        """
        return self.trainings.to_frame()

    def _repr_html_(self) -> str:
        return self.trainings.html(repr(self))

    @property
    @_alone
    def orphans(self) -> list[int]:
        """Numbers of open picks that nobody works on: given back, or their lease is stale."""
        return asking.left_alone(self._state, self.watch())

    @property
    def leases(self) -> list[Lease]:
        """Those in force, as of the last `refresh`: of open picks, and of the one to come."""
        held = [pick.lease for pick in self._state.open_picks.values()]
        return [lease for lease in (*held, self._state.proposing) if lease is not None]

    def watch(self) -> Watch:
        """Which leases are stale now."""
        return Watch(self._log, self.presence.is_gone)

    @_alone
    def portfolio(self, trainer: Trainer | None = None, *, trust: bool = False) -> Portfolio:
        """The trained policies with their router.

        Args:
            trainer: reads the saved policies, all of them: give the one that wrote them. None: the
                study's own, if they are of a format of its own ("custom").
            trust: without a trainer, also read files that can execute code; set it if the study
                is your own, or of somebody you trust.

        Raises:
            StorageError: a policy's folder is not inside the study's, or is reached by a link, or
                a policy is not the one that was told.
        """
        from mbtl.portfolio import Portfolio

        rows, spec = self.refresh().rows, self.spec
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
            self.problem.theta,
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
