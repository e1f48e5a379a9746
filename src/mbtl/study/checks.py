"""What an event must hold, whoever wrote it: checked before it is stored and when it is read.

A log may be damaged, or come from a stranger, whose paths must not lead out of the study's folder.
Facts that are not named here are free: a version may note more.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from pathlib import PurePosixPath
from typing import TYPE_CHECKING, Any

import numpy as np

from mbtl.errors import InvalidInput
from mbtl.files import is_local
from mbtl.objective import Bounds
from mbtl.plain import LARGEST
from mbtl.study.events import Event, Kind

if TYPE_CHECKING:
    from mbtl.study.spec import StudySpec
    from mbtl.study.state import StudyState

_LONGEST = 1e9
"""Units of a training."""
_HUGE = 1e300
"""Of facts: differences of numbers below this are numbers, too."""

Rule = tuple[Callable[[Any], bool], str]
"""What a fact must satisfy, and that in words."""


def check_event(event: Event, state: StudyState) -> None:
    """Refuse an event that does not follow from `state`.

    Raises:
        InvalidInput: a fact or an array is missing, of the wrong form, or out of place.
    """
    for name, (holds, words) in _facts(event, state).items():
        fact = event.data.get(name)
        if not holds(fact):
            raise InvalidInput(f"`{name}` must be {words}, got {_short(fact)}")
    shapes = _shapes(event, state)
    if set(event.arrays) != set(shapes):
        raise InvalidInput(
            f"it has the arrays {sorted(shapes)} and no others, got {sorted(event.arrays)}"
        )
    for name, shape in shapes.items():
        array = event.arrays[name]
        most = np.float64(2.0 * LARGEST)  # of a mean, and of a deviation of numbers within it
        least = np.float64(0.0) if name == "std" else -most
        proper = array.dtype.kind in "fiu" and array.shape == shape
        if not proper or ((array < least) | (array > most)).any():
            raise InvalidInput(
                f"array `{name}` must hold numbers of shape {shape}, from {least:g} to {most:g} or "
                f"NaN, got {array.dtype} of shape {array.shape}"
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
    for facts in (data, *(data.get("ahead") or ())):
        asked = state.planned(facts)
        if not asked.length and None in (asked.start, asked.targets):
            raise InvalidInput("a pick that only evaluates a policy has a start and targets")
        if asked.length and asked.length <= asked.done:
            raise InvalidInput(
                f"a training goes on beyond what it had, {asked.done:g} units, got {asked.length:g}"
            )


def check_spec(spec: StudySpec) -> None:
    """Refuse settings that no study can have.

    Raises:
        InvalidInput: the first that breaks its rule.
    """
    for name, (holds, words) in _SPEC.items():
        value = getattr(spec, name)
        if not holds(value):
            raise InvalidInput(f"{name} must be {words}, got {_short(value)}")
    Bounds(*(spec.bounds or (0.0, 1.0)), spec.direction)
    spec.selection_problem()
    if spec.steps is not None and None in (spec.unit, spec.target_steps):
        raise InvalidInput("a study that counts steps must know those of a unit and of a target")
    if spec.eval_targets is not None and spec.eval_targets > spec.space.n:
        raise InvalidInput(f"eval_targets must be at most {spec.space.n}")


def is_policy_place(path: object) -> bool:
    """True for what `tell` takes as a policy's folder: below the study's, and no hidden place.

    A study's folder may be a home folder, whose hidden ones hold keys.
    """
    return is_local(path) and not any(p[0] == "." for p in PurePosixPath(str(path)).parts)


# ---- rules -------------------------------------------------------------------------------------


def _is_whole(value: Any) -> bool:
    return _is_seed(value) and bool(value < 2**63)


def _is_seed(value: Any) -> bool:
    """Of any size: it is hashed."""
    whole = isinstance(value, (int, np.integer)) and not isinstance(value, bool)
    return whole and bool(value >= 0)


def _is_number(value: Any) -> bool:
    plain = value.item() if isinstance(value, np.number) else value
    real = isinstance(plain, (int, float)) and not isinstance(plain, bool)
    return real and -_HUGE < plain < _HUGE


def _is_text(value: Any) -> bool:
    return isinstance(value, str)


def _at_least(least: float, is_one: Callable[[Any], bool] = _is_number) -> Callable[[Any], bool]:
    return lambda value: is_one(value) and value >= least


def _maybe(rule: Callable[[Any], bool]) -> Callable[[Any], bool]:
    return lambda value: value is None or rule(value)


def _each(rule: Callable[[Any], bool]) -> Callable[[Any], bool]:
    return lambda value: isinstance(value, (list, tuple)) and all(map(rule, value))


def _has(rules: Mapping[str, Rule]) -> Callable[[Any], bool]:
    return lambda value: (
        _is_record(value) and all(holds(value.get(name)) for name, (holds, _) in rules.items())
    )


def _is_record(value: Any) -> bool:
    return isinstance(value, Mapping)


def _is_selector(value: Any) -> bool:
    return isinstance(value, Mapping) and _is_text(value.get("name"))


_TEXT: Rule = (_is_text, "text")
_MAYBE_TEXT: Rule = (_maybe(_is_text), "text, or null")
_COUNT: Rule = (_at_least(1, _is_whole), "a whole number of 1 or more")
_SEED: Rule = (_is_seed, "a whole number >= 0")
_NUMBER: Rule = (_maybe(_is_number), "a finite number, or null")
_SECONDS: Rule = (_maybe(_at_least(0.0)), "a finite number >= 0, or null")
_TOKEN: Rule = (
    lambda value: _is_text(value) and re.fullmatch("[A-Za-z0-9]{1,64}", value) is not None,
    "1 to 64 letters and digits, since a folder is named by it",
)
_MAYBE_TOKEN: Rule = (_maybe(_TOKEN[0]), f"{_TOKEN[1]}, or null")
_UNITS: Rule = (
    _maybe(lambda value: _is_number(value) and 0.0 <= value <= _LONGEST),
    "a number of units >= 0, or null",
)
_UID: Rule = (
    lambda value: _is_text(value) and re.fullmatch(r"[A-Za-z0-9_-]{1,64}", value) is not None,
    "1 to 64 letters and digits, since a folder is named by it",
)
_POLICY: Rule = (
    _maybe(is_policy_place),
    "a folder inside the study's own, as a relative path, or null",
)

_SPEC: dict[str, Rule] = {
    "budget": (_is_whole, "a whole number"),
    "selector": (_is_selector, "a record with a name"),
    "bounds": (_maybe(lambda b: len(b) == 2 and all(map(_is_number, b))), "two finite numbers"),
    "theta": _NUMBER,
    "seed": _SEED,
    "trial": _SEED,
    "stop_value": _NUMBER,
    "cost_budget": _NUMBER,
    "problem": _TEXT,
    "settings": (_is_record, "a record"),
    "costs": (_maybe(_each(_is_number)), "finite numbers"),
    "risk": (_is_number, "a number"),
    "eval_targets": (_maybe(_COUNT[0]), "a whole number of 1 or more, or null"),
    "stop_gain": _NUMBER,
    "stop_confidence": (_is_number, "a number"),
    "stop_left": _NUMBER,
    "best_return": _NUMBER,
    "floor": _NUMBER,
    "any_training": (lambda value: isinstance(value, bool), "true or false"),
    "steps": (_maybe(_COUNT[0]), "a whole number of 1 or more, or null"),
    "unit": (_maybe(_COUNT[0]), "a whole number of 1 or more, or null"),
    "target_steps": (_maybe(_COUNT[0]), "a whole number of 1 or more, or null"),
}


def _facts(event: Event, state: StudyState) -> dict[str, Rule]:
    """The facts that an event of this kind must hold now."""
    if state.spec is None:
        return {"version": _TEXT, "uid": _UID, "spec": (_is_record, "a record")}
    n, asked, least, now = (
        state.spec.space.n, len(state.picks), state.spec.budget, state.spec.steps
    )  # fmt: skip
    index: Callable[[Any], bool] = lambda i: _is_whole(i) and i < n  # noqa: E731
    sources: Rule = (
        lambda some: _each(index)(some) and 0 < len(some) == len(set(some)),
        f"different context indices from 0 to {n - 1}, one or more",
    )
    told: Rule = (
        lambda i: _is_whole(i) and state.place_of(i) >= 0,
        "the number of the event that told a row",
    )
    proposed: dict[str, Rule] = {
        "sources": sources,
        "start": (_maybe(told[0]), f"{told[1]}, or null"),
        "length": _UNITS,
        "reason": _TEXT,
        "acquisition": _NUMBER,
        "notes": (_each(_is_text), "a list of texts"),
        "targets": (_maybe(sources[0]), f"{sources[1]}, or null"),
    }
    one_open: Rule = (
        lambda i: _is_whole(i) and i in state.open_picks,
        "the number of an open pick",
    )
    next_or_open: Rule = (
        lambda i: _is_whole(i) and (i in state.open_picks or i == asked),
        "the number of an open pick, or of the next one",
    )
    failure = {
        "token": _MAYBE_TOKEN,
        "pick": one_open,
        "reason": _TEXT,
        "traceback": _MAYBE_TEXT,
        "pruned": (_maybe(lambda value: isinstance(value, bool)), "true, false or null"),
        "steps": _SECONDS,
    }
    returns: dict[str, Rule] = {
        "targets": (
            lambda some: some is None or (sources[0](some) and list(some) == sorted(some)),
            f"{sources[1]}, rising, or null",
        ),
        "episodes": _COUNT,
    }
    table: dict[Kind, dict[str, Rule]] = {
        "extended": {
            "budget": (
                lambda k: _is_whole(k) and k >= least,
                f"{least} trainings or more: a budget can only be raised",
            ),
            "steps": (
                lambda k: k is None if now is None else _is_whole(k) and k > now,
                "null" if now is None else f"more than {now} steps: a budget can only be raised",
            ),
        },
        "asked": {
            "pick": (lambda i: _is_whole(i) and i == asked, f"the number {asked} of the next pick"),
            **proposed,
            "worker": _TEXT,
            "token": _TOKEN,
            "seconds": _SECONDS,
            "ahead": (_maybe(_each(_has(proposed))), "a list of proposals, or null"),
        },
        "claimed": {
            "pick": next_or_open,
            "worker": _TEXT,
            "token": _TOKEN,
            "seconds": _SECONDS,
        },
        "released": {"pick": next_or_open},
        "voided": {
            "told": told,
            "reason": _TEXT,
        },
        "late": {
            "pick": (lambda i: _is_whole(i) and i < asked, f"a number of the {asked} picks"),
            "outcome": (lambda o: o in ("told", "failed", "retried", "deferred"), "what came"),
            "token": (_is_text, "text"),
            **(returns if event.data.get("outcome") == "told" else {}),
        },
        "told": {
            "pick": (_maybe(one_open[0]), f"{one_open[1]}, or null"),
            "sources": sources,
            **returns,
            "cost": (_at_least(0.0), "a finite number >= 0"),
            "seconds": _SECONDS,
            "steps": _SECONDS,
            "checks": _SECONDS,
            "evaluation_steps": _SECONDS,
            "policy": _POLICY,
            "sha256": _MAYBE_TEXT,
            "recipe": _MAYBE_TEXT,
            "state": _POLICY,
            "state_sha256": _MAYBE_TEXT,
            "ended": (_maybe(lambda value: isinstance(value, bool)), "true, false or null"),
            "token": _MAYBE_TOKEN,
        },
        "failed": failure,
        "retried": failure,
        "deferred": failure,
        "reopened": {
            "pick": (
                lambda i: any(failed.pick == i for failed in state.failures),
                "the number of a failed pick",
            )
        },
        "stopped": {"reason": _TEXT},
        "reported": {
            "episodes": _COUNT,
            "best_single": (
                lambda i: _is_whole(i) and i < len(state.rows),
                f"the place of one of the {len(state.rows)} rows",
            ),
        },
    }
    return table.get(event.kind, {})


def _shapes(event: Event, state: StudyState) -> dict[str, tuple[int, ...]]:
    """The arrays that an event must hold now."""
    kind = event.kind
    if state.spec is None:
        return {}
    n = state.spec.space.n
    if kind == "told" or (kind == "late" and event.data.get("outcome") == "told"):
        targets = event.data.get("targets")
        return {"returns": (n if targets is None else len(targets), event.data["episodes"])}
    if kind == "reported":
        return dict.fromkeys(("served", "alone"), (n, event.data["episodes"]))
    return {}


def _short(value: Any) -> str:
    text = ascii(value)
    return text if len(text) <= 80 else f"{text[:77]}..."
