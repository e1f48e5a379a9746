"""What a study aims at and when it ends: as records, or keyword by keyword."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from mbtl.errors import InvalidInput
from mbtl.objective import Objective


@dataclass(frozen=True)
class Stopping:
    """When a study ends before its budget of trainings is spent; None: never for that.

    Attributes:
        value: V, performance, that is enough; needs bounds.
        gain: in V, that one more training should be worth, as the selector predicts.
        left: gain in V that all trainings left together should be worth; needs bounds.
        confidence: how probable that must be, and that V is what it seems, in (0, 1).
        cost: of all trainings together, in the unit of `costs`, or trainings.
    """

    value: float | None = None
    gain: float | None = None
    left: float | None = None
    confidence: float = 0.9
    cost: float | None = None


def objective_of(given: Objective | None, **single: Any) -> Objective:
    """The record, or what the keywords say.

    Raises:
        InvalidInput: both, or something else.
    """
    said = _said("objective", given, Objective, {name: name for name in single}, single)
    return given if isinstance(given, Objective) else Objective(**said)


_STOPPING = {
    "stop_value": "value",
    "stop_gain": "gain",
    "stop_left": "left",
    "stop_confidence": "confidence",
    "cost_budget": "cost",
}


def stopping_of(given: Stopping | None, **single: Any) -> Stopping:
    """The record, or what the keywords say.

    Raises:
        InvalidInput: both, or something else.
    """
    said = _said("stopping", given, Stopping, _STOPPING, single)
    return given if isinstance(given, Stopping) else Stopping(**said)


def _said(
    name: str, given: Any, kind: type, names: dict[str, str], single: dict[str, Any]
) -> dict[str, Any]:
    """The keywords that were given, by their names in the record."""
    said = {names[key]: value for key, value in single.items() if value is not None}
    if given is None:
        return said
    if not isinstance(given, kind):
        raise InvalidInput(
            f"{name} must be a mbtl.{kind.__name__}(...), got {type(given).__name__} {given!r:.60}"
        )
    if said:
        both = ", ".join(f"{key}=" for key, value in single.items() if value is not None)
        inside = ", ".join(f"{field}=" for field in said)
        raise InvalidInput(
            f"a study takes {name}= or keywords of their own, got {name}= and {both}; write "
            f"{kind.__name__}({inside}...) instead"
        )
    return said
