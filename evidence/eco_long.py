"""What eco-driving gains from the paper's 5,000 episodes instead of 160 by the same recipe.

    .venv/bin/python evidence/eco_long.py [--write]

Every tenth context of an axis was trained on for 5,000 episodes (docs/data/eco-long, one seed, 100
episodes an evaluation); the same sources of the shipped matrices had 160 (three seeds, 20).
Scores less those of unguided traffic in the same episodes, m/s, of a source in its own context, of
any source in any context, and where the best of the five in one half of the episodes serves, in the
other half. Then the same along the long trainings of eco-inflow: latest weights, mean speeds in m/s
in other episodes, the same at all lengths.
"""

from __future__ import annotations

import measure  # noqa: F401  first: threads

import argparse  # isort: skip
from collections.abc import Sequence

import numpy as np
import pages
from numpy.typing import NDArray

from mbtl.zoo.benchmark import load_curves, load_matrix

LONG = pages.DOCS / "data" / "eco-long"
CMDPS = "eco-green", "eco-inflow", "eco-penetration"
Halves = Sequence[NDArray[np.float64]]


def gains(halves: Halves, alone: Halves, sources: NDArray[np.intp]) -> list[float]:
    """Of own, any and served, from (M, N) entries and (N,) references of each half."""
    each = [rows - base for rows, base in zip(halves, alone, strict=True)]
    both = (each[0] + each[1]) / 2.0
    serving = halves[0].argmax(axis=0)
    served = each[1][serving, np.arange(len(serving))]
    return [both[np.arange(len(sources)), sources].mean(), both.mean(), served.mean()]


def at_the_end() -> list[str]:
    """A table: both budgets."""
    lines = ["| | episodes | own context | any context | the five serve |", "|---" * 5 + "|"]
    for id in CMDPS:
        long, usual = load_matrix(id, "long", folder=LONG), load_matrix(id)
        assert long.sources is not None
        for matrix, count, rows in ((usual, 160, long.sources), (long, 5000, slice(None))):
            assert matrix.fresh_returns is not None
            seeds = [
                gains(
                    (matrix.returns[s][rows], matrix.fresh_returns[s][rows]),
                    matrix.references["unguided"][s],
                    long.sources,
                )
                for s in range(matrix.n_seeds)
            ]
            cells = [", ".join(f"{x:+.2f}" for x in column) for column in zip(*seeds, strict=True)]
            lines.append(f"| {id} | {count:,} | {' | '.join(cells)} |")
    return lines


def on_the_way() -> list[str]:
    """A table: lengths of the long trainings."""
    curves = load_curves("eco-inflow", "long", folder=LONG / "curves")
    assert curves.sources is not None
    nobody = np.zeros(curves.space.n)
    last = curves.returns["last"][0]
    each = np.array([gains(halves, (nobody, nobody), curves.sources) for halves in last])
    heads = " | ".join(f"{length:,}" for length in curves.lengths)
    lines = [f"| after episodes | {heads} |", "|---" * (1 + len(curves.lengths)) + "|"]
    for name, column in zip(("own context", "any context", "the five serve"), each.T, strict=True):
        lines.append(f"| {name} | {' | '.join(f'{x:.2f}' for x in column)} |")
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--write", action="store_true", help="into docs/eco-driving.md")
    args = parser.parse_args()
    for name, lines in (("long trainings", at_the_end()), ("on the way", on_the_way())):
        print("\n".join([*lines, ""]))
        if args.write:
            pages.fill("eco-driving.md", name, lines)


if __name__ == "__main__":
    main()
