"""Walkers and cheetahs: the mean return over all contexts that K trainings reach.

    python evidence/locomotion_at_k.py [--budget 5 15]

Of the shipped matrices, with all their seeds, on episodes that chose nothing. Random is its exact
expectation. Independent is the mean over the contexts that were trained on, each with its own
policy. One policy for all contexts is of `mbtl matrix multitask`, with its units of transfer data.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from mbtl.report import REFERENCE_NAMES as NAMES
from mbtl.zoo.benchmark import compare, load_matrix
from mbtl.zoo.benchmark.multitask import load_multitask
from mbtl.zoo.benchmark.transfers import load_transfers

SHIPPED = (
    "walker-gravity", "walker-friction", "walker-scale",
    "cheetah-gravity", "cheetah-friction", "cheetah-stiffness",
)  # fmt: skip
SELECTORS = {
    "random": "Random", "greedy": "Greedy", "mbtl": "MBTL", "specialists": "specialists",
    "oracle": "Sequential Oracle",
}  # fmt: skip

UNITS = (1.0, 4.0, 15.0)


def returns(id: str, budgets: Sequence[int]) -> dict[str, float]:
    """By the head of a row; mean over seeds."""
    matrix = load_matrix(id)
    known = {k: compare(list(SELECTORS), [matrix], k).summary.matrices[id] for k in budgets}
    some = known[budgets[0]]
    found = {NAMES.get(name, name): value for name, value in some.references.items()}
    found["Independent"] = some.independent
    for k, summary in known.items():
        for name, head in SELECTORS.items():
            value = summary.selectors[name].V_K.value
            assert value is not None
            found[f"{head}, K = {k}"] = value
    found["Oracle Transfer"] = some.oracle_transfer
    for one in load_multitask(id).values():
        found["one policy for all"] = float(matrix.bounds.normalise(one.returns).mean())
    for units, rows in load_transfers(id).generalists.items():
        if units in UNITS:
            found[f"as in `auto`, {units:g} units"] = float(
                matrix.bounds.normalise(rows[:, 1]).mean()
            )
    return {head: float(matrix.bounds.denormalise(value)) for head, value in found.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--budget", nargs="+", type=int, default=[5, 15], help="K")
    args = parser.parse_args()
    columns = {id: returns(id, args.budget) for id in SHIPPED}
    print(f"| mean return | {' | '.join(columns)} |\n|{'---|' * (1 + len(columns))}")
    for head in dict.fromkeys(head for column in columns.values() for head in column):
        cells = [f"{column[head]:.0f}" if head in column else "" for column in columns.values()]
        print(f"| {head} | {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
