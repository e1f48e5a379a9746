"""What a log says of objects of a user's: of selectors, and of the code of functions."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

from mbtl.errors import StudyMismatch, few
from mbtl.selectors import Selector
from mbtl.settings import CODE, described, differences

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
            held = {f: getattr(value, f.name) for f in dataclasses.fields(value)}
            return {f.name: plain(given) for f, given in held.items() if given != _default(f)}
        if isinstance(value, (list, tuple)):
            return [plain(item) for item in value]
        return described(value)

    is_record = dataclasses.is_dataclass(selector)
    settings = plain(selector) if is_record else {"class": type(selector).__qualname__}
    own = {FROM: named} if isinstance(named, str) and ":" in named else {}
    return {**settings, **own, "name": selector.name}


def without_origin(description: Mapping[str, Any]) -> dict[str, Any]:
    """What two descriptions of one selector share, wherever it was found."""
    return {key: value for key, value in description.items() if key != FROM}


def changed_code(known: Mapping[str, Any], given: Mapping[str, Any]) -> list[str]:
    """What changed in a user's own code, for people.

    Args:
        known: as `mbtl.trainers.contract.code_of` gave it before.
        given: as it gives it now.
    """
    found = []
    for path, was, now in differences(known, given):
        role, *names = [part for part in path.split(".") if part != "code"]
        said = f"`{'.'.join(names)}`, which `{role}` uses" if names else f"`{role}`"
        values = [one for one in (was, now) if one is not None and not str(one).startswith(CODE)]
        found.append(f"{said} (was {was!r}, is {now!r})" if names and len(values) > 1 else said)
    return found


def code_mismatch(changes: Sequence[str]) -> StudyMismatch:
    """Build the error for own code that changed while a study was away."""
    return StudyMismatch(
        "the policies of a study are made and evaluated by one code, and since they were made "
        f"{few(changes)} changed; take the old code back, start another study (--new, or another "
        "name), or mix them knowingly, study.equip(trainer, accept_changes=True) (--accept-changes)"
    )


def _default(field: dataclasses.Field[Any]) -> Any:
    """What a field has where nothing is given; equal to nothing where it must be.

    Only changes are stored, so a selector may gain a setting and old studies still open.
    """
    made = field.default_factory
    return field.default if made is dataclasses.MISSING else made()
