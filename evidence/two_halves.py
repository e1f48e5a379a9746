"""What it changes that numbers are measured on other episodes than those that chose.

    .venv/bin/python evidence/two_halves.py [--budget 15] [--write]

For every shipped matrix that holds two halves of its episodes: V as it would be said of the half
that chose (as older versions of mbtl did with all episodes) and V on the other half, of the same
picks and routes; means over seeds. The difference is what luck of episodes pretends.
"""

from __future__ import annotations

import measure  # noqa: F401  first: threads

import argparse  # isort: skip
from dataclasses import replace

import numpy as np
import pages

from mbtl.zoo.benchmark import TransferMatrix, compare, levels, load_matrix, shipped_matrices

SELECTORS = ("greedy", "mbtl", "specialists", "oracle")


def measured(matrix: TransferMatrix, budget: int) -> dict[str, float]:
    """V by name, mean over seeds."""
    every = [levels(matrix, seed) for seed in range(matrix.n_seeds)]
    names = [name for name in SELECTORS if name != "greedy" or len(matrix.axes) == 1]
    runs = compare(names, [matrix], budget, seeds=1).results
    found = {
        name: float(np.mean([run.performance[-1] for run in runs if run.selector == name]))
        for name in names
    }
    found["Independent"] = float(np.mean([one.independent for one in every]))
    found["Oracle Transfer"] = float(np.mean([one.oracle_transfer for one in every]))
    return found


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--budget", type=int, default=15)
    parser.add_argument("--write", action="store_true", help="docs/appendix/two-halves.md")
    args = parser.parse_args()
    budget = args.budget
    columns = ("Independent", *SELECTORS, "Oracle Transfer")
    lines = [
        f"| K = {budget}: on the half that chose / on the other | {' | '.join(columns)} |",
        "|---" * (len(columns) + 1) + "|",
    ]
    for name in shipped_matrices():
        matrix = load_matrix(name)
        if matrix.fresh_returns is None:
            continue
        same = replace(matrix, fresh_returns=None, episodes=None, references={})
        told = measured(same, budget)
        true = measured(matrix, budget)
        cells = [f"{told[c]:.4f} / {true[c]:.4f}" if c in told else "-" for c in columns]
        lines.append(f"| {name} | {' | '.join(cells)} |")
        print(lines[-1], flush=True)
    if args.write:
        title = "V on the episodes that chose, and on the others"
        pages.write_appendix("two-halves", title, "honest-numbers.md", lines)


if __name__ == "__main__":
    main()
