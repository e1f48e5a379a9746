"""An item of the paper's experiments: numbers first, then tables and drawings from the numbers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from mbtl.reproduction.bench import Bench
from mbtl.reproduction.table import Table

Numbers = dict[str, Any]
"""JSON-able. `missing` lists, in sentences, what the item could not have and why."""


def no_tables(numbers: Numbers) -> dict[str, Table]:
    """An item without tables."""
    return {}


def no_figures(numbers: Numbers) -> dict[str, Any]:
    """An item without figures."""
    return {}


@dataclass(frozen=True)
class Item:
    """One thing to reproduce.

    Attributes:
        number: as in the list of the paper's experiments; files begin with it.
        name: of its files.
        title: what it shows.
        compute: bench -> numbers.
        tables: numbers -> name -> table.
        figures: numbers -> name -> matplotlib figure.
        prefixes: of ids of the CMDPs it looks at.
        variants: sets of matrices that it looks at beside the one asked for.
    """

    number: int
    name: str
    title: str
    compute: Callable[[Bench], Numbers]
    tables: Callable[[Numbers], Mapping[str, Table]] = no_tables
    figures: Callable[[Numbers], Mapping[str, Any]] = no_figures
    prefixes: tuple[str, ...] = ("",)
    variants: tuple[str, ...] = ()

    @property
    def stem(self) -> str:
        """What its files are called."""
        return f"{self.number:02d}-{self.name}"


def named_variant(variant: str) -> str:
    """What a sentence says of a set of matrices: nothing of the usual one."""
    return "" if variant == "default" else f" (variant {variant})"


def absent(bench: Bench, prefix: str = "") -> list[str]:
    """A sentence per CMDP asked for of which there is no matrix."""
    more = named_variant(bench.setting.variant)
    return [
        f"{id}: no matrix{' shipped' if bench.setting.folder is None else ''} yet{more}; build it "
        f"with: mbtl matrix build {id}"
        for id in bench.missing
        if id.startswith(prefix)
    ]
