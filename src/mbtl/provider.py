"""What the tool takes from the laboratory, by the one entry point that provides it.

    [project.entry-points."mbtl.providers"]
    zoo = "mbtl.zoo.provider"

The tool imports no module of the laboratory, nor of the engine. A CMDP of another package needs no
provider of its own (`mbtl.problems.loading`).
"""

from __future__ import annotations

import pkgutil
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.metadata import entry_points
from typing import Any, Protocol

GROUP = "mbtl.providers"
_BESIDE = "mbtl.zoo.provider"
"""The one of this distribution: metadata lack it where a tree of sources is run as it is."""


class Laboratory(Protocol):
    """A provider. Records and pictures are those of the layers that ask for them.

    Attributes:
        names: what `mbtl` shows of it, name -> "module:object".
        commands: of the command line, name -> "module:object", a function or a `typer.Typer`.
    """

    @property
    def names(self) -> Mapping[str, str]: ...  # noqa: D102

    @property
    def commands(self) -> Mapping[str, str]: ...  # noqa: D102

    def ids(self) -> Sequence[str]:
        """Of the CMDPs that `get` makes."""
        ...

    def get(self, id: str, **switches: Any) -> Any:
        """A `mbtl.CMDP` by id."""
        ...

    def subjects(self) -> Sequence[str]:
        """Names that `subject` takes, beside paths."""
        ...

    def subject(self, given: str, *, selector: str, budget: int, seed: int) -> Any:
        """What a name or a path shows on a page (`mbtl.report.Subject`); None: not one of ours."""
        ...

    def curves(self, study: Any) -> Any:
        """What stands beside a study (`mbtl.report.ReferenceCurves`); None: nothing known."""
        ...


@cache
def laboratory() -> Laboratory:
    """The provider, imported on first use."""
    declared = [point.value for point in entry_points(group=GROUP)]
    found: Laboratory = pkgutil.resolve_name(declared[0] if declared else _BESIDE)
    return found
