"""The leaderboard of selectors on all shipped matrices.

    .venv/bin/python benchmarks/leaderboard.py [--budget 40] [--selectors a,b] [--write]

Nothing that was learned has seen what it is judged on: `auto` runs with the prior fitted without
the family of each matrix. Beside the selectors stands "told", which is none: it owns the whole
matrices of the *other seeds* of the same CMDP, smoothed over sources, and picks by their mean gain.
What separates it from the Sequential Oracle is luck of single trainings, which nobody can foresee.

`--write` puts the tables into docs/leaderboard.md.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter1d

from mbtl.benchmark import compare
from mbtl.benchmark.records import SelectorSummary, Summary
from mbtl.benchmark.shipped import load_by_id, shipped_matrices
from mbtl.benchmark.summary import SHARES
from mbtl.objective import k_star

SELECTORS = (
    "random", "greedy", "mbtl", "mbtl-release", "gp-mbtl", "m-mbtl", "sd-mbtl", "auto", "oracle",
)  # fmt: skip
FILE = Path(__file__).parents[1] / "docs/leaderboard.md"
SMOOTH = 2.0
"""Grid steps over which the rows of the other seeds are averaged."""


def told(matrix_id: str, budget: int) -> np.ndarray:
    """(levels,) mean logarithm of the trainings to each share, a level not reached as K + 1."""
    matrix = load_by_id(matrix_id)
    every = np.arange(matrix.n)
    rows = np.stack([matrix.rows(s, every) for s in range(matrix.n_seeds)])
    logs = []
    for s, truth in enumerate(rows):
        others = np.delete(rows, s, axis=0)
        best, curve, taken = np.full(matrix.n, -np.inf), [], []
        for _ in range(budget):
            base = best if taken else np.zeros(matrix.n)
            gain = (np.maximum(others - base, 0.0) if taken else others).mean(axis=(0, 2))
            gain = gaussian_filter1d(gain, SMOOTH, mode="nearest")
            gain[taken] = -np.inf
            taken.append(int(gain.argmax()))
            best = np.maximum(best, truth[taken[-1]])
            curve.append(best.mean())
        low, high = truth.mean(), truth.max(axis=0).mean()
        reached = [k_star(np.array(curve), low + share * (high - low)) for share in SHARES]
        logs.append([np.log(budget + 1 if k is None else k) for k in reached])
    return np.mean(logs, axis=0)


def row(name: str, s: SelectorSummary) -> str:
    def trainings(which: str) -> str:
        found = getattr(s, which)
        value = found.estimate.value
        text = "-" if value is None else f"{value:.1f}"
        return f"> {text}" if found.censored and value is not None else text

    def closed(which: str) -> str:
        found = getattr(s, which)
        if found.value is None:
            return "-"
        interval = "" if found.low is None else f" [{found.low:.2f}, {found.high:.2f}]"
        return f"{found.value:.2f}{interval}"

    cells = [name, *map(trainings, ("k90", "k95", "k99"))]
    cells += [closed("closed_at_K"), closed("closed_under_curve")]
    return f"| {' | '.join(cells)} |"


def table(title: str, summary: Summary, known: np.ndarray | None) -> list[str]:
    lines = [
        f"## {title}", "",
        f"| selector | k90 | k95 | k99 | closed at K = {summary.budget} | closed under the curve |",
        "|---|---|---|---|---|---|",
    ]  # fmt: skip
    lines += [row(name, s) for name, s in summary.pooled.items()]
    if known is not None:
        values = " | ".join(f"{v:.1f}" for v in np.exp(known))
        lines.append(f"| *told the other seeds* | {values} | | |")
    return [*lines, ""]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--budget", type=int, default=40)
    parser.add_argument("--selectors", default=",".join(SELECTORS))
    parser.add_argument("--write", action="store_true")
    args = parser.parse_args()
    chosen = args.selectors.split(",")
    families: dict[str, list[str]] = {}
    for matrix_id in shipped_matrices():
        families.setdefault(matrix_id.split("-")[0], []).append(matrix_id)
    every = [m for group in families.values() for m in group]
    lines = []
    for title, group in {"all": every, **families}.items():
        summary = compare(chosen, group, args.budget).summary
        several = [m for m in group if load_by_id(m).n_seeds > 1]
        known = np.mean([told(m, args.budget) for m in several], axis=0) if several else None
        label = f"{len(group)} matrices" if title == "all" else f"{title}: {len(group)} matrices"
        lines += table(label, summary, known)
        print("\n".join(lines[-len(chosen) - 6 :]), flush=True)
    if args.write:
        text = FILE.read_text(encoding="utf-8")
        head = text.split("<!-- tables -->\n")[0]
        FILE.write_text(f"{head}<!-- tables -->\n\n" + "\n".join(lines), encoding="utf-8")


if __name__ == "__main__":
    main()
