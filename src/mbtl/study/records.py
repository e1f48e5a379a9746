"""What `ask` gives, and what the log says of picks, rows, failures and reports: one record each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

from mbtl.arrays import Array
from mbtl.contexts import Context
from mbtl.episodes import episode_moments
from mbtl.errors import StudyError
from mbtl.faults import harmless
from mbtl.study.leases import Lease


class StudyFinished(StudyError):
    """There is nothing left to ask for."""


class StudyWaiting(StudyFinished):
    """There is nothing to ask for until a pick is answered that is under way."""


@dataclass(frozen=True)
class Pick:
    """A training to do, or a policy to evaluate further.

    Attributes:
        number: 0-based number of the pick in its study; what people are shown counts from 1.
        source: index of the context trained on; of several, the one in their middle.
        context: that context, axis name -> value.
        seed: training seed; it depends on what is trained, not on the pick number.
        reason: why the strategy chose it.
        targets: contexts worth evaluating on, their indices; None for all.
        sources: indices of all contexts trained on.
        contexts: those contexts.
        start: number of the event that told the policy to begin with (`ToldRow.event`); None: from
            scratch.
        done: units that the training has had by then, where it goes on; 0 for a new one.
        length: units that it has had in all when it is done; 0: the policy is only evaluated; None:
            a whole training, as long as the trainer has it.
        token: of its lease; who takes the pick over gets another one.
    """

    number: int
    source: int
    context: Context
    seed: int
    reason: str
    targets: tuple[int, ...] | None = None
    sources: tuple[int, ...] = ()
    contexts: tuple[Context, ...] = field(default=(), repr=False)
    start: int | None = None
    done: float = 0.0
    length: float | None = None
    token: str = field(default="", compare=False)

    @property
    def trains(self) -> bool:
        """False where a policy is only evaluated."""
        return self.length != 0.0

    def __str__(self) -> str:
        where = ", ".join(f"{name} = {value}" for name, value in self.context.items())
        if len(self.sources) > 1:
            where = f"{len(self.sources)} contexts"
        return harmless(f"pick {self.number + 1}: {where} ({self.reason})")


@dataclass(frozen=True, kw_only=True)
class Plan:
    """What a training is, whether it was done or not.

    Attributes:
        source: context index; of several, the one in their middle.
        sources: indices of all contexts trained on.
        start: number of the event that told the policy to begin with; None: from scratch.
        done: units that the training has had before, where it goes on; 0: it does not.
        length: units that it has had in all; 0: a policy is only evaluated.
    """

    source: int
    sources: tuple[int, ...]
    start: int | None
    done: float
    length: float

    @property
    def price(self) -> float:
        """Units that it costs."""
        return max(self.length - self.done, 0.0) if self.length else 0.0


@dataclass(frozen=True, kw_only=True)
class PickRecord(Plan):
    """One proposal of the strategy, as logged.

    Attributes:
        number: 0-based number of the pick.
        reason: why the selector chose it.
        acquisition: what it expected of it; None where it has no such number.
        notes: what went differently from the plan.
        asked_at: seconds since the epoch.
        targets: contexts to evaluate on; None: all.
        whole: as long as the trainer has it, nobody having asked for another length.
        lease: who may answer it; None: nobody holds it.
        leases: all that it ever had, the first one first.
        answered_by: token of the answer; empty where it came without; None: not answered.
        abandoned: how often a holder fell silent, so that somebody else took it over.
        retries: how often it failed and was begun again, each time with another seed.
    """

    number: int
    reason: str
    acquisition: float | None
    notes: tuple[str, ...]
    asked_at: float
    targets: tuple[int, ...] | None
    whole: bool
    lease: Lease | None = None
    leases: tuple[Lease, ...] = ()
    answered_by: str | None = None
    abandoned: int = 0
    retries: int = 0

    @property
    def worker(self) -> str | None:
        """Name of the holder; None: nobody holds it."""
        return None if self.lease is None else self.lease.worker

    @property
    def tokens(self) -> tuple[str, ...]:
        """Of all its leases."""
        return tuple(lease.token for lease in self.leases)

    def leased(self, lease: Lease | None) -> PickRecord:
        """The same with another holder, or none."""
        new = () if lease is None else (lease,)
        silent = bool(new) and self.lease is not None
        return replace(
            self,
            lease=lease,
            leases=(*self.leases, *new),
            answered_by=None,
            abandoned=self.abandoned + silent,
        )


LOGGED = (
    "pick", "cost", "seconds", "policy", "sha256", "recipe", "steps", "state", "state_sha256",
)  # fmt: skip
"""Facts of a row that its event has under the same name."""


@dataclass(frozen=True, kw_only=True)
class ToldRow(Plan):
    """One transfer row, as logged.

    Attributes:
        pick: number of the pick it answers; None for a source nobody asked for.
        each: (N, E) returns of single episodes, raw units; NaN where there is none.
        cost: cost of the training in the user's unit.
        seconds: wall time of training and evaluation; None when unknown.
        policy: folder of the saved policy, relative to the study; None when not saved.
        told_at: seconds since the epoch.
        event: number of the event that told it, by which it may be voided.
        sha256: of the policy's files; None: not known.
        recipe: digest of the recipe that it was made with; None: not known.
        steps: environment steps of the training; None: not known.
        state: folder of the training's state, to go on from exactly; None: there is none.
        state_sha256: of its files.
    """

    pick: int | None
    each: Array
    cost: float
    seconds: float | None
    policy: str | None
    told_at: float
    event: int
    sha256: str | None
    recipe: str | None
    steps: float | None
    state: str | None
    state_sha256: str | None

    @cached_property
    def returns(self) -> Array:
        """(N,) mean returns, raw units; NaN where it was not evaluated."""
        return self.each[:, 0] if self.episodes == 1 else episode_moments(self.each)[0]

    @property
    def std(self) -> Array:
        """(N,) standard deviation over episodes; NaN for one. See `mbtl.episodes`."""
        return episode_moments(self.each)[1]

    @property
    def episodes(self) -> int:
        """Episodes behind each mean."""
        return int(self.each.shape[1])


@dataclass(frozen=True)
class Failure:
    """A pick that gave nothing, and why.

    Attributes:
        source: context index.
        pick: 0-based number of the pick.
        reason: the error in one line.
        traceback: where it came from; empty where nobody said.
        pruned: it was ended early on purpose.
        steps: environment steps that it had; None: not known.
    """

    source: int
    pick: int
    reason: str
    traceback: str = ""
    pruned: bool = False
    steps: float | None = None

    @classmethod
    def of(cls, data: Mapping[str, Any], source: int) -> Failure:
        """As logged, of a pick with this source."""
        pruned = data.get("pruned") is True
        trace, steps = data.get("traceback") or "", data.get("steps")
        return cls(source, data["pick"], data["reason"], trace, pruned, steps)


@dataclass(frozen=True)
class FreshReturns:
    """What policies gave on fresh episodes, which chose nothing.

    Attributes:
        served: (N, E) of the policies that serve, raw units, `completed`; NaN where a context was
            not played.
        alone: (N, E) of the best single policy, on the same episodes.
        best_single: its place among the rows.
        baselines: name -> (N, E) of what V is compared with, on the same episodes.
        units: of what is measured beside the score, by name.
        metrics: name -> (N,) mean of each measure, of the policies that serve, as "policies", and
            of the baselines; NaN where a context was not played or did not tell it.
        lost: contexts that were to be played, and gave no episode that counts.
        fewest: episodes that count of a context that was played.
    """

    served: Array
    alone: Array
    best_single: int
    baselines: Mapping[str, Array] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    metrics: Mapping[str, Mapping[str, Array]] = field(default_factory=dict)
    lost: tuple[int, ...] = ()
    fewest: int = 0
