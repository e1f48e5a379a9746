"""A selector in a log: its name, and what was set differently from usual."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

from mbtl.selectors import Selector

FROM = "from"
"""Key of the text by which a user named a selector of their own."""


def describe_selector(selector: Selector, named: str | Selector | None = None) -> dict[str, Any]:
    """Name and settings of a selector, JSON-able and the same in every process.

    Args:
        selector: the object.
        named: what the user gave; a text such as "my.py:Mine" is kept, so that people find it.
    """

    def plain(value: Any) -> Any:
        if dataclasses.is_dataclass(value) and not isinstance(value, type):
            changed = {f.name: _changed(value, f) for f in dataclasses.fields(value)}
            return {name: plain(v) for name, v in changed.items() if v is not _KEPT}
        if isinstance(value, (list, tuple)):
            return [plain(item) for item in value]
        if value is None or isinstance(value, (str, int, float, bool)):
            return value
        return getattr(value, "__qualname__", type(value).__qualname__)

    settings = plain(selector)
    if not isinstance(settings, dict):
        settings = {"class": settings}
    own = {FROM: named} if isinstance(named, str) and ":" in named else {}
    return {**settings, **own, "name": selector.name}


def without_origin(description: Mapping[str, Any]) -> dict[str, Any]:
    """What two descriptions of one selector share, wherever it was found."""
    return {key: value for key, value in description.items() if key != FROM}


_KEPT = object()


def _changed(value: Any, field: dataclasses.Field[Any]) -> Any:
    """The value of a field, or `_KEPT` where it is the default.

    Only changes are stored, so a selector may gain a setting and old studies still open.
    """
    given = getattr(value, field.name)
    default = field.default
    if default is dataclasses.MISSING and field.default_factory is not dataclasses.MISSING:
        default = field.default_factory()
    return _KEPT if default is not dataclasses.MISSING and given == default else given
