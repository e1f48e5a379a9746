"""A CMDP by what a user types: the id of one of ours, or where their own is."""

from __future__ import annotations

from typing import Any

from mbtl.cmdps.cmdp import CMDP
from mbtl.cmdps.registry import get_cmdp
from mbtl.errors import InvalidInput
from mbtl.loading import load_object


def resolve_cmdp(
    name: str,
    *,
    visibility: str | None = None,
    physics: str = "intended",
    score: str | None = None,
    engine: str | None = None,
) -> CMDP:
    """A CMDP by id, or a user's own by `module:attribute`.

    Args:
        name: id, or "module:attribute".
        visibility: of ours, what of the context the policy sees; see `get_cmdp`.
        physics: of ours, how contexts act on CartPole.
        score: of ours, what an episode is worth, where there is a choice.
        engine: where one of ours is simulated.

    Raises:
        UnknownName: no CMDP has this id.
        InvalidInput: no CMDP is there, it cannot be imported, or a switch for a user's own.
    """
    if ":" not in name:
        if name.endswith(".py"):
            raise InvalidInput(
                f"a file needs the name of the CMDP inside it, got {name!r}; write {name}:<name>"
            )
        return get_cmdp(name, visibility=visibility, physics=physics, score=score, engine=engine)
    given = visibility or engine or score or (None if physics == "intended" else physics)
    if given is not None:
        raise InvalidInput(
            "visibility, physics, score and engine are switches of our CMDPs, got "
            f"{given!r} with {name!r}; set it in your problem"
        )
    found = load_object(name)
    if not isinstance(found, CMDP):
        raise InvalidInput(
            f"{name!r} must be a CMDP, got {_kind(found)}; build one with CMDP.from_functions or "
            "CMDP.from_env"
        )
    return found


def _kind(found: Any) -> str:
    return "a function" if callable(found) and not isinstance(found, type) else repr(type(found))
