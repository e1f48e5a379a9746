"""Which pick an answer is for, from the state of a study alone."""

from __future__ import annotations

from typing import Any

from mbtl.errors import StudyError
from mbtl.study.pick import Pick
from mbtl.study.state import StudyState


def answered(state: StudyState, pick: Any, source: int) -> int | None:
    """Number of the open pick that a row of `source` answers; None for one nobody asked for.

    Raises:
        StudyError: the pick is not open, or the source was told before.
    """
    assert state.spec is not None
    if isinstance(pick, Pick):
        return open_number(state, pick)
    for number, record in state.open_picks.items():
        if record.source == source:
            return number
    told = sum(row.source == source for row in state.rows)
    if told >= state.spec.repeats:
        raise StudyError(
            f"context {source} was told before; a study keeps one row per source, or as many "
            f"as create_study(repeats=...) allows, here {state.spec.repeats}"
        )
    return None


def open_number(state: StudyState, pick: Pick) -> int:
    """Number of a pick that waits for an answer.

    Raises:
        StudyError: it was answered before, or it is the pick of another study.
    """
    if pick.number not in state.open_picks:
        raise StudyError(f"pick {pick.number} is not open: it was answered before, or given up")
    asked = state.open_picks[pick.number].source
    if pick.source != asked:
        raise StudyError(
            f"pick {pick.number} of this study trains on context {asked}, got a pick of context "
            f"{pick.source}; tell the study that gave it, or give the context instead"
        )
    return pick.number
