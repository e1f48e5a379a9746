"""The leaderboard of selectors on the paper's CMDPs, one set of matrices each.

    .venv/bin/python evidence/leaderboard.py [--budget 15]

Nothing that was learned has seen what it is judged on: `specialists` runs with the prior fitted
without the family of each matrix. Beside the selectors stands "the other seeds", which is none: it
owns the whole matrices of the other seeds of the same CMDP, smoothed over sources, and picks by
their mean gain. What separates it from the Sequential Oracle is luck of single trainings, which
nobody can foresee.

The lead of `specialists` is that of the mean share of the way from one random policy to all of
them, CMDP by CMDP, with half a 95 % interval over the CMDPs. Sets with several axes have a table of
their own, without the selectors that need one axis.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

import numpy as np
from scipy.ndimage import gaussian_filter

from mbtl.episodes import student
from mbtl.zoo.benchmark import compare
from mbtl.zoo.benchmark.base import measured_curve
from mbtl.zoo.benchmark.compare import default_selectors
from mbtl.zoo.benchmark.comparison import Comparison, Estimate, Trainings, summarise
from mbtl.zoo.benchmark.shipped import load_by_id, shipped_matrices
from mbtl.zoo.reproduction import published

SELECTORS = (
    "specialists", "mbtl", "mbtl-ei", "mbtl-release", "m-mbtl", "sd-mbtl", "gp-mbtl", "greedy",
    "kmeans", "equidistant", "worst-first", "random", "oracle",
)  # fmt: skip
FIRST = SELECTORS[0]
SMOOTH = 2.0
"""Grid steps over which the rows of the other seeds are averaged."""


def other_seeds(matrix_id: str, budget: int) -> np.ndarray:
    """(S, K) V of who picks by the rows of the other seeds."""
    matrix = load_by_id(matrix_id)
    shape = matrix.space.shape or (matrix.n,)
    every = np.arange(matrix.n)
    rows = np.stack([matrix.rows(s, every) for s in range(matrix.n_seeds)])
    curves = []
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
        curves.append(measured_curve(matrix, s, taken))
    return np.array(curves)


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


def shares(result: Comparison, ids: Sequence[str]) -> dict[str, np.ndarray]:
    """(CMDPs,) mean share of the way under the curve, by selector; seeds as a ratio of sums."""
    each: dict[str, list[float]] = {}
    for i in ids:
        known = [one.levels for one in result.references[i]]
        low = np.array([one.grand_mean for one in known])
        way = sum(one.oracle_transfer for one in known) - low.sum()
        for name, curves in result.curves[i].items():  # of Random, the mean of all orders
            each.setdefault(name, []).append((curves.mean(axis=1) - low).sum() / way)
    return {name: np.array(found) for name, found in each.items()}


def board(names: Sequence[str], ids: Sequence[str], budget: int) -> list[str]:
    """Pooled table of matrices that all these selectors can run on."""
    result = compare(names, ids, budget)
    summary, share = result.summary, shares(result, ids)
    lines = [
        f"| selector | k90 | k95 | k99 | closed at {budget} | closed, curve | {FIRST} ahead by |",
        "|---|---|---|---|---|---|---|",
    ]
    for name, s in summary.pooled.items():
        cells = [name, *(trainings(k, budget) for k in (s.k90, s.k95, s.k99))]
        cells += [closed(s.closed_at_K), closed(s.closed_under_curve)]
        lead, margin = share[FIRST] - share[name], 0.0
        if len(ids) > 1:
            margin = student(len(ids) - 1) * lead.std(ddof=1) / np.sqrt(len(ids))
        cells.append("" if name == FIRST else f"{lead.mean():+.3f} ± {margin:.3f}")
        lines.append(f"| {' | '.join(cells)} |")
    # the others' matrices tell of every context only where all were trained on
    several = [i for i in ids if (m := load_by_id(i)).n_seeds > 1 and m.sources is None]
    if several:
        there = {
            i: {
                f"{FIRST} there": result.curves[i][FIRST],
                "the other seeds": other_seeds(i, budget),
            }
            for i in several
        }
        known = {i: result.references[i] for i in several}
        for name, s in summarise(there, known, {}).pooled.items():
            values = " | ".join(trainings(k, budget) for k in (s.k90, s.k95, s.k99))
            lines.append(f"| *{name}* ({len(several)} CMDPs) | {values} | | | |")
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--budget", type=int, default=15)
    args = parser.parse_args()
    sets = {
        "one axis": list(published()),
        "several axes": [i for i in shipped_matrices() if load_by_id(i).space.d > 1],
    }
    for axes, ids in sets.items():
        able = default_selectors(ids)
        table = board([n for n in SELECTORS if n in able], ids, args.budget)
        print(f"{len(ids)} CMDPs with {axes}, K = {args.budget}\n", *table, "", sep="\n")


if __name__ == "__main__":
    main()
