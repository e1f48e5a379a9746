"""Item 3: V against the number of trainings, for every CMDP and method, with k*."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbtl.zoo.reproduction.bench import Bench
from mbtl.zoo.reproduction.item import COLOURS, DASHES, Item, Numbers, Table, absent, legend, panels
from mbtl.zoo.reproduction.paper import HEADS

SHOWN = ("random", "greedy", "mbtl", "sequential_oracle")
_KEPT = (*SHOWN, "specialists")


def compute(bench: Bench) -> Numbers:
    """Per CMDP the mean, lowest and highest curve of each method, and the levels across."""
    cases = bench.cases()
    found = {}
    for id, case in cases.items():
        stars = [k for k in case.k_star if k is not None]
        found[id] = {
            "curves": {
                name: {
                    "mean": case.curves[name].mean(axis=0).tolist(),
                    "low": case.curves[name].min(axis=0).tolist(),
                    "high": case.curves[name].max(axis=0).tolist(),
                }
                for name in _KEPT
                if name in case.curves
            },
            "levels": {
                "independent": float(case.levels["independent"].mean()),
                **({} if case.own is None else {"multitask": float(case.own.mean())}),
            },
            "k_star": float(np.mean(stars)) if len(stars) == case.n_seeds else None,
        }
    return {"ids": bench.ids, "cmdps": found, "missing": absent(bench)}


def tables(numbers: Numbers) -> dict[str, Table]:
    """The mean curves, a line per CMDP, method and k."""
    rows = tuple(
        (id, HEADS.get(name, name), k, float(value))
        for id, one in numbers["cmdps"].items()
        for name, curve in one["curves"].items()
        for k, value in enumerate(curve["mean"], 1)
    )
    caption = "V after each training, mean over seeds."
    return {"": Table(caption, ("CMDP", "method", "k", "V"), rows)}


def figures(numbers: Numbers) -> dict[str, Any]:
    """A panel per CMDP."""
    figure, axes = panels(numbers["ids"], numbers["cmdps"])
    for id, ax in axes.items():
        one = numbers["cmdps"][id]
        for name in SHOWN:
            if name not in one["curves"]:
                continue
            curve = one["curves"][name]
            k = np.arange(1, len(curve["mean"]) + 1)
            line = {"color": COLOURS[name], "ls": DASHES.get(name, "-"), "label": HEADS[name]}
            ax.plot(k, curve["mean"], lw=1.5 if name == "mbtl" else 1.0, **line)
            if name == "mbtl":
                ax.fill_between(k, curve["low"], curve["high"], color=COLOURS[name], alpha=0.15,
                                lw=0)  # fmt: skip
        for name, level in one["levels"].items():
            ax.axhline(level, color=COLOURS[name], ls=DASHES[name], lw=0.9, label=HEADS[name])
        if one["k_star"] is not None and one["k_star"] <= len(one["curves"]["mbtl"]["mean"]):
            ax.axvline(one["k_star"], color="#333333", ls=":", lw=0.9)
        ax.xaxis.get_major_locator().set_params(integer=True)
    if axes:
        fullest = max(axes.values(), key=lambda ax: len(ax.get_lines()))
        legend(figure, fullest)
    figure.supxlabel("trainings k (dotted: k*)", fontsize=8)
    figure.supylabel("generalisation performance V", fontsize=8)
    return {"": figure}


ITEM = Item(3, "curves", "V against the number of trainings", compute, tables, figures)
