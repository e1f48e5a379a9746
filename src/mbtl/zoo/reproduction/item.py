"""An item of the paper's experiments: numbers first, then tables and drawings from the numbers."""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from mbtl.plot.style import new_figure
from mbtl.zoo.reproduction.bench import Bench

# ---- tables as CSV and Markdown, from the same cells ------------------------------------------


@dataclass(frozen=True)
class Measured:
    """A mean with its deviation over seeds; bold if it is marked as the best."""

    mean: float
    std: float | None = None
    marked: bool = False

    @classmethod
    def of(cls, value: Mapping[str, Any] | None, marked: bool = False) -> Measured | None:
        """Of a `Value` in numbers; None of one that is missing."""
        return None if value is None else cls(value["mean"], value["std"], marked)


Cell = Measured | float | int | str | None
"""None stands for what is not there."""


@dataclass(frozen=True)
class Table:
    """Cells with a head, a caption and notes below.

    Attributes:
        caption: what it shows, a sentence.
        head: names of the columns.
        rows: cells; each row as long as `head`.
        notes: what must be said beside it.
    """

    caption: str
    head: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    notes: tuple[str, ...] = ()

    def without(self, some: Collection[str]) -> Table:
        """Less: the columns of these heads, and these notes."""
        kept = [i for i, name in enumerate(self.head) if name not in some]
        return Table(
            self.caption,
            tuple(self.head[i] for i in kept),
            tuple(tuple(row[i] for i in kept) for row in self.rows),
            tuple(note for note in self.notes if note not in some),
        )

    def csv(self) -> str:
        """Full precision; a measured column becomes three: mean, standard deviation, marked."""
        measured = [
            any(isinstance(row[i], Measured) for row in self.rows) for i in range(len(self.head))
        ]
        head: list[str] = []
        for name, three in zip(self.head, measured, strict=True):
            head += [f"{name} mean", f"{name} std", f"{name} marked"] if three else [name]
        out = io.StringIO()
        writer = csv.writer(out, lineterminator="\n")
        writer.writerow(head)
        for row in self.rows:
            cells: list[object] = []
            for cell, three in zip(row, measured, strict=True):
                if isinstance(cell, Measured):
                    cells += [cell.mean, "" if cell.std is None else cell.std, int(cell.marked)]
                elif three:
                    cells += ["" if cell is None else cell, "", ""]
                else:
                    cells.append("" if cell is None else cell)
            writer.writerow(cells)
        return out.getvalue()

    def markdown(self) -> str:
        """For GitHub and Sphinx."""
        lines = [f"{_markdown_text(self.caption)}", ""]
        lines.append("| " + " | ".join(_markdown_text(name) for name in self.head) + " |")
        numbers = [self._is_number(i) for i in range(len(self.head))]
        lines.append("|" + "|".join("---:" if right else "---" for right in numbers) + "|")
        lines += ["| " + " | ".join(_markdown(cell) for cell in row) + " |" for row in self.rows]
        lines += [line for note in self.notes for line in ("", _markdown_text(note))]
        return "\n".join(lines) + "\n"

    def _is_number(self, column: int) -> bool:
        return all(not isinstance(row[column], str) or row[column] == "" for row in self.rows)


def _markdown_text(text: str) -> str:
    return re.sub(r"([|*_`<\[\]])", r"\\\1", text).replace("\n", " ")


def _number(value: float) -> str:
    return f"{value:.4f}" if math.isfinite(value) else "-"


def _plain(cell: Cell) -> str:
    if cell is None:
        return "-"
    if isinstance(cell, bool):
        return "yes" if cell else "no"
    if isinstance(cell, float):
        return _number(cell)
    return str(cell)


def _markdown(cell: Cell) -> str:
    if isinstance(cell, Measured):
        mean = _number(cell.mean)
        mean = f"**{mean}**" if cell.marked else mean
        return mean if cell.std is None else f"{mean} ({_number(cell.std)})"
    return _markdown_text(_plain(cell))


# ---- the whole -------------------------------------------------------------------------------


Numbers = dict[str, Any]
"""JSON-able. `missing` lists, in sentences, what the item could not have and why."""


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
    tables: Callable[[Numbers], Mapping[str, Table]]
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


# ---- small multiples: a panel per CMDP in the paper's order, empty where there is no matrix --


WIDTH, HEIGHT = 1.75, 1.45
"""Inches of a panel."""

COLOURS = {
    "random": "#777777",
    "greedy": "#009E73",
    "mbtl": "#0072B2",
    "mbtl-ei": "#56B4E9",
    "mbtl-release": "#CC79A7",
    "specialists": "#D55E00",
    "sequential_oracle": "#000000",
    "independent": "#E69F00",
    "multitask": "#CC79A7",
    "oracle_transfer": "#000000",
}
DASHES = {
    "random": (0, (5, 1.5)),
    "greedy": (0, (5, 1.5, 1.2, 1.5)),
    "sequential_oracle": (0, (1.2, 1.2)),
    "independent": (0, (3, 1)),
    "multitask": (0, (1, 1)),
}
"""Lines differ in more than colour."""


def panels(ids: Sequence[str], shown: Mapping[str, Any], columns: int = 4) -> tuple[Any, dict]:  # type: ignore[type-arg]
    """A figure and its axes by id; ids that are not in `shown` get a panel that says so."""
    columns = min(columns, len(ids))
    rows = -(-len(ids) // columns)
    figure = new_figure(max(WIDTH * columns, 3.4), max(HEIGHT * rows, 2.2) + 0.35)
    grid = figure.subplots(rows, columns, squeeze=False).ravel()
    axes = {}
    for ax, id in zip(grid, ids, strict=False):
        ax.set_title(id, fontsize=7)
        ax.tick_params(labelsize=5.5, length=2, pad=1.5)
        if id in shown:
            axes[id] = ax
        else:
            ax.text(0.5, 0.5, "no matrix yet", ha="center", va="center", fontsize=6.5,
                    color="#777777", transform=ax.transAxes)  # fmt: skip
            ax.set_xticks([])
            ax.set_yticks([])
    for ax in grid[len(ids) :]:
        ax.axis("off")
    return figure, axes


def legend(figure: Any, ax: Any, columns: int = 6) -> None:
    """One legend for all panels, above them."""
    handles, labels = ax.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=columns, fontsize=7)
