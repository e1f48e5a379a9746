"""What the tool takes from the laboratory, by the one entry point that provides it.

    [project.entry-points."mbtl.providers"]
    zoo = "mbtl.zoo.provider"

It is a module with
    names, commands      name -> "module:object": what `mbtl` shows of it, and commands of the
                         command line, each a function or a `typer.Typer`
    ids(), get(id, **switches)
                         ids of CMDPs, and a `mbtl.CMDP` by id
    subjects(), subject(given, selector=, budget=, seed=)
                         names that it knows beside paths, and what one shows on a page, a
                         `mbtl.report.Subject`; None: it is not one of these
    curves(study)        what stands beside a study, `mbtl.report.ReferenceCurves`; None: nothing

The tool imports no module of the laboratory, nor of the engine.
"""

from __future__ import annotations

import pkgutil
from functools import cache
from importlib.metadata import entry_points
from typing import Any

GROUP = "mbtl.providers"
_BESIDE = "mbtl.zoo.provider"
"""The one of this distribution: metadata lack it where a tree of sources is run as it is."""


@cache
def laboratory() -> Any:
    """The provider, imported on first use."""
    declared = [point.value for point in entry_points(group=GROUP)]
    return pkgutil.resolve_name(declared[0] if declared else _BESIDE)
