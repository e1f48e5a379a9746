"""Item 3: V against the number of trainings, for every CMDP and method, with k*."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbtl.plot.style import new_figure
from mbtl.reproduction.bench import Bench
from mbtl.reproduction.item import COLOURS, DASHES, Item, Numbers, Table, absent, legend, panels
from mbtl.reproduction.paper import HEADS, pooled

SHOWN = ("random", "greedy", "mbtl", "sequential_oracle")
_SELECTORS = ("greedy", "mbtl", "auto")
_POOLED = (*SHOWN, "auto")


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
                for name in _POOLED
                if name in case.curves
            },
            "levels": {
                "independent": float(case.levels["independent"].mean()),
                **({} if case.own is None else {"multitask": float(case.own.mean())}),
            },
            "k_star": float(np.mean(stars)) if len(stars) == case.n_seeds else None,
        }
    shares: dict[str, list[Any]] = {}
    shortest = min((case.curves["mbtl"].shape[1] for case in cases.values()), default=0)
    for name in _POOLED:
        there = [case.share(case.curves[name]) for case in cases.values() if name in case.curves]
        if there and len(there) == len(cases):
            shares[name] = [pooled([s[:, k] for s in there]).to_json() for k in range(shortest)]
    return {"ids": bench.ids, "cmdps": found, "pooled": shares, "missing": absent(bench)}


def tables(numbers: Numbers) -> dict[str, Table]:
    """The mean curves, a line per CMDP, method and k; and who is ahead at which budget."""
    rows = tuple(
        (id, HEADS.get(name, name), k, float(value))
        for id, one in numbers["cmdps"].items()
        for name, curve in one["curves"].items()
        for k, value in enumerate(curve["mean"], 1)
    )
    caption = "V after each training, mean over seeds."
    return {"": Table(caption, ("CMDP", "method", "k", "V"), rows), "closed": _closed(numbers)}


def _closed(numbers: Numbers) -> Table:
    """The share of the distance from Random to the Sequential Oracle after each training."""
    curves = [{name: one["curves"][name]["mean"] for name in one["curves"]}
              for one in numbers["cmdps"].values()]  # fmt: skip
    names = [name for name in _SELECTORS if all(name in one for one in curves)]
    last = min((len(one["mbtl"]) for one in curves), default=0)
    rows = []
    for k in range(last):
        room = sum(one["sequential_oracle"][k] - one["random"][k] for one in curves)
        gains = (sum(one[name][k] - one["random"][k] for one in curves) for name in names)
        rows.append((k + 1, *(gain / room if room > 0.0 else None for gain in gains)))
    caption = (
        f"Share of the distance from Random to the Sequential Oracle, over {len(curves)} CMDPs: "
        "the ratio of the mean gains."
    )
    return Table(caption, ("k", *(HEADS.get(name, name) for name in names)), tuple(rows))


def figures(numbers: Numbers) -> dict[str, Any]:
    """A panel per CMDP, and all of them together."""
    found = {"": _each(numbers)}
    if numbers["pooled"]:
        found["pooled"] = _together(numbers)
    return found


def _each(numbers: Numbers) -> Any:
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
    return figure


def _together(numbers: Numbers) -> Any:
    figure = new_figure(5.2, 3.4)
    ax = figure.subplots()
    for name, points in numbers["pooled"].items():
        k = np.arange(1, len(points) + 1)
        line = {"color": COLOURS[name], "ls": DASHES.get(name, "-")}
        ax.plot(k, [p["value"] for p in points], label=HEADS.get(name, name), **line)
        if points[0]["low"] is not None:
            ax.fill_between(k, [p["low"] for p in points], [p["high"] for p in points],
                            color=COLOURS[name], alpha=0.15, lw=0)  # fmt: skip
    ax.xaxis.get_major_locator().set_params(integer=True)
    ax.set_xlabel("trainings k")
    ax.set_ylabel("share of the way from one random\npolicy (0) to all N policies (1)")
    ax.set_title(f"Interquartile mean over {len(numbers['cmdps'])} CMDPs, 95 % intervals")
    ax.legend(loc="lower right")
    return figure


ITEM = Item(3, "curves", "V against the number of trainings", compute, tables, figures)
