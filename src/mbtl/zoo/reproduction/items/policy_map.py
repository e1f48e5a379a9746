"""Item 7: which trained policy serves which context as trainings are added (Pendulum)."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbtl.plot.style import colours, edges, new_figure
from mbtl.routing import routed, routes
from mbtl.zoo.reproduction.bench import Bench
from mbtl.zoo.reproduction.item import Item, Numbers, Table, absent

_DIGITS = 5


def compute(bench: Bench) -> Numbers:
    """Per CMDP MBTL's picks on the first seed, and after each of them who serves whom."""
    found = {}
    for id, case in bench.cases("pendulum").items():
        found[id] = serving(bench, id, case.picks["mbtl"][0])
    return {"cmdps": found, "missing": absent(bench, "pendulum")}


def serving(bench: Bench, id: str, picks: list[int]) -> dict[str, Any]:
    """Who serves which context after each of these trainings, and how well after all."""
    matrix = bench.matrix(id)
    axis = matrix.space.axes[0]
    route = routes(matrix.rows(0, picks), picks, matrix.space.steps)
    served = routed(matrix.fresh_rows(0, picks), route[-1:])[0]
    return {
        "label": axis.label,
        "x": [float(v) for v in matrix.space.values(axis.name)],
        "picks": picks,
        "serving": np.array(picks)[route].tolist(),
        "performance": served.round(_DIGITS).tolist(),
    }


def tables(numbers: Numbers) -> dict[str, Table]:
    """After all trainings: how many contexts each policy serves, and how well."""
    rows = []
    for id, one in numbers["cmdps"].items():
        last, performance = np.array(one["serving"][-1]), np.array(one["performance"])
        for k, pick in enumerate(one["picks"], 1):
            mine = last == pick
            mean = float(performance[mine].mean()) if mine.any() else None
            rows.append((id, k, float(one["x"][pick]), int(mine.sum()), mean))
    return {
        "": Table(
            "Policies of MBTL on the first seed: how many contexts each serves after all "
            "trainings, and how well.",
            ("CMDP", "k", "trained at", "contexts served", "mean performance"),
            tuple(rows),
        )
    }


def figures(numbers: Numbers) -> dict[str, Any]:
    """A strip per training, coloured by where the serving policy was trained."""
    shown = numbers["cmdps"]
    if not shown:
        return {}
    from matplotlib.colors import ListedColormap

    figure = new_figure(6.8, 2.9)
    grid = np.atleast_1d(figure.subplots(1, len(shown)))
    for ax, (id, one) in zip(grid, shown.items(), strict=True):
        x, serving = np.array(one["x"]), np.array(one["serving"])
        order = np.sort(one["picks"])
        mesh = ax.pcolormesh(
            edges(None, x),
            np.arange(len(serving) + 1) + 0.5,
            np.searchsorted(order, serving),
            cmap=ListedColormap(colours(len(order))),
            vmin=-0.5,
            vmax=len(order) - 0.5,
            rasterized=True,
        )
        mesh.set_edgecolor("face")
        for k, pick in enumerate(one["picks"], 1):
            ax.plot(x[pick], k, "D", ms=3, mfc="white", mec="black", mew=0.6)
        ax.set_title(id, fontsize=8)
        ax.set_xlabel(one["label"], fontsize=8)
        ax.invert_yaxis()
    grid[0].set_ylabel("after k trainings")
    figure.suptitle(
        "Colour: where the serving policy was trained. Diamonds: the training of that step.",
        fontsize=8,
    )
    return {"": figure}


ITEM = Item(7, "policy-map", "Which policy serves which context (Pendulum)", compute, tables,
            figures, prefixes=("pendulum",))  # fmt: skip
