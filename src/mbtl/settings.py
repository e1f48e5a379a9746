"""Settings compared: whether what is stored was made with those of today."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


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
