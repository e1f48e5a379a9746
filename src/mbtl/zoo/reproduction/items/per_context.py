"""Item 4: performance per context of Independent, Multi-task and Oracle Transfer."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbtl.arrays import Array
from mbtl.routing import last_route, routed
from mbtl.zoo.benchmark.matrix import TransferMatrix
from mbtl.zoo.benchmark.multitask import load_multitask
from mbtl.zoo.reproduction.bench import OWN, Bench, same_problem
from mbtl.zoo.reproduction.item import COLOURS, Item, Numbers, Table, absent, legend, panels
from mbtl.zoo.reproduction.paper import HEADS

_DIGITS = 5


def compute(bench: Bench) -> Numbers:
    """Per CMDP and context the three performances, means over seeds."""
    found = {}
    for id in bench.available():
        matrix = bench.matrix(id)
        axis = matrix.space.axes[0]
        sources = matrix.problem(1).sources
        seeds = range(matrix.n_seeds)
        home = np.mean([_at_home(matrix, s) for s in seeds], axis=0)
        best = np.mean([best_of_all(matrix, s) for s in seeds], axis=0)
        found[id] = {
            "label": axis.label,
            "x": [float(v) for v in matrix.space.values(axis.name)],
            "sources": [int(s) for s in sources],
            "independent": home.round(_DIGITS).tolist(),
            "oracle_transfer": best.round(_DIGITS).tolist(),
            "gap": float((best[sources] - home).mean()),
            **_multitask(bench, id, matrix),
        }
    return {"ids": bench.ids, "cmdps": found, "missing": absent(bench)}


def _at_home(matrix: TransferMatrix, seed: int) -> Array:
    sources = matrix.problem(1).sources
    return np.asarray(matrix.fresh_rows(seed, sources)[np.arange(len(sources)), sources])


def best_of_all(matrix: TransferMatrix, seed: int) -> Array:
    """(N,) performance of the policy that serves each context if all M are there."""
    sources = [int(s) for s in matrix.problem(1).sources]
    route = last_route(matrix.rows(seed, sources), sources, matrix.space.steps)
    return np.asarray(routed(matrix.fresh_rows(seed, sources), route[None])[0])


def _multitask(bench: Bench, id: str, matrix: TransferMatrix) -> dict[str, Any]:
    folder = bench.setting.folder
    baselines = load_multitask(id, folder=None if folder is None else folder / "multitask")
    for name in OWN:
        if name in baselines and same_problem(baselines[name], matrix, bench.setting.variant):
            rows = matrix.bounds.normalise(baselines[name].returns)
            return {"multitask": rows.mean(axis=0).round(_DIGITS).tolist()}
    return {}


def tables(numbers: Numbers) -> dict[str, Table]:
    """A line per CMDP and context."""
    rows = []
    for id, one in numbers["cmdps"].items():
        home = dict(zip(one["sources"], one["independent"], strict=True))
        for i, x in enumerate(one["x"]):
            multi = one["multitask"][i] if "multitask" in one else None
            rows.append((id, float(x), home.get(i), multi, one["oracle_transfer"][i]))
    head = ("CMDP", "context", "Independent", "Multi-task", "Oracle Transfer")
    caption = "Performance per context, mean over seeds."
    return {"": Table(caption, head, tuple(rows))}


def figures(numbers: Numbers) -> dict[str, Any]:
    """A panel per CMDP."""
    figure, axes = panels(numbers["ids"], numbers["cmdps"])
    for id, ax in axes.items():
        one = numbers["cmdps"][id]
        x = np.array(one["x"])
        ax.plot(x[one["sources"]], one["independent"], color=COLOURS["independent"], lw=1,
                label=HEADS["independent"])  # fmt: skip
        if "multitask" in one:
            ax.plot(x, one["multitask"], color=COLOURS["multitask"], lw=1, ls=(0, (4, 1.5)),
                    label=HEADS["multitask"])  # fmt: skip
        ax.plot(x, one["oracle_transfer"], color=COLOURS["oracle_transfer"], lw=1,
                ls=(0, (1.2, 1)), label=HEADS["oracle_transfer"])  # fmt: skip
        ax.set_xlabel(one["label"], fontsize=6, labelpad=1)
    if axes:
        legend(figure, max(axes.values(), key=lambda ax: len(ax.get_lines())))
    figure.supylabel("performance", fontsize=8)
    return {"": figure}


ITEM = Item(4, "per-context", "Performance per context: the generalisation gap", compute, tables,
            figures)  # fmt: skip
