"""Choose the prior of `auto`: once on all shipped families, and once without each of them.

    .venv/bin/python benchmarks/learn_prior.py [--budget 15] [--write]

Every candidate of mbtl.models.priors picks on every shipped matrix (of the first two seeds; of 100
contexts every second). What counts is the mean logarithm of the trainings to 90, 95 and 99 % of the
way to Oracle Transfer, K + 1 where a level is not reached. For each family the candidate that is
best on the *other* families is kept, each family counting once; `mbtl bench` uses it there.
`--write` puts the result into src/mbtl/models/priors.py.

The likelihood was tried first, and chose worse: it rewards calibrated rows, not good picks.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from mbtl.arrays import Array
from mbtl.benchmark.catalogue import open_matrices
from mbtl.benchmark.replay import replay
from mbtl.benchmark.shipped import family_of, load_by_id
from mbtl.benchmark.summary import trainings_to
from mbtl.models.priors import CANDIDATES
from mbtl.models.transfer_gp import TransferPrior
from mbtl.objective import value_curve
from mbtl.selectors import SelectionProblem
from mbtl.selectors.auto import Auto

FILE = Path(__file__).parents[1] / "src/mbtl/models/priors.py"


def halved(matrix_id: str, budget: int) -> tuple[SelectionProblem, list[Array]]:
    """Problem on at most 50 contexts of a line, and the performance of each seed on them."""
    matrix = load_by_id(matrix_id)
    problem = matrix.problem(budget)
    skip = 1 if problem.n <= 50 else 2
    kept = np.arange(skip - 1, problem.n, skip)
    weights = problem.weights[kept] / problem.weights[kept].sum()
    part = SelectionProblem(
        problem.unit[kept], problem.steps[kept] / skip, weights, budget, problem.theta * skip
    )
    return part, [matrix.rows(seed, kept)[:, kept] for seed in range(matrix.n_seeds)]


def small(matrix_id: str, budget: int) -> Iterator[tuple[SelectionProblem, Array]]:
    """Problem and performance of the first two seeds, on at most 50 contexts."""
    part, seeds = halved(matrix_id, budget)
    for rows in seeds[:2]:
        yield part, rows


def trainings(prior: TransferPrior, problem: SelectionProblem, rows: Array) -> Array:
    """(levels,) logarithms."""
    history = replay(Auto(prior=prior), problem, lambda source: rows[source]).history
    curve = value_curve(history.rows, problem.weights)
    low, high = rows.mean(axis=0) @ problem.weights, rows.max(axis=0) @ problem.weights
    reached = trainings_to(curve, low, high)
    return np.log([problem.budget + 1 if k is None else k for k in reached])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--budget", type=int, default=15)
    parser.add_argument("--write", action="store_true")
    args = parser.parse_args()
    ids = [i for i in open_matrices(["all"]) if not i.endswith("-final")]  # twins of the defaults
    families = sorted({family_of(i) for i in ids})
    stock = {
        f: [p for i in ids if family_of(i) == f for p in small(i, args.budget)] for f in families
    }
    table: dict[str, dict[str, Array]] = {}
    print(f"{'':22s}" + "".join(f"{f:>24s}" for f in families))
    for label, prior in CANDIDATES.items():
        begin = time.perf_counter()
        table[label] = {
            f: np.mean([trainings(prior, *one) for one in stock[f]], axis=0) for f in families
        }
        cells = (" ".join(f"{v:6.2f}" for v in np.exp(table[label][f])) for f in families)
        text = "".join(f"{c:>24s}" for c in cells)
        print(f"{label:22s}{text}   {time.perf_counter() - begin:.0f} s", flush=True)
    lines = []
    for left_out in [None, *families]:
        judges = [f for f in families if f != left_out]
        if not judges:
            continue
        loss = {label: np.mean([by[f].mean() for f in judges]) for label, by in table.items()}
        best = min(loss, key=loss.__getitem__)
        print(f"without {left_out}: {best!r}")
        name = "all" if left_out is None else left_out
        lines.append(f'    "{name}": "{best}",')
    if args.write:
        marks = ("# begin: benchmarks/learn_prior.py --write\n", "# end\n")
        head, rest = FILE.read_text(encoding="utf-8").split(marks[0])
        tail = rest.split(marks[1])[1]
        rows = "\n".join(lines)
        body = f"CHOSEN: Mapping[str, str] = {{\n{rows}\n}}\n"
        FILE.write_text(f"{head}{marks[0]}{body}{marks[1]}{tail}", encoding="utf-8")


if __name__ == "__main__":
    main()
