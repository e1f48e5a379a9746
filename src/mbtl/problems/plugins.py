"""CMDPs of other packages, found by the entry points that they declare.

    [project.entry-points."mbtl.cmdps"]
    carl-walker-gravity = "carl_mbtl:walker_gravity"

names a `CMDP`, or a function without arguments that makes one. It then has that id everywhere:
`mbtl cmdps`, `mbtl run carl-walker-gravity`, `mbtl.get_cmdp`. Nothing of a package is imported
before one of its CMDPs is asked for.
"""

from __future__ import annotations

from importlib.metadata import EntryPoint, entry_points

from mbtl.errors import InvalidInput
from mbtl.faults import FAULTS, reason_of
from mbtl.problems.cmdp import CMDP

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
