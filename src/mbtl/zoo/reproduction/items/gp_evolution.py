"""Item 6: what MBTL's Gaussian process believes, what it expects to gain, and what it picks."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbtl.plot.style import new_figure
from mbtl.selectors import get_selector
from mbtl.selectors.outlook import outlook
from mbtl.zoo.benchmark.replay import replay
from mbtl.zoo.reproduction.bench import Bench
from mbtl.zoo.reproduction.item import Item, Numbers, Table, absent

CMDP = "pendulum-timestep"
_DIGITS = 5


def compute(bench: Bench) -> Numbers:
    """Mean, deviation and acquisition after each training of MBTL on the first seed."""
    found: dict[str, Any] = {}
    if CMDP in bench.available():
        bench.says(f"following the model on {CMDP}")
        matrix = bench.matrix(CMDP)
        axis = matrix.space.axes[0]
        problem = matrix.problem(min(bench.setting.budget, len(matrix.problem(1).sources)))
        selector = get_selector("mbtl")
        history = replay(selector, problem, lambda i: matrix.rows(0, [i])[0]).history
        own = history.training_performance
        steps = []
        for k in range(1, len(history)):
            seen = outlook(problem, history, selector, after=k)
            assert seen is not None  # rows of a matrix are finite
            steps.append(
                {
                    "k": k,
                    "mean": seen.mean.round(_DIGITS).tolist(),
                    "std": seen.std.round(_DIGITS).tolist(),
                    "gain": np.maximum(seen.gain, 0.0).round(_DIGITS + 3).tolist(),
                    "pick": int(history.sources[k]),
                }
            )
        found = {
            "cmdp": CMDP,
            "label": axis.label,
            "x": [float(v) for v in matrix.space.values(axis.name)],
            "sources": [int(s) for s in history.sources],
            "own": own.tolist(),
            "warm_up": int(getattr(selector, "warm_up", 0)),
            "steps": steps,
        }
    return {"found": found, "missing": absent(bench, CMDP)}


def tables(numbers: Numbers) -> dict[str, Table]:
    """A line per training."""
    found = numbers["found"]
    if not found:
        return {}
    rows = tuple(
        (
            step["k"] + 1,
            float(found["x"][step["pick"]]),
            "worst context" if step["k"] <= found["warm_up"] else "largest acquisition",
            step["mean"][step["pick"]],
            step["std"][step["pick"]],
            float(found["own"][step["k"]]),
        )
        for step in found["steps"]
    )
    return {
        "": Table(
            f"MBTL on {found['cmdp']}, first seed: each pick, what the model believed of it, and "
            "what training there gave.",
            ("k", found["label"], "picked by", "believed", "deviation", "training performance"),
            rows,
        )
    }


def figures(numbers: Numbers) -> dict[str, Any]:
    """A panel per training: the belief above, the acquisition below."""
    found = numbers["found"]
    if not found:
        return {}
    steps = found["steps"]
    columns = min(4, len(steps))
    rows = -(-len(steps) // columns)
    figure = new_figure(1.8 * columns, 1.55 * rows + 0.3)
    grid = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True).ravel()
    x = np.array(found["x"])
    for ax, step in zip(grid, steps, strict=False):
        mean, std = np.array(step["mean"]), np.array(step["std"])
        ax.fill_between(x, mean - 1.96 * std, mean + 1.96 * std, alpha=0.2, lw=0, label="95 % band")
        ax.plot(x, mean, lw=1.2, label="mean")
        taken = found["sources"][: step["k"]]
        ax.plot(x[taken], found["own"][: step["k"]], "o", ms=3, color="black", label="trained")
        below = ax.twinx()
        gain = np.array(step["gain"])
        below.fill_between(x, gain, color="#E69F00", alpha=0.6, lw=0)
        below.set_ylim(0, 3.5 * max(float(gain.max()), 1e-9))
        below.set_yticks([])
        ax.axvline(x[step["pick"]], color="#D55E00", ls=":", lw=1.1, label="next pick")
        ax.set_title(f"after {step['k']}", fontsize=7)
        ax.tick_params(labelsize=6)
        ax.set_ylim(min(0.0, min(found["own"])) - 0.1, max(found["own"]) + 0.5)
    for ax in grid[len(steps) :]:
        ax.axis("off")
    grid[0].fill_between([], [], color="#E69F00", alpha=0.6, label="acquisition (own scale)")
    handles, labels = grid[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=5, fontsize=7)
    figure.supxlabel(found["label"], fontsize=8)
    figure.supylabel("training performance", fontsize=8)
    return {"": figure}


ITEM = Item(6, "gp-evolution", "How MBTL's model grows (Pendulum, time step)", compute, tables,
            figures, prefixes=(CMDP,))  # fmt: skip
