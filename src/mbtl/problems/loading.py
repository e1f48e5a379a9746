"""A CMDP by what a user types: an id of ours, or where their own is."""

from __future__ import annotations

from typing import Any

from mbtl.errors import InvalidInput
from mbtl.faults import load_object
from mbtl.problems.cmdp import CMDP
from mbtl.provider import laboratory


def cmdp_ids() -> list[str]:
    """Ids of our CMDPs, those of the laboratory."""
    return list(laboratory().ids())


def get_cmdp(id: str, **switches: Any) -> CMDP:
    """A CMDP by id.

    Args:
        id: e.g. "cartpole-length"; `mbtl.problems.cmdp_ids()` lists them.
        **switches: such as `visibility` or `engine`: see `mbtl.zoo.cmdps.get_cmdp`.

    Raises:
        UnknownName: no CMDP has this id, or a switch has no such setting.
        InvalidInput: it is not simulated in that engine.
    """
    found: CMDP = laboratory().get(id, **switches)
    return found


def resolve_cmdp(name: str, **switches: Any) -> CMDP:
    """A CMDP by id, or a user's own by `module:attribute`.

    Args:
        name: id, or "module:attribute".
        **switches: of ours, see `get_cmdp`; None: not given.

    Raises:
        UnknownName: no CMDP has this id.
        InvalidInput: no CMDP is there, it cannot be imported, or a switch for a user's own.
    """
    given = {switch: value for switch, value in switches.items() if value is not None}
    if ":" not in name:
        if name.endswith(".py"):
            raise InvalidInput(
                f"a file needs the name of the CMDP inside it, got {name!r}; write {name}:<name>"
            )
        return get_cmdp(name, **given)
    if given:
        switch, value = next(iter(given.items()))
        raise InvalidInput(
            f"{', '.join(switches)} are switches of our CMDPs, got {switch} {value!r} with "
            f"{name!r}, a problem of your own; leave {switch} out: the problem itself decides it"
        )
    found = load_object(name)
    if not isinstance(found, CMDP):
        is_function = callable(found) and not isinstance(found, type)
        raise InvalidInput(
            f"{name!r} must be a CMDP, got {'a function' if is_function else repr(type(found))}; "
            "build one with CMDP.from_functions or CMDP.from_env"
        )
    return found
