"""What an event must hold, whoever wrote it: checked before it is stored and when it is read.

A log may be damaged, or come from a stranger, whose paths must not lead out of the study's folder.
Facts that are not named here are free: a version may note more.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from pathlib import PurePosixPath
from typing import Any

import numpy as np

from mbtl.errors import InvalidInput, StorageError
from mbtl.files import MALFORMED, is_local
from mbtl.plain import LARGEST, short
from mbtl.study.events import Event, Kind
from mbtl.study.spec import (
    COUNT,
    FLAG,
    NUMBER,
    RECORD,
    TEXT,
    Rule,
    at_least,
    each,
    is_number,
    is_text,
    is_whole,
    or_null,
)
from mbtl.study.state import StudyState

_LONGEST = 1e9
"""Units of a training."""


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
        InvalidInput: a fact or an array is missing, of the wrong form, or out of place.
    """
    for name, (holds, words) in _facts(event, state).items():
        fact = event.data.get(name)
        if not holds(fact):
            raise InvalidInput(f"`{name}` must be {words}, got {short(fact)}")
    shapes = _shapes(event, state)
    if set(event.arrays) != set(shapes):
        raise InvalidInput(
            f"it has the arrays {sorted(shapes)} and no others, got {sorted(event.arrays)}"
        )
    for name, shape in shapes.items():
        array = event.arrays[name]
        proper = array.dtype.kind in "fiu" and array.shape == shape
        if not proper or (np.abs(array) > np.float64(LARGEST)).any():
            raise InvalidInput(
                f"array `{name}` must hold numbers of shape {shape}, within {LARGEST:g} or NaN, "
                f"got {array.dtype} of shape {array.shape}"
            )
    if event.kind in ("asked", "told"):
        _check_training(event, state)
    if event.kind == "told" and np.isnan(event.arrays["returns"]).all():
        raise InvalidInput("array `returns` must hold one number or more, got none")


def _check_training(event: Event, state: StudyState) -> None:
    """Refuse a training that cannot be, and a row that is not of its pick."""
    data = event.data
    if event.kind == "told":
        pick = None if data["pick"] is None else state.picks[data["pick"]]
        if pick is not None and tuple(data["sources"]) != pick.sources:
            raise InvalidInput(f"`sources` must be the contexts of its pick, got {data['sources']}")
        return
    asked = state.planned(data)
    if not asked.length and None in (asked.start, asked.targets):
        raise InvalidInput("a pick that only evaluates a policy has a start and targets")
    if asked.length and asked.length <= asked.done:
        raise InvalidInput(
            f"a training goes on beyond what it had, {asked.done:g} units, got {asked.length:g}"
        )


def is_policy_place(path: object) -> bool:
    """True for what `tell` takes as a policy's folder: below the study's, and no hidden place.

    A study's folder may be a home folder, whose hidden ones hold keys.
    """
    return is_local(path) and not any(p[0] == "." for p in PurePosixPath(str(path)).parts)


# ---- rules -------------------------------------------------------------------------------------


def _named(letters: str) -> Rule:
    def holds(value: Any) -> bool:
        return is_text(value) and re.fullmatch(f"[{letters}]{{1,64}}", value) is not None

    return holds, "1 to 64 letters and digits, since a folder is named by it"


_TOKEN, _UID = _named("A-Za-z0-9"), _named("A-Za-z0-9_-")
_MAYBE_TEXT = or_null(TEXT)
_SECONDS = or_null((at_least(0.0), "a finite number >= 0"))
_UNITS = or_null(
    (lambda value: is_number(value) and 0.0 <= value <= _LONGEST, "a number of units >= 0")
)
_POLICY = or_null((is_policy_place, "a folder inside the study's own, as a relative path"))
_HOLDER = {"worker": TEXT, "token": _TOKEN, "seconds": _SECONDS}


def _facts(event: Event, state: StudyState) -> dict[str, Rule]:
    """The facts that an event of this kind must hold now."""
    if not state.seq:
        return {"version": TEXT, "uid": _UID, "spec": RECORD}
    n, asked, rows = state.spec.space.n, len(state.picks), len(state.rows)
    least, now = state.spec.budget, state.spec.steps

    def number(holds: Callable[[int], bool], words: str) -> Rule:
        return (lambda i: is_whole(i) and holds(i)), words

    index = number(lambda i: i < n, "")[0]
    sources: Rule = (
        lambda some: each(index)(some) and 0 < len(some) == len(set(some)),
        f"different context indices from 0 to {n - 1}, one or more",
    )
    rising: Rule = (
        lambda some: sources[0](some) and list(some) == sorted(some),
        f"{sources[1]}, rising",
    )
    told = number(lambda i: state.place_of(i) >= 0, "the number of the event that told a row")
    one_open = number(lambda i: i in state.open_picks, "the number of an open pick")
    next_or_open = number(
        lambda i: i in state.open_picks or i == asked, f"{one_open[1]}, or of the next one"
    )
    failure: dict[str, Rule] = {
        "token": or_null(_TOKEN),
        "pick": one_open,
        "reason": TEXT,
        "traceback": _MAYBE_TEXT,
        **dict.fromkeys(("pruned", "again"), or_null(FLAG)),
        "steps": _SECONDS,
    }
    returns: dict[str, Rule] = {"targets": or_null(rising), "episodes": COUNT}
    raised = "a budget can only be raised"
    table: dict[Kind, dict[str, Rule]] = {
        "extended": {
            "budget": number(lambda k: k >= least, f"{least} trainings or more: {raised}"),
            "steps": (lambda steps: steps is None, "null")
            if now is None
            else number(lambda steps: steps > now, f"more than {now} steps: {raised}"),
        },
        "asked": {
            "pick": number(lambda i: i == asked, f"the number {asked} of the next pick"),
            "sources": sources,
            "start": or_null(told),
            "length": _UNITS,
            "reason": TEXT,
            "acquisition": NUMBER,
            "notes": (each(is_text), "a list of texts"),
            "targets": or_null(sources),
            **_HOLDER,
        },
        "claimed": {"pick": next_or_open, **_HOLDER},
        "released": {"pick": next_or_open},
        "voided": {"told": told, "reason": TEXT},
        "late": {
            "pick": number(lambda i: i < asked, f"a number of the {asked} picks"),
            "outcome": (lambda o: o in ("told", "failed", "deferred"), "what came"),
            "token": TEXT,
            **(returns if event.data.get("outcome") == "told" else {}),
        },
        "told": {
            "pick": or_null(one_open),
            "sources": sources,
            **returns,
            "cost": (at_least(0.0), "a finite number >= 0"),
            **dict.fromkeys(("seconds", "steps", "evaluation_steps"), _SECONDS),
            **dict.fromkeys(("policy", "state"), _POLICY),
            **dict.fromkeys(("sha256", "recipe", "state_sha256"), _MAYBE_TEXT),
            "token": or_null(_TOKEN),
        },
        "failed": failure,
        "deferred": failure,
        "reopened": {
            "pick": number(
                lambda i: any(failed.pick == i for failed in state.failures),
                "the number of a failed pick",
            )
        },
        "stopped": {"reason": TEXT},
        "reported": {
            "episodes": COUNT,
            "best_single": number(lambda i: i < rows, f"the place of one of the {rows} rows"),
            "baselines": or_null((each(is_text), "a list of names")),
            "metrics": or_null(RECORD),
        },
    }
    return table.get(event.kind, {})


def _shapes(event: Event, state: StudyState) -> dict[str, tuple[int, ...]]:
    """The arrays that an event must hold now."""
    kind = event.kind
    if not state.seq:
        return {}
    n = state.spec.space.n
    if kind == "told" or (kind == "late" and event.data.get("outcome") == "told"):
        targets = event.data.get("targets")
        return {"returns": (n if targets is None else len(targets), event.data["episodes"])}
    if kind == "reported":
        data, played = event.data, (n, event.data["episodes"])
        shapes: dict[str, tuple[int, ...]] = {"served": played, "alone": played}
        others, measures = len(data.get("baselines") or ()), len(data.get("metrics") or ())
        if others:
            shapes["baselines"] = (others, *played)
        if measures:
            shapes["metrics"] = (1 + others, measures, n)
        return shapes
    return {}
