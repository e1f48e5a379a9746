"""Item 9: is the gap linear? Its correlation with the distance, source by source.

The control are policies that do not depend on their source: each is worth, everywhere, what a
random one of them is. Their gaps are differences between targets and nothing else.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mbtl.arrays import Array
from mbtl.zoo.benchmark.matrix import TransferMatrix
from mbtl.zoo.reproduction.bench import Bench
from mbtl.zoo.reproduction.item import Item, Numbers, Table, absent, panels

_EDGES = np.linspace(-1.0, 1.0, 21)


def compute(bench: Bench) -> Numbers:
    """Per CMDP the correlations of all sources of all seeds."""
    found = {}
    for id in bench.available():
        matrix = bench.matrix(id)
        all_seeds = [correlations(matrix, seed) for seed in range(matrix.n_seeds)]
        values = np.concatenate(all_seeds)
        known = values[np.isfinite(values)]
        found[id] = {
            "values": known.round(4).tolist(),
            "constant": int(np.isnan(values).sum()),
            "mean": float(known.mean()) if known.size else None,
            "median": float(np.median(known)) if known.size else None,
            "std": float(known.std()) if known.size else None,
            "positive": float((known > 0).mean()) if known.size else None,
            "control": _control(matrix),
        }
    return {"ids": bench.ids, "cmdps": found, "missing": absent(bench)}


def _control(matrix: TransferMatrix) -> float | None:
    """Mean correlation of policies that do not depend on their source."""
    values = np.concatenate([correlations(matrix, s, True) for s in range(matrix.n_seeds)])
    known = values[np.isfinite(values)]
    return float(known.mean()) if known.size else None


def correlations(matrix: TransferMatrix, seed: int, control: bool = False) -> Array:
    """(M,) Pearson's r between |J(pi_x, x) - J(pi_x, x')| and |x - x'| over all x' but x.

    NaN where the gap is the same on every target. theta scales the distance and does not matter.

    Args:
        matrix: of one axis.
        seed: of the matrix.
        control: all policies are worth what they are in the mean.
    """
    sources = matrix.problem(1).sources
    rows = matrix.fresh_rows(seed, sources)
    if control:
        rows = np.broadcast_to(rows.mean(axis=0), rows.shape)
    found = np.full(len(sources), np.nan)
    steps = matrix.space.steps
    for i, source in enumerate(sources):
        others = np.arange(matrix.n) != source
        gap = np.abs(rows[i, source] - rows[i, others])
        distance = np.linalg.norm(steps[others] - steps[source], axis=1)
        if np.ptp(gap) > 1e-9:
            found[i] = np.corrcoef(gap, distance)[0, 1]
    return found


def tables(numbers: Numbers) -> dict[str, Table]:
    """Per CMDP what the histogram shows."""
    rows = tuple(
        (id, *(one[key] for key in ("mean", "control", "median", "std", "positive", "constant")))
        for id, one in numbers["cmdps"].items()
    )
    return {
        "": Table(
            "Pearson correlation of the observed gap with the distance, over all sources of all "
            "seeds.",
            (
                "CMDP",
                "mean",
                "control",
                "median",
                "deviation",
                "share above 0",
                "sources without a gap",
            ),
            rows,
            (
                "control: of policies that do not depend on their source. sources without a gap: "
                "the same return everywhere, so there is no correlation.",
            ),
        )
    }


def figures(numbers: Numbers) -> dict[str, Any]:
    """A histogram per CMDP."""
    figure, axes = panels(numbers["ids"], numbers["cmdps"])
    for id, ax in axes.items():
        one = numbers["cmdps"][id]
        ax.hist(one["values"], bins=_EDGES, color="#0072B2", alpha=0.8)
        if one["mean"] is not None:
            ax.axvline(one["mean"], color="#D55E00", lw=1.2)
        ax.axvline(0.0, color="#777777", lw=0.6, ls=":")
        ax.set_xlim(-1, 1)
    figure.supxlabel("Pearson correlation of gap and distance (orange: mean)", fontsize=8)
    figure.supylabel("sources", fontsize=8)
    return {"": figure}


ITEM = Item(9, "gap-correlation", "Is the gap linear in the distance?", compute, tables, figures)
