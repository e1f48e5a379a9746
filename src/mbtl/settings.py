"""Settings as JSON, compared: whether what is stored was made with those of today."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from mbtl.errors import InvalidInput


def as_json(what: str, settings: Mapping[str, Any]) -> dict[str, Any]:
    """Settings as they will read back from a log.

    Args:
        what: they are, for the message.
        settings: mappings, lists, texts and numbers.

    Raises:
        InvalidInput: something else is among them.
    """
    try:
        plain: dict[str, Any] = json.loads(json.dumps(settings, allow_nan=False))
    except (TypeError, ValueError) as error:
        raise InvalidInput(f"{what} must be JSON-able, got {dict(settings)!r} ({error})") from error
    return plain


def first_difference(
    old: Mapping[str, Any], new: Mapping[str, Any], path: str = ""
) -> tuple[str, Any, Any] | None:
    """Dotted name of the first setting that differs, with both values; None if all are equal.

    Args:
        old: JSON-like.
        new: JSON-like; a setting that only one of them has is None in the other.
        path: of what is compared, before its names.
    """
    for key in [*new, *(key for key in old if key not in new)]:
        was, now = old.get(key), new.get(key)
        if isinstance(was, Mapping) and isinstance(now, Mapping):
            found = first_difference(was, now, f"{path}{key}.")
        else:
            found = None if was == now else (f"{path}{key}", was, now)
        if found:
            return found
    return None
