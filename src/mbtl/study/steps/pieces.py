"""What a study paid for, piece after piece: its log read as a story.

Notation (shapes): N contexts.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

import numpy as np

from mbtl.actions import Policy
from mbtl.actions.base import filled_rows
from mbtl.study.steps.state import StepState
from mbtl.study.steps.summary import counted

if TYPE_CHECKING:
    from mbtl.study.events import Event
    from mbtl.study.steps.study import StepStudy


@dataclass(frozen=True)
class Piece:
    """One piece of work.

    Attributes:
        kind: "training", "extension", "evaluation" or "failed".
        training: number, 0-based; None: a training that failed before its first mark.
        before: environment steps paid until then, all in.
        after: and with it.
        seconds: wall time; 0 where nobody knows.
        value: V after an evaluation, in the bounds that are in force now; else None.
        said: what was done, in words; of a failure where and why.
        traceback: of a failure; empty where it is not known.
    """

    kind: str
    training: int | None
    before: float
    after: float
    seconds: float
    value: float | None
    said: str
    traceback: str = ""


def pieces(study: StepStudy) -> tuple[Piece, ...]:
    """All pieces of work of a study, in the order in which they were paid for."""
    return tuple(_pieces(study, study.events()))


def _pieces(study: StepStudy, events: Iterable[Event]) -> Iterable[Piece]:
    state, bounds, space = StepState(), study.bounds, study.space
    rows = np.empty((0, space.n))
    for event in events:
        before = asdict(state.prices)
        state.apply(event)
        after, data = asdict(state.prices), event.data
        paid = sum(before.values()), sum(after.values())
        seconds = float(data.get("seconds") or 0.0)
        if event.kind == "trained":
            number = int(data["training"])
            kind = "extension" if after["extension"] > before["extension"] else "training"
            said = f"{counted(paid[1] - paid[0])} steps, to {counted(data['steps'])}"
            yield Piece(kind, number, *paid, seconds, None, said)
        elif event.kind == "evaluated":
            policy = Policy(int(data["training"]), int(data["length"]))
            place, count = state.policies.index(policy), len(data["targets"])
            row = filled_rows(bounds.normalise(state.returns[place])[None], space.steps)
            rows = np.concatenate([rows[:place], row, rows[place + 1 :]])
            value = float(rows.max(axis=0) @ space.weights)
            _, mark = state.trainings[policy.training].at(policy.length)
            said = f"at {counted(mark.steps)} steps, on {count} context{'s' * (count != 1)}"
            yield Piece("evaluation", policy.training, *paid, seconds, value, said)
        elif event.kind == "failed":
            known = [j for j, course in enumerate(state.trainings) if course.failed is not None]
            stopped = known[-1] if known and paid[1] > paid[0] else None
            where = space.describe(space.context(int(data["source"])))
            said, trace = f"{where}: {data['reason']}", str(data.get("traceback") or "")
            yield Piece("failed", stopped, *paid, seconds, None, said, trace)
