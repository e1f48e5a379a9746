"""Item 10: one policy for all contexts by PaCo and MOORE, on CartPole."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbtl.plot.style import new_figure
from mbtl.zoo.reproduction.bench import Bench
from mbtl.zoo.reproduction.item import Item, Measured, Numbers, Table, absent
from mbtl.zoo.reproduction.paper import HEADS, Value

_RIVALS = {"ppo": "Multi-task PPO", "paco": "PaCo", "moore": "MOORE"}


def compute(bench: Bench) -> Numbers:
    """Per CMDP V of each, beside Independent and MBTL."""
    rows, missing = [], absent(bench, "cartpole")
    for id, case in bench.cases("cartpole").items():
        own = ("independent", "one_policy", "mbtl")
        values = {name: case.values[name] for name in own if name in case.values}
        values |= {name: Value.of(v) for name, v in case.multitask.items() if name in _RIVALS}
        rows.append({"cmdp": id, "values": {n: v.to_json() for n, v in values.items()}})
        missing += [
            f"{_RIVALS[name]} on {id}: no returns yet; make them with: mbtl matrix multitask {id} "
            f"--method {name}"
            for name in _RIVALS
            if name not in case.multitask
        ]
    return {"rows": rows, "missing": missing}


def tables(numbers: Numbers) -> dict[str, Table]:
    """V per method."""
    names = ["independent", *_RIVALS, "one_policy", "mbtl"]
    heads = {**HEADS, **_RIVALS}
    rows = tuple(
        (row["cmdp"], *(Measured.of(row["values"].get(n)) for n in names))
        for row in numbers["rows"]
    )
    return {
        "": Table(
            "One policy for all contexts: V, mean (standard deviation) over seeds.",
            ("CMDP", *(heads[n] for n in names)),
            rows,
            ("The first three multi-task methods have the steps of one source, MBTL those of K.",),
        )
    }  # fmt: skip


def figures(numbers: Numbers) -> dict[str, Any]:
    """Dots per method, beside each other."""
    rows = numbers["rows"]
    if not rows:
        return {}
    names = {"independent": "Independent", **_RIVALS, "mbtl": "MBTL"}
    figure = new_figure(5.2, 2.4)
    ax = figure.subplots()
    for i, (name, label) in enumerate(names.items()):
        at = [j + 0.13 * (i - 2) for j, row in enumerate(rows) if name in row["values"]]
        there = [row["values"][name] for row in rows if name in row["values"]]
        if there:
            ax.errorbar(at, [v["mean"] for v in there], [v["std"] or 0.0 for v in there],
                        fmt="osD^v"[i], ms=4, lw=1, label=label)  # fmt: skip
    ax.set_xticks(np.arange(len(rows)), [row["cmdp"] for row in rows])
    ax.set_ylabel("V")
    ax.legend(loc="best", fontsize=7, ncols=2)
    return {"": figure}


ITEM = Item(10, "multitask-rivals", "PaCo and MOORE on CartPole", compute, tables, figures,
            prefixes=("cartpole",))  # fmt: skip
