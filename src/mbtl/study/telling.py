"""What a study is told: which source, which pick and which targets it is about."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from mbtl.contexts import ContextSpace
from mbtl.errors import InvalidInput, StudyError
from mbtl.study.events import Event
from mbtl.study.pick import Pick
from mbtl.study.state import StudyState


def answered(state: StudyState, pick: Any, source: int) -> int | None:
    """Number of the open pick that a row of `source` answers; None for one nobody asked for.

    Raises:
        StudyError: the pick was answered before, or the source was told before.
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
            f"{_where(state, source)} was told before; a study keeps one row per source, or as "
            f"many as create_study(repeats=...) allows, here {state.spec.repeats}"
        )
    return None


def is_late(state: StudyState, pick: Pick) -> bool:
    """True when a pick was somebody else's by now, or was answered by somebody else.

    A pick that was given back, or whose lease has ended, may be answered until it is taken over.
    """
    if not (pick.token and _is_ours(state, pick)):
        return False
    record = state.picks[pick.number]
    if pick.number in state.open_picks:
        return record.lease is not None and record.lease.token != pick.token
    return record.answered_by != pick.token


def open_number(state: StudyState, pick: Pick) -> int:
    """Number of a pick that waits for an answer.

    Raises:
        StudyError: it was answered before, or it is the pick of another study.
    """
    if pick.number < len(state.picks) and not _is_ours(state, pick):
        asked = state.picks[pick.number].source
        raise StudyError(
            f"pick {pick.number + 1} of this study trains on {_where(state, asked)}, got a pick of "
            f"{dict(pick.context)}; tell the study that gave it, or give the context instead"
        )
    if pick.number not in state.open_picks:
        raise StudyError(f"pick {pick.number + 1} is not open: it was answered before, or given up")
    return pick.number


def held_number(state: StudyState, pick: Pick | int) -> int:
    """Number of an open pick, which is not somebody else's; a bare number is of whoever holds it.

    Raises:
        StudyError: it is not open, or was taken over.
    """
    if not isinstance(pick, Pick):
        if pick not in state.open_picks:
            raise StudyError(f"pick {pick + 1} is not open: it was answered before, or never asked")
        return int(pick)
    number = open_number(state, pick)
    if is_late(state, pick):
        raise StudyError(
            f"pick {number + 1} was taken over by {state.picks[number].worker}; it is theirs now"
        )
    return number


def _is_ours(state: StudyState, pick: Pick) -> bool:
    """True when this study gave that pick."""
    return pick.number < len(state.picks) and state.picks[pick.number].source == pick.source


def source_of(space: ContextSpace, pick: Pick | int | Mapping[str, Any]) -> int:
    """Index of the context that a policy was trained on."""
    if isinstance(pick, Pick):
        return pick.source
    if isinstance(pick, Mapping):
        return space.index(pick)
    if not isinstance(pick, (int, np.integer)):
        raise InvalidInput(
            f"tell takes what ask gave, a context or its index, got {type(pick).__name__} {pick!r}"
        )
    if not 0 <= int(pick) < space.n:
        raise InvalidInput(f"context indices run from 0 to {space.n - 1}, got {pick}")
    return int(pick)


def asked_targets(state: StudyState, source: int) -> tuple[int, ...] | None:
    """Targets of the open pick with this source."""
    return next((p.targets for p in state.open_picks.values() if p.source == source), None)


def reopening(state: StudyState, pick: Pick | int) -> Event:
    """The event that opens a failed pick again."""
    assert state.spec is not None
    number = pick.number if isinstance(pick, Pick) else int(pick)
    failed = next((f for f in state.failures if f.pick == number), None)
    if failed is None:
        raise StudyError(
            f"only a failed pick can be tried again, got pick {number + 1}, which did not fail"
        )
    same = [row.source == failed.source for row in state.rows]
    if sum(same) >= state.spec.repeats:
        where = _where(state, failed.source)
        raise StudyError(f"{where} was told since pick {number + 1} failed there")
    return Event("reopened", {"pick": number})


def _where(state: StudyState, source: int) -> str:
    """A context for people, to whom its index says nothing."""
    assert state.spec is not None
    return state.spec.space.describe(state.spec.space.context(source))
