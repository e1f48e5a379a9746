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
from mbtl.selectors.contract import check_longer
from mbtl.study.events import Event, Kind
from mbtl.study.spec import (
    Rule,
    at_least,
    each,
    is_count,
    is_flag,
    is_number,
    is_record,
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
    for name, holds in _facts(event, state).items():
        if not holds(event.data.get(name)):
            raise InvalidInput(f"`{name}` cannot be {short(event.data.get(name))} now")
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
        raise InvalidInput("what only evaluates a policy (length 0) has a start= and targets=")
    check_longer(asked.done, asked.length)


def is_policy_place(path: object) -> bool:
    """True for what `tell` takes as a policy's folder: below the study's, and no hidden place.

    A study's folder may be a home folder, whose hidden ones hold keys.
    """
    return is_local(path) and not any(p[0] == "." for p in PurePosixPath(str(path)).parts)


# ---- rules -------------------------------------------------------------------------------------


def _named(letters: str) -> Rule:
    """Of what a folder is named by."""
    return lambda value: is_text(value) and bool(re.fullmatch(f"[{letters}]{{1,64}}", value))


_is_token, _is_uid = _named("A-Za-z0-9"), _named("A-Za-z0-9_-")
_amount, _units = or_null(at_least(0.0)), or_null(lambda v: is_number(v) and 0.0 <= v <= _LONGEST)
_HOLDER: dict[str, Rule] = {"worker": is_text, "token": _is_token, "seconds": _amount}


def _facts(event: Event, state: StudyState) -> dict[str, Rule]:
    """The facts that an event of this kind must hold now."""
    if not state.seq:
        return {"version": is_text, "uid": _is_uid, "spec": is_record}
    n, asked, rows = state.spec.space.n, len(state.picks), len(state.rows)
    least, now = state.spec.budget, state.spec.steps
    same = event.data.get("to_the_end") or "stop_value" in event.data
    cost = state.spec.cost_budget

    def number(holds: Callable[[int], bool]) -> Rule:
        return lambda i: is_whole(i) and holds(i)

    def more(steps: Any) -> bool:
        if same:
            return "steps" not in event.data
        return steps is None if now is None else is_whole(steps) and bool(steps > now)

    failed = {failure.pick for failure in state.failures}
    index, told = number(lambda i: i < n), number(lambda i: state.place_of(i) >= 0)
    one_open = number(lambda i: i in state.open_picks)
    next_or_open = number(lambda i: i in state.open_picks or i == asked)

    def sources(some: Any) -> bool:
        return each(index)(some) and 0 < len(some) == len(set(some))

    def rising(some: Any) -> bool:
        return sources(some) and list(some) == sorted(some)

    failure: dict[str, Rule] = {
        "token": or_null(_is_token),
        "pick": one_open,
        "reason": is_text,
        "traceback": or_null(is_text),
        **dict.fromkeys(("pruned", "again"), or_null(is_flag)),
        "steps": _amount,
    }
    returns: dict[str, Rule] = {"targets": or_null(rising), "episodes": is_count}
    table: dict[Kind, dict[str, Rule]] = {
        "extended": {
            "budget": number(lambda k: k == least if same else k >= least),
            "steps": more,
            "cost_budget": or_null(lambda c: cost is not None and at_least(cost)(c)),
            "to_the_end": or_null(is_flag),
            "stop_value": or_null(is_number),
        },
        "asked": {
            "pick": number(lambda i: i == asked),
            "sources": sources,
            "start": or_null(told),
            "length": _units,
            "reason": is_text,
            "acquisition": or_null(is_number),
            "notes": each(is_text),
            "targets": or_null(sources),
            **_HOLDER,
        },
        "claimed": {"pick": next_or_open, **_HOLDER},
        "released": {"pick": next_or_open},
        "voided": {"told": told, "reason": is_text},
        "late": {
            "pick": number(lambda i: i < asked),
            "outcome": lambda outcome: outcome in ("told", "failed", "deferred"),
            "token": is_text,
            **(returns if event.data.get("outcome") == "told" else {}),
        },
        "told": {
            "pick": or_null(one_open),
            "sources": sources,
            **returns,
            "cost": at_least(0.0),
            **dict.fromkeys(("seconds", "steps", "evaluation_steps"), _amount),
            **dict.fromkeys(("policy", "state"), or_null(is_policy_place)),
            **dict.fromkeys(("sha256", "recipe", "state_sha256"), or_null(is_text)),
            "token": or_null(_is_token),
        },
        "failed": failure,
        "deferred": failure,
        "reopened": {"pick": number(lambda i: i in state.deferred or i in failed)},
        "stopped": {"reason": is_text},
        "reported": {
            "episodes": is_count,
            "best_single": number(lambda i: i < rows),
            "lost": or_null(each(index)),
            "baselines": or_null(each(is_text)),
            "metrics": or_null(is_record),
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
