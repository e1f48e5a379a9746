"""Small multiples: a panel per CMDP in the paper's order, empty where there is no matrix."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from mbtl.plot.style import new_figure

WIDTH, HEIGHT = 1.75, 1.45
"""Inches of a panel."""

COLOURS = {
    "random": "#777777",
    "greedy": "#009E73",
    "mbtl": "#0072B2",
    "mbtl-ei": "#56B4E9",
    "mbtl-release": "#CC79A7",
    "auto": "#D55E00",
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
