"""What a study is told: which contexts, which pick and which targets it is about."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from mbtl.contexts import ContextSpace
from mbtl.errors import InvalidInput, StudyError
from mbtl.plain import whole
from mbtl.study.events import Event
from mbtl.study.records import Pick, PickRecord
from mbtl.study.state import StudyState


def answered(state: StudyState, pick: Any, sources: tuple[int, ...]) -> int | None:
    """Number of the open pick that a row of `sources` answers; None for one nobody asked for.

    Raises:
        StudyError: the pick was answered before, or these sources were told before.
    """
    if isinstance(pick, Pick):
        return open_number(state, pick)
    record = from_scratch(state, sources)
    if record is not None:
        return record.number
    if any(row.sources == sources and row.start is None for row in state.rows):
        raise StudyError(
            f"a training from scratch on {_where(state, sources)} was told before; a study keeps "
            "one row of each: answer a pick, take the row back (void), or adopt the best policy "
            "alone"
        )
    return None


def from_scratch(state: StudyState, sources: tuple[int, ...]) -> PickRecord | None:
    """The open pick that trains on these contexts from scratch."""
    picks = state.open_picks.values()
    return next((one for one in picks if one.sources == sources and one.start is None), None)


def is_late(state: StudyState, pick: Pick) -> bool:
    """True when a pick was somebody else's by now, or was answered by somebody else.

    A pick that was given back, or whose lease has ended, may be answered until it is taken over, or
    tried again, which is of another seed.
    """
    if not (pick.token and _is_ours(state, pick)):
        return False
    record = state.picks[pick.number]
    if pick.number in state.open_picks:
        theirs = record.lease is not None and record.lease.token != pick.token
        return theirs or pick.seed != state.seed_of(record)
    return record.answered_by != pick.token


def open_number(state: StudyState, pick: Pick) -> int:
    """Number of a pick that waits for an answer.

    Raises:
        StudyError: it was answered before, or it is the pick of another study.
    """
    if pick.number < len(state.picks) and not _is_ours(state, pick):
        asked = state.picks[pick.number].sources
        raise StudyError(
            f"pick {pick.number + 1} of this study trains on {_where(state, asked)}, got another "
            f"study's, of {dict(pick.context)}; tell the study that gave it, or give the context "
            "instead"
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
        number = whole("the number of a pick", pick)
        if number not in state.open_picks:
            raise StudyError(
                f"pick {number + 1} is not open: number {number} was answered before, or never "
                "asked"
            )
        return number
    number = open_number(state, pick)
    if is_late(state, pick):
        raise StudyError(
            f"pick {number + 1} was taken over by {state.picks[number].worker}; it is theirs now"
        )
    return number


def _is_ours(state: StudyState, pick: Pick) -> bool:
    """True when this study gave that pick."""
    if pick.number >= len(state.picks):
        return False
    record = state.picks[pick.number]
    return (record.sources, record.start) == (pick.sources, pick.start)


Told = Pick | int | Mapping[str, Any] | Sequence[int | Mapping[str, Any]]
"""What `tell` takes: a pick, a context or its index, or several of those."""


def sources_of(space: ContextSpace, pick: Told) -> tuple[int, ...]:
    """Indices of the contexts that a policy was trained on."""
    if isinstance(pick, Pick):
        return pick.sources
    if isinstance(pick, Sequence) and not isinstance(pick, str) and len(pick):
        sources = [_source_of(space, one) for one in pick]
        if len(set(sources)) < len(sources):
            raise InvalidInput(f"a policy is trained on different contexts, got {sources}")
        return tuple(sorted(sources))
    return (_source_of(space, pick),)


def _source_of(space: ContextSpace, pick: Any) -> int:
    if isinstance(pick, Mapping):
        return space.index(pick)
    if not isinstance(pick, (int, np.integer)):
        raise InvalidInput(
            "tell takes what ask gave, a context, its index, or several, got "
            f"{type(pick).__name__} {pick!r}"
        )
    space.context(int(pick))  # refuses what is none
    return int(pick)


def reopening(state: StudyState, pick: Pick | int) -> Event:
    """The event that opens a failed pick again, or one whose policy could not be evaluated."""
    number = pick.number if isinstance(pick, Pick) else whole("the number of a pick", pick)
    if number not in state.deferred:
        if all(failure.pick != number for failure in state.failures):
            raise StudyError(
                f"only a failed pick can be tried again, got pick {number + 1}, which did not fail"
            )
        record = state.picks[number]
        same = record.sources, record.start, record.length
        if any((row.sources, row.start, row.length) == same for row in state.rows):
            where = _where(state, record.sources)
            raise StudyError(f"{where} was told since pick {number + 1} failed there")
    return Event("reopened", {"pick": number})


def _where(state: StudyState, sources: tuple[int, ...]) -> str:
    """Contexts for people, to whom an index says nothing."""
    return state.spec.space.describe_set(sources)
