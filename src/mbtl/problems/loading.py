"""A CMDP by what a user types: an id, or where their own is.

An id is ours, or one that another package declares,

    [project.entry-points."mbtl.cmdps"]
    carl-walker-gravity = "carl_mbtl:walker_gravity"

a `CMDP`, or a function without arguments that makes one. It then has that id everywhere: `mbtl
cmdps`, `mbtl run carl-walker-gravity`, `mbtl.get_cmdp`. Nothing of a package is imported before one
of its CMDPs is asked for.
"""

from __future__ import annotations

from importlib.metadata import EntryPoint, entry_points
from typing import Any

from mbtl.errors import InvalidInput, unknown_name
from mbtl.faults import FAULTS, load_object, reason_of
from mbtl.problems.cmdp import CMDP
from mbtl.provider import laboratory


def cmdp_ids() -> list[str]:
    """Ids of our CMDPs, those of the laboratory."""
    return list(laboratory().ids())


def get_cmdp(id: str, **switches: Any) -> CMDP:
    """A CMDP by id: one of ours, or of another package.

    Args:
        id: e.g. "cartpole-length"; `cmdp_ids()` lists all of ours.
        **switches: of ours, such as `visibility` or `engine`: see `mbtl.zoo.cmdps.get_cmdp`. One
            of another package has none.

    Raises:
        UnknownName: no CMDP has this id, or a switch has no such setting.
        InvalidInput: one of ours is not simulated in that engine; or it is of another package, and
            cannot be loaded or was given a switch.
    """
    if id in cmdp_ids():
        ours: CMDP = laboratory().get(id, **switches)
        return ours
    found = plugin_cmdp(id)
    if found is None:
        known = [*cmdp_ids(), *plugin_ids()]
        raise unknown_name("CMDP", id, known, hint="`mbtl cmdps` lists all.")
    if given := [switch for switch, value in switches.items() if value is not None]:
        raise InvalidInput(
            f"a CMDP of another package has no switches, got {', '.join(given)} with {id!r} of "
            f"{plugin_ids()[id]!r}; leave them out"
        )
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
        raise InvalidInput(
            f"{', '.join(switches)} are switches of our CMDPs, got "
            f"{next(iter(given.values()))!r} with {name!r}; set it in your problem"
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


# ---- of other packages ---------------------------------------------------------------------------


GROUP = "mbtl.cmdps"


def plugin_ids() -> dict[str, str]:
    """Id -> distribution of every CMDP that installed packages declare, in order."""
    return {name: _package(point) for name, point in sorted(_points().items())}


def plugin_cmdp(id: str) -> CMDP | None:
    """The CMDP that a package declares under an id; None where none does.

    Raises:
        InvalidInput: it cannot be imported, or is no CMDP; the message names the package.
    """
    point = _points().get(id)
    if point is None:
        return None
    where = f"CMDP {id!r} of the package {_package(point)!r}"
    try:
        found = point.load()
        if callable(found) and not isinstance(found, CMDP):
            found = found()
    except FAULTS as error:  # whatever somebody else's module raises
        raise InvalidInput(
            f"{where} cannot be loaded from {point.value!r}: {reason_of(error)}; "
            "update or remove that package"
        ) from error
    if not isinstance(found, CMDP):
        raise InvalidInput(
            f"{where} must be a CMDP, or a function that makes one, got {type(found).__name__} "
            f"from {point.value!r}"
        )
    return found


def _points() -> dict[str, EntryPoint]:
    return {point.name: point for point in entry_points(group=GROUP)}


def _package(point: EntryPoint) -> str:
    return point.dist.name if point.dist is not None else point.value
