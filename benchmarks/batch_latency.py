"""Processor seconds of `ask(n)` with `auto`, in one batch, beside the same number of single picks.

    .venv/bin/python benchmarks/batch_latency.py [--contexts 1000] [--rows 10] [--picks 100]

Single picks are told nothing in between either: each is proposed by a model made anew, as a process
that joins a study does.
"""

from __future__ import annotations

import measure  # first: threads

import argparse  # isort: skip

import numpy as np

import mbtl
from mbtl.selectors import auto_beliefs
from mbtl.zoo.benchmark import linear_gap_world


def study_of(n: int, rows: int, picks: int) -> mbtl.Study:
    """So many rows told, on contexts in a random order."""
    world = linear_gap_world(n, level=0.75, slope=0.5 / (n - 1), noise=0.02, n_seeds=1)
    space = mbtl.ContextSpace.grid({mbtl.Linear("x", 0.0, 1.0): n})
    study = mbtl.create_study(space, budget=rows + picks, objective=mbtl.Objective((0.0, 1.0)))
    for source in np.random.default_rng(1).permutation(n)[:rows]:
        study.tell(int(source), world.rows(0, [int(source)])[0])
    return study


def main() -> None:
    """One batch, and the same picks alone."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--contexts", type=int, default=1000)
    parser.add_argument("--rows", type=int, default=10)
    parser.add_argument("--picks", type=int, default=100)
    args = parser.parse_args()
    spent, found = {}, {}
    for kind in ("batch", "alone"):
        study = study_of(args.contexts, args.rows, args.picks)
        begin = measure.now()
        if kind == "batch":
            picks = study.ask(args.picks)
        else:
            picks = []
            for _ in range(args.picks):
                auto_beliefs.forget()
                picks.append(study.ask())
        spent[kind], found[kind] = (measure.now() - begin).cpu, [pick.source for pick in picks]
    print(f"{args.picks} picks at N = {args.contexts:,} after {args.rows} rows, processor seconds:")
    print(f"  in one batch {spent['batch']:.2f}, each alone {spent['alone']:.2f}, ratio", end=" ")
    print(f"{spent['alone'] / spent['batch']:.1f}; same picks: {found['batch'] == found['alone']}")


if __name__ == "__main__":
    main()
