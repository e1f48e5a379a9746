"""Item 8: does it matter which RL algorithm trains, or which acquisition picks?"""

from __future__ import annotations

from typing import Any

import numpy as np

from mbtl.plot.style import new_figure
from mbtl.zoo.benchmark.shipped import matrix_id
from mbtl.zoo.reproduction.bench import Bench
from mbtl.zoo.reproduction.item import COLOURS, DASHES, Item, Measured, Numbers, Table, absent
from mbtl.zoo.reproduction.paper import HEADS, METHODS, Value, pooled_mean

CMDP = "cartpole-length"
ALGORITHMS = {"PPO": None, "DQN": "dqn", "A2C": "a2c"}
"""Name -> set of matrices; None: the one asked for."""

ACQUISITIONS = {"mbtl": "UCB", "mbtl-ei": "EI", "mbtl-release": "released code"}
_ON_ALL = ("multitask", "one_policy")
"""Methods that are of one algorithm."""
_SHOWN = ("random", "greedy", "mbtl", "sequential_oracle")


def compute(bench: Bench) -> Numbers:
    """Tables and curves per algorithm, and V at K per acquisition on every CMDP."""
    algorithms: dict[str, Any] = {}
    missing = []
    for name, variant in ALGORITHMS.items():
        if CMDP not in bench.ids:
            continue
        if not bench.has(CMDP, variant):
            missing.append(
                f"{name} on {CMDP}: no matrix of {matrix_id(CMDP, variant or 'default')!r} yet; "
                f"build it with: mbtl matrix build {CMDP}"
                + ("" if variant is None else f" --algorithm {name}")
            )
            continue
        case = bench.case(CMDP, variant)
        algorithms[name] = {
            "values": {m: v.to_json() for m, v in case.values.items() if m not in _ON_ALL},
            "curves": {n: case.curves[n].mean(axis=0).tolist() for n in _SHOWN},
            "mbtl_minus_random": pooled_mean(
                [case.curves["mbtl"][:, -1] - case.curves["random"][:, -1]]
            ).to_json(),
        }
    rows, differences = [], []
    for id, case in bench.cases().items():
        values = {a: Value.of(case.curves[a][:, -1]).to_json() for a in (*ACQUISITIONS, "random")}
        rows.append({"cmdp": id, "values": values})
        differences.append(case.curves["mbtl-ei"][:, -1] - case.curves["mbtl"][:, -1])
    ei = pooled_mean(differences).to_json() if differences else None
    return {
        "cmdp": CMDP,
        "algorithms": algorithms,
        "acquisitions": rows,
        "ei_minus_ucb": ei,
        "missing": [*absent(bench), *missing],
    }


def tables(numbers: Numbers) -> dict[str, Table]:
    """One per question."""
    found = {}
    methods = [m for m in METHODS if m not in _ON_ALL]
    if numbers["algorithms"]:
        rows = tuple(
            (name, *(Measured.of(one["values"].get(m)) for m in methods))
            for name, one in numbers["algorithms"].items()
        )
        found["algorithm"] = Table(
            f"The algorithm that trains, on {numbers['cmdp']}: V at K, mean (standard deviation) "
            "over seeds.",
            ("algorithm", *(HEADS[m] for m in methods)),
            rows,
        )
    rows = tuple(
        (row["cmdp"], *(Measured.of(row["values"][a]) for a in ACQUISITIONS))
        for row in numbers["acquisitions"]
    )
    found["acquisition"] = Table(
        "The acquisition that picks: V of MBTL at K.", ("CMDP", *ACQUISITIONS.values()), rows
    )
    return found


def figures(numbers: Numbers) -> dict[str, Any]:
    """Curves per algorithm, and EI less UCB per CMDP."""
    found = {}
    some = numbers["algorithms"]
    if some:
        figure = new_figure(6.8, 2.4)
        grid = np.atleast_1d(figure.subplots(1, len(some), sharey=True))
        for ax, (name, one) in zip(grid, some.items(), strict=True):
            for method, curve in one["curves"].items():
                ax.plot(
                    np.arange(1, len(curve) + 1),
                    curve,
                    color=COLOURS[method],
                    ls=DASHES.get(method, "-"),
                    label=HEADS[method],
                )
            ax.set_title(f"{numbers['cmdp']}, {name}", fontsize=8)
            ax.set_xlabel("trainings k")
        grid[0].set_ylabel("V")
        grid[-1].legend(loc="lower right", fontsize=7)
        found["algorithm"] = figure
    rows = numbers["acquisitions"]
    if rows:
        figure = new_figure(5.2, 0.6 + 0.19 * len(rows))
        ax = figure.subplots()
        for y, row in enumerate(reversed(rows)):
            base = row["values"]["mbtl"]["mean"]
            for other, mark in (("mbtl-ei", "o"), ("mbtl-release", "D")):
                label = ACQUISITIONS[other] if y == 0 else None
                gain = row["values"][other]["mean"] - base
                ax.plot(gain, y, mark, ms=4, color=COLOURS[other], label=label)
        ax.axvline(0.0, color="#777777", lw=0.8)
        ax.set_yticks(range(len(rows)), [row["cmdp"] for row in reversed(rows)], fontsize=7)
        ax.set_xlabel("V at K less that of MBTL with UCB")
        ax.legend(loc="best")
        found["acquisition"] = figure
    return found


ITEM = Item(8, "sensitivity", "Sensitivity to the RL algorithm and the acquisition", compute,
            tables, figures, variants=("dqn", "a2c"))  # fmt: skip
