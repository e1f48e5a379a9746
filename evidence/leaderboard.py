"""The leaderboard of selectors on all shipped matrices.

    .venv/bin/python evidence/leaderboard.py [--budget 30]

Nothing that was learned has seen what it is judged on: `specialists` runs with the prior fitted
without the family of each matrix. Beside the selectors stands "the other seeds", which is none: it
owns the whole matrices of the other seeds of the same CMDP, smoothed over sources, and picks by
their mean gain. What separates it from the Sequential Oracle is luck of single trainings, which
nobody can foresee.

Sets with several axes have a table of their own, without the selectors that need one axis (n/a).
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

import numpy as np
from scipy.ndimage import gaussian_filter

from mbtl.zoo.benchmark import compare, levels
from mbtl.zoo.benchmark.base import measured_curve
from mbtl.zoo.benchmark.compare import default_selectors
from mbtl.zoo.benchmark.comparison import Estimate, Summary, Trainings, trainings_to
from mbtl.zoo.benchmark.shipped import load_by_id, open_matrices, shipped_matrices

SELECTORS = (
    "random", "greedy", "mbtl", "mbtl-release", "gp-mbtl", "m-mbtl", "sd-mbtl",
    "specialists", "oracle",
)  # fmt: skip
SMOOTH = 2.0
"""Grid steps over which the rows of the other seeds are averaged."""


def told(matrix_id: str, budget: int) -> np.ndarray:
    """(levels,) mean logarithm of the trainings to each share, a level not reached as K + 1."""
    matrix = load_by_id(matrix_id)
    shape = matrix.space.shape or (matrix.n,)
    every = np.arange(matrix.n)
    rows = np.stack([matrix.rows(s, every) for s in range(matrix.n_seeds)])
    logs = []
    for s in range(matrix.n_seeds):
        others = np.delete(rows, s, axis=0)
        best, taken = np.full(matrix.n, -np.inf), []
        for _ in range(budget):
            base = best if taken else np.zeros(matrix.n)
            gain = (np.maximum(others - base, 0.0) if taken else others).mean(axis=(0, 2))
            gain = gaussian_filter(gain.reshape(shape), SMOOTH, mode="nearest").ravel()
            gain[taken] = -np.inf
            taken.append(int(gain.argmax()))
            best = np.maximum(best, rows[s, taken[-1]])
        known, curve = levels(matrix, s), measured_curve(matrix, s, taken)
        reached = trainings_to(curve, known.grand_mean, known.oracle_transfer)
        logs.append([np.log(budget + 1 if k is None else k) for k in reached])
    return np.mean(logs, axis=0)


def trainings(found: Trainings, budget: int) -> str:
    value = found.estimate.value
    if value is None:
        return f"> {budget}"
    return f"> {value:.1f}" if found.censored else f"{value:.1f}"


def closed(found: Estimate) -> str:
    if found.value is None:
        return "-"
    interval = "" if found.low is None else f" [{found.low:.2f}, {found.high:.2f}]"
    return f"{found.value:.2f}{interval}"


def pooled(summary: Summary, known: np.ndarray | None) -> list[str]:
    lines = [
        f"| selector | k90 | k95 | k99 | closed at K = {summary.budget} | closed under the curve |",
        "|---|---|---|---|---|---|",
    ]
    for name, s in summary.pooled.items():
        cells = [name, *(trainings(k, summary.budget) for k in (s.k90, s.k95, s.k99))]
        cells += [closed(s.closed_at_K), closed(s.closed_under_curve)]
        lines.append(f"| {' | '.join(cells)} |")
    if known is None:
        return lines
    values = " | ".join(f"{v:.1f}" for v in np.exp(known))
    return [*lines, f"| *the other seeds* | {values} | | |"]


def board(names: Sequence[str], ids: Sequence[str], budget: int) -> list[str]:
    """Pooled table of matrices that all these selectors can run on."""
    summary = compare(names, ids, budget).summary
    # the others' matrices tell of every context only where all were trained on
    several = [i for i in ids if (m := load_by_id(i)).n_seeds > 1 and m.sources is None]
    known = np.mean([told(i, budget) for i in several], axis=0) if several else None
    return pooled(summary, known)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--budget", type=int, default=30)
    args = parser.parse_args()
    lines_of = open_matrices(["all"])
    whole = {  # one seed would leave the pool without intervals, few sources without a budget of 30
        i: matrix.n_seeds > 1 and matrix.returns.shape[1] > args.budget
        for i, matrix in lines_of.items()
    }
    sets = {
        "one axis": [i for i in whole if whole[i]],
        "one axis, of one seed or few sources": [i for i in whole if not whole[i]],
        "several axes": [i for i in shipped_matrices() if load_by_id(i).space.d > 1],
    }
    lines: list[str] = []
    for axes, ids in sets.items():
        if not ids:
            continue
        able = default_selectors(ids)
        few = min(load_by_id(i).returns.shape[1] for i in ids)
        budget = min(args.budget, 3 * few // 4)  # of nearly all of them every rule is right
        table = board([n for n in SELECTORS if n in able], ids, budget)
        count = f"{len(ids)} set{'s' * (len(ids) > 1)}"
        lines += [f"{count} of matrices with {axes}, K = {budget}", "", *table, ""]
    print("\n".join(lines))


if __name__ == "__main__":
    main()
