"""Trainings of a study as typed lines: what became of each pick, and of rows nobody asked for."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, Literal

from mbtl.contexts import Context
from mbtl.errors import missing_extra
from mbtl.notebook import table
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
        context: trained on.
        state: "done"; "failed"; "pruned", ended early on purpose; "running"; "stale", its worker
            is not heard of any more; "waiting", given back, or trained and not evaluated so far.
        home_return: mean return on its own context, raw units; None where not evaluated.
        value: V after it, performance, by the rows that routed the policies; None unless done.
        seconds: wall time of training and evaluation; None: not known.
        steps: environment steps that the training last reported; None: it reported none.
        cost: of the training, in the unit of the cost budget; None unless done.
        worker: name of who held it last; None: nobody did, or it is not known.
        seed: of the training; None where nobody asked for it.
        reason: why the selector chose it; empty where nobody asked.
        error: why it gave nothing, or why its policy was not evaluated so far; None otherwise.
    """

    number: int | None
    source: int
    context: Context
    state: State
    home_return: float | None
    value: float | None
    seconds: float | None
    steps: float | None
    cost: float | None
    worker: str | None
    seed: int | None
    reason: str
    error: str | None


class Trainings(tuple[Training, ...]):
    """Trainings in the order in which they were asked for, or told unasked."""

    def to_frame(self) -> Any:
        """A pandas table, a line per training; `context_<axis>` has the values of each axis.

        Raises:
            MissingExtra: pandas is not installed.
        """
        try:
            import pandas
        except ModuleNotFoundError as error:
            raise missing_extra("pandas", "frames") from error
        names = [f.name for f in fields(Training) if f.name != "context"]
        lines = [
            {name: getattr(one, name) for name in names[:3]}
            | {f"context_{axis}": value for axis, value in one.context.items()}
            | {name: getattr(one, name) for name in names[3:]}
            for one in self
        ]
        return pandas.DataFrame(lines, columns=list(lines[0]) if lines else names)

    def html(self, title: str) -> str:
        """For notebooks, with a caption."""
        heads = ("pick", "context", "state", "return there", "V after it", "worker", "")
        lines = [
            (
                None if one.number is None else one.number + 1,
                ", ".join(f"{axis} = {value}" for axis, value in one.context.items()),
                one.state,
                one.home_return,
                one.value,
                one.worker,
                one.error or one.reason,
            )
            for one in self
        ]
        return table(title, heads, lines)

    def _repr_html_(self) -> str:
        return self.html(f"{len(self)} trainings")


def trainings_of(state: StudyState, watch: Watch) -> Trainings:
    """All of a study, as of this state."""
    rows = {row.pick: place for place, row in enumerate(state.rows) if row.pick is not None}
    failures = {failure.pick: failure for failure in state.failures}
    curve = state.curve()
    found: list[tuple[float, Training]] = []
    for pick in state.picks:
        place = rows.get(pick.number)
        row = None if place is None else state.rows[place]
        value = None if place is None else float(curve[place])
        failure = failures.get(pick.number)
        found.append((pick.asked_at, _of_pick(state, watch, pick, row, value, failure)))
    for place, row in enumerate(state.rows):
        if row.pick is None:
            found.append((row.told_at, _unasked(state, row, float(curve[place]))))
    return Trainings(one for _, one in sorted(found, key=lambda pair: pair[0]))


def _of_pick(
    state: StudyState,
    watch: Watch,
    pick: PickRecord,
    row: ToldRow | None,
    value: float | None,
    failure: Failure | None,
) -> Training:
    spec = state.spec
    if row is not None:
        condition: State = "done"
    elif failure is not None:
        condition = "pruned" if failure.pruned else "failed"
    elif pick.number not in state.open_picks:  # a policy was evaluated further
        condition = "done"
    elif pick.lease is None:
        condition = "waiting"
    else:
        condition = "stale" if watch.is_stale(pick.lease) else "running"
    trouble = failure or state.deferred.get(pick.number)
    return Training(
        pick.number,
        pick.source,
        spec.space.context(pick.source),
        condition,
        None if row is None else _at_home(row),
        value,
        None if row is None else row.seconds,
        row.steps if row is not None and row.steps is not None else _reported(watch, pick),
        None if row is None else row.cost,
        pick.last_worker,
        state.seed_of(pick),
        pick.reason,
        None if trouble is None else trouble.reason,
    )


def _unasked(state: StudyState, row: ToldRow, value: float) -> Training:
    context = state.spec.space.context(row.source)
    return Training(
        None, row.source, context, "done", _at_home(row), value, row.seconds, row.steps, row.cost,
        None, None, "", None,
    )  # fmt: skip


def _at_home(row: ToldRow) -> float | None:
    own = float(row.returns[row.source])
    return own if own == own else None  # NaN: not evaluated there


def _reported(watch: Watch, pick: PickRecord) -> float | None:
    """Steps by the last heartbeat of whoever held it last and said so."""
    said = [watch.beat(token) for token in reversed(pick.tokens)]
    return next((beat.steps for beat in said if beat is not None and beat.steps is not None), None)
