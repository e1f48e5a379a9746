"""Trainings of a study as typed lines: what became of each pick, and of rows nobody asked for."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

from mbtl.arrays import Array
from mbtl.contexts import Context, ContextSpace
from mbtl.study.leases import Watch
from mbtl.study.records import Failure, PickRecord, ToldRow
from mbtl.study.state import StudyState

State = Literal["done", "failed", "pruned", "running", "stale", "waiting"]


@dataclass(frozen=True)
class Training:
    """One training.

    Attributes:
        number: 0-based number of its pick; None for a row that nobody asked for.
        source: context index; of several, the one in their middle.
        context: that context.
        state: "done"; "failed"; "pruned", ended early on purpose; "running"; "stale", its worker
            is not heard of any more; "waiting", given back, or trained and not evaluated so far.
        home_return: mean return on its own context, raw units; None where not evaluated.
        value: V after it, performance, by the rows that routed the policies; None unless told.
        seconds: wall time of training and evaluation; None: not known.
        steps: environment steps of the training; None: it is not answered, or they are not known.
        cost: of the training, in the unit of the cost budget; None unless told.
        worker: name of who held it last; None: nobody did, or it is not known.
        seed: of the training; None where nobody asked for it.
        reason: why the strategy chose it.
        error: why it gave nothing, or why its policy was not evaluated so far; None otherwise.
        sources: indices of all contexts trained on.
        length: units of the training in all.
        how: from what and how long, e.g. "1 to 2 units", "tuned from training 1"; empty for a
            whole training from scratch.
        promised: gain in V that the strategy expected; None where it says none.
        traceback: of an error, where it came from; empty where that is not known.
        place: of its policy among the rows; None: there is none.
    """

    number: int | None
    source: int
    context: Context
    state: State = "done"
    home_return: float | None = None
    value: float | None = None
    seconds: float | None = None
    steps: float | None = None
    cost: float | None = None
    worker: str | None = None
    seed: int | None = None
    reason: str = "told by the user"
    error: str | None = None
    sources: tuple[int, ...] = ()
    length: float = 1.0
    how: str = ""
    promised: float | None = None
    traceback: str = ""
    place: int | None = None

    @property
    def status(self) -> str:
        """What people read: "told", "failed: ...", "pruned: ...", "open: ...", "evaluated"."""
        if self.place is not None:
            return "told"
        if self.state == "done":
            return "evaluated"
        what = self.state if self.state in ("failed", "pruned") else "open"
        return what if self.error is None else f"{what}: {self.error}"

    def trained_on(self, space: ContextSpace, between: str = ", ") -> str:
        """What it is, for people, with `between` between its parts; as `StudyState.said`."""
        where = space.describe_set(self.sources, between)
        return f"{where}{between}{self.how}" if self.how else where


def trainings_of(state: StudyState, watch: Watch) -> tuple[Training, ...]:
    """All of a study, as of this state, in the order in which they were asked for, or told."""
    failures = {failure.pick: failure for failure in state.failures}
    space, curve = state.spec.space, state.curve()
    asked: list[tuple[float, Training]] = []
    unasked: list[tuple[float, Training]] = []
    told: dict[int, dict[str, Any]] = {}
    for place, row in enumerate(state.rows):
        facts = _told(row, place, curve)
        if row.pick is None:
            context = space.context(row.source)
            one = Training(None, row.source, context, sources=row.sources, **facts)
            unasked.append((row.told_at, one))
        else:
            told[row.pick] = facts
    for pick in state.picks:
        facts = told.get(pick.number, {})
        trouble = failures.get(pick.number) or state.deferred.get(pick.number)
        if trouble is not None:
            facts = {"steps": trouble.steps, "error": trouble.reason}
            facts["traceback"] = trouble.traceback
        one = Training(
            pick.number,
            pick.source,
            space.context(pick.source),
            _condition(state, watch, pick, failures.get(pick.number)),
            worker=pick.leases[-1].worker if pick.leases else None,
            seed=state.seed_of(pick),
            reason=pick.reason,
            sources=pick.sources,
            length=pick.length,
            how=state.how(pick),
            promised=pick.acquisition,
            **facts,
        )
        asked.append((pick.asked_at, one))
    return tuple(one for _, one in sorted([*asked, *unasked], key=lambda pair: pair[0]))


def _told(row: ToldRow, place: int, curve: Array) -> dict[str, Any]:
    """What a row says of its training."""
    home = float(row.returns[row.source])
    return {
        "home_return": home if home == home else None,  # NaN: not evaluated there
        "value": float(curve[place]),
        "seconds": row.seconds,
        "cost": row.cost,
        "place": place,
        "steps": row.steps,
    }


def _condition(state: StudyState, watch: Watch, pick: PickRecord, failure: Failure | None) -> State:
    if failure is not None:
        return "pruned" if failure.pruned else "failed"
    if pick.number not in state.open_picks:
        return "done"
    if pick.lease is None:
        return "waiting"
    return "stale" if watch.is_stale(pick.lease) else "running"
