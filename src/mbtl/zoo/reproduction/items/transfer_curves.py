"""Item 12: a few CartPole policies on all targets."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbtl.plot.style import colours, new_figure
from mbtl.zoo.reproduction.bench import Bench
from mbtl.zoo.reproduction.item import Item, Numbers, Table, absent

_SOURCES = 5
_DIGITS = 5


def compute(bench: Bench) -> Numbers:
    """Per CMDP the rows of five sources spread over the axis, mean over seeds."""
    found = {}
    for id in bench.available("cartpole"):
        matrix = bench.matrix(id)
        axis = matrix.space.axes[0]
        everyone = matrix.problem(1).sources
        places = np.linspace(0, len(everyone) - 1, min(_SOURCES, len(everyone))).round().astype(int)
        table = matrix.shown()
        found[id] = {
            "label": axis.label,
            "x": [float(v) for v in matrix.space.values(axis.name)],
            "sources": [int(everyone[p]) for p in places],
            "rows": table[places].round(_DIGITS).tolist(),
        }
    return {"cmdps": found, "missing": absent(bench, "cartpole")}


def tables(numbers: Numbers) -> dict[str, Table]:
    """A line per source and target."""
    rows = tuple(
        (id, float(one["x"][source]), float(x), value)
        for id, one in numbers["cmdps"].items()
        for source, row in zip(one["sources"], one["rows"], strict=True)
        for x, value in zip(one["x"], row, strict=True)
    )
    caption = "Performance of a few policies on all targets, mean over seeds."
    return {"": Table(caption, ("CMDP", "source", "target", "performance"), rows)}


def figures(numbers: Numbers) -> dict[str, Any]:
    """A panel per CMDP; a dot marks the source of each curve."""
    some = numbers["cmdps"]
    if not some:
        return {}
    figure = new_figure(6.8, 2.5)
    grid = np.atleast_1d(figure.subplots(1, len(some), sharey=True))
    for ax, (id, one) in zip(grid, some.items(), strict=True):
        x = np.array(one["x"])
        for source, row, colour in zip(
            one["sources"], one["rows"], colours(len(one["sources"])), strict=True
        ):
            ax.plot(x, row, color=colour, lw=1.2)
            ax.plot(x[source], row[source], "o", color=colour, mec="black", ms=5, zorder=3)
        ax.set_title(id, fontsize=8)
        ax.set_xlabel(one["label"])
    grid[0].set_ylabel("performance")
    figure.suptitle("Each curve is one policy; its dot is where it was trained.", fontsize=8)
    return {"": figure}


ITEM = Item(12, "transfer-curves", "A few CartPole policies on all targets", compute, tables,
            figures, prefixes=("cartpole",))  # fmt: skip
