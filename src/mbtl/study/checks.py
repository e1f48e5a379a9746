"""What an event must hold, whoever wrote it: checked before it is stored and when it is read.

A log may come from a stranger, whose paths must not lead out of the study's folder. Damage on a
disk is found by checksums. Other facts are taken as they are: what cannot follow from the events
before is refused, and no further rule is checked.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import PurePosixPath

import numpy as np

from mbtl.errors import InvalidInput, StorageError
from mbtl.files import MALFORMED, is_local
from mbtl.plain import short
from mbtl.study.events import Event
from mbtl.study.state import StudyState

_UID = re.compile(r"[A-Za-z0-9_-]{1,64}")
"""Of a study: what its folder is named by."""
_ANSWERS = ("told", "failed", "deferred")


def replay(events: Iterable[Event]) -> StudyState:
    """State after all `events`, from the first.

    Raises:
        StorageError: see `advance`.
    """
    state = StudyState()
    for event in events:
        advance(state, event)
    return state


def advance(state: StudyState, event: Event) -> None:
    """Let a state take the next event of a log.

    Raises:
        StorageError: it does not follow from the state; the log is damaged, or not ours.
    """
    if event.seq != state.seq + 1:
        raise StorageError(f"event {state.seq + 1} is missing from the log, got {event.seq}")
    if (state.seq == 0) != (event.kind == "created"):
        raise StorageError(f"event {event.seq} ({event.kind}) is out of place; the log is damaged")
    try:
        check_event(event, state)
        state.apply(event)
    except MALFORMED as error:
        raise StorageError(
            f"event {event.seq} ({event.kind}) of the study is damaged or not ours: {error}; "
            "restore a copy of the study"
        ) from error


def check_event(event: Event, state: StudyState) -> None:
    """Refuse an event that does not follow from `state`.

    Raises:
        InvalidInput: a place is not the study's, a pick does not wait for an answer, or an array is
            missing or of another form.
    """
    data = event.data
    if event.kind == "created" and not _UID.fullmatch(data["uid"]):
        raise InvalidInput(f"`uid` cannot be {short(data['uid'])}")
    for name in ("policy", "state"):
        place = data.get(name)
        if place is not None and not is_policy_place(place):
            raise InvalidInput(f"`{name}` cannot be {short(place)}")
    if event.kind in _ANSWERS and data["pick"] not in (None, *state.open_picks):
        raise InvalidInput(f"`pick` cannot be {short(data['pick'])} now")
    shapes = _shapes(event, state)
    if set(event.arrays) != set(shapes):
        raise InvalidInput(
            f"it has the arrays {sorted(shapes)} and no others, got {sorted(event.arrays)}"
        )
    for name, shape in shapes.items():
        array = event.arrays[name]
        if array.dtype.kind not in "fiu" or array.shape != shape or np.isinf(array).any():
            raise InvalidInput(
                f"array `{name}` must hold numbers of shape {shape}, or NaN, got {array.dtype} of "
                f"shape {array.shape}"
            )


def is_policy_place(path: object) -> bool:
    """True for what `tell` takes as a policy's folder: below the study's, and no hidden place.

    A study's folder may be a home folder, whose hidden ones hold keys.
    """
    return is_local(path) and not any(p[0] == "." for p in PurePosixPath(str(path)).parts)


def _shapes(event: Event, state: StudyState) -> dict[str, tuple[int, ...]]:
    """The arrays that an event must hold now."""
    kind, data = event.kind, event.data
    if kind == "told" or (kind == "late" and data["outcome"] == "told"):
        targets = data.get("targets")
        count = state.spec.space.n if targets is None else len(targets)
        return {"returns": (count, data["episodes"])}
    if kind == "reported":
        n = state.spec.space.n
        played = n, data["episodes"]
        shapes: dict[str, tuple[int, ...]] = {"served": played, "alone": played}
        others, measures = len(data.get("baselines") or ()), len(data.get("metrics") or ())
        if others:
            shapes["baselines"] = (others, *played)
        if measures:
            shapes["metrics"] = (1 + others, measures, n)
        return shapes
    return {}
