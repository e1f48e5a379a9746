"""Item 5: transfer matrices as pictures, and figures for what the paper says of them."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbtl.arrays import Array
from mbtl.plot.style import edges
from mbtl.report.reference import REFERENCE_NAMES
from mbtl.zoo.benchmark.matrix import TransferMatrix
from mbtl.zoo.reproduction.bench import Bench
from mbtl.zoo.reproduction.item import Item, Numbers, Table, absent, panels

_DIGITS = 4
_HEADS = {
    "spread": "spread",
    "by_source": "by source",
    "by_target": "by target",
    "near": "near",
    "far": "far",
    "up": "low to high",
    "down": "high to low",
}


def compute(bench: Bench) -> Numbers:
    """Per CMDP the mean matrix over seeds, and what describes it."""
    found = {}
    for id in bench.available():
        matrix = bench.matrix(id)
        axis = matrix.space.axes[0]
        table = matrix.shown()
        found[id] = {
            "label": axis.label,
            "x": [float(v) for v in matrix.space.values(axis.name)],
            "sources": [int(s) for s in matrix.problem(1).sources],
            "table": table.round(_DIGITS).tolist(),
            "facts": facts(matrix, table),
            "control": facts(matrix, np.broadcast_to(table.mean(axis=0), table.shape)),
            "without": _without(matrix),
        }
    return {"ids": bench.ids, "cmdps": found, "missing": absent(bench)}


def _without(matrix: TransferMatrix) -> dict[str, Any] | None:
    """Trend and deviation along the axis without any policy, the system alone or random actions."""
    for name in ("unguided", "random_actions"):
        if name in matrix.references:
            row = matrix.bounds.normalise(matrix.references[name]).mean(axis=(0, 1))
            return {
                "name": REFERENCE_NAMES[name],
                "by_target": float(row.std()),
                "target_trend": _trend(row),
            }
    return None


def _trend(values: Array) -> float:
    """Spearman's rank correlation with the axis."""
    from scipy.stats import spearmanr  # kept out of `import mbtl`

    if np.ptp(values) == 0.0:
        return 0.0
    return float(spearmanr(np.arange(len(values)), values).statistic)


def facts(matrix: TransferMatrix, table: Array) -> dict[str, float]:
    """What a matrix looks like, in performance.

    near and far are means over pairs at most a tenth and at least half of the axis apart, less the
    mean performance at home of the targets' nearest sources. up is the mean of the sources of the
    lowest third on targets of the highest, less what sources of the highest third have there; down
    the other way round. Trends are Spearman's rank correlations of the means along the axis.
    """
    sources = matrix.problem(1).sources
    n = matrix.n
    apart = np.abs(sources[:, None] - np.arange(n))
    home = float(table[np.arange(len(sources)), sources].mean())
    low_s, high_s = sources < n / 3, sources >= 2 * n / 3
    low_t, high_t = np.arange(n) < n / 3, np.arange(n) >= 2 * n / 3
    columns, rows = table.mean(axis=0), table.mean(axis=1)

    return {
        "mean": float(table.mean()),
        "home": home,
        "spread": float(table.std()),
        "by_source": float(rows.std()),
        "by_target": float(columns.std()),
        "near": float(table[apart <= n / 10].mean()) - home,
        "far": float(table[apart >= n / 2].mean()) - home,
        "up": float(table[np.ix_(low_s, high_t)].mean() - table[np.ix_(high_s, high_t)].mean()),
        "down": float(table[np.ix_(high_s, low_t)].mean() - table[np.ix_(low_s, low_t)].mean()),
        "target_trend": _trend(columns),
        "source_trend": _trend(rows),
    }


def tables(numbers: Numbers) -> dict[str, Table]:
    """What describes each matrix."""
    rows = tuple(
        (id, *(f"{one['facts'][key]:.3f}" for key in _HEADS))
        for id, one in numbers["cmdps"].items()
    )
    return {
        "facts": Table(
            "What the transfer matrices look like, in performance, mean over seeds.",
            ("CMDP", *_HEADS.values()),
            rows,
            ("spread: deviation over all entries; by source and by target: of the means of rows "
             "and columns. near and far: pairs at most a tenth and at least half of the axis "
             "apart, less the mean at home. low to high: policies of the lowest third on targets "
             "of the highest, less the policies from there; high to low: the other way round.",),
        )
    }  # fmt: skip


def figures(numbers: Numbers) -> dict[str, Any]:
    """A panel per CMDP: source up the side, target along the bottom."""
    figure, axes = panels(numbers["ids"], numbers["cmdps"])
    for id, ax in axes.items():
        one = numbers["cmdps"][id]
        x, table = np.array(one["x"]), np.array(one["table"])
        mesh = ax.pcolormesh(edges(None, x), edges(None, x[one["sources"]]), table, rasterized=True)
        bar = figure.colorbar(mesh, ax=ax, pad=0.02, aspect=14)
        bar.ax.tick_params(labelsize=5, length=1.5, pad=1)
        bar.outline.set_linewidth(0.4)
        ax.set_xlabel(one["label"], fontsize=6, labelpad=1)
    figure.supxlabel("target context", fontsize=8)
    figure.supylabel("source context", fontsize=8)
    return {"": figure}


ITEM = Item(5, "heatmaps", "Transfer heatmaps", compute, tables, figures)
