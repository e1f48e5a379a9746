"""Choose what `auto` has learned: once on all shipped families, and once without each of them.

    .venv/bin/python benchmarks/learn_prior.py [--budget 25] [--write]

First the prior of the transfer model, of the candidates in mbtl.models.priors, without any covering
picks; then, with it, of how many picks one covers. Every candidate picks on every shipped matrix of
one axis (of the first two seeds; of 100 contexts every second; coarser grids are left out). What
counts is the mean logarithm of the trainings to 90, 95 and 99 % of the way to Oracle Transfer,
K + 1 where a level is not reached. For each family the candidate that is best on the *other*
families is kept, each family counting once; `mbtl bench` uses it there. Judges of the prior are
CartPole and Pendulum alone: elsewhere rows are luck more than contexts. `--write` puts the result
into src/mbtl/models/priors.py.

The likelihood was tried first, and chose worse: it rewards calibrated rows, not good picks.
"""

from __future__ import annotations

import measure  # first: threads

import argparse  # isort: skip
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from mbtl.arrays import Array
from mbtl.benchmark.catalogue import open_matrices
from mbtl.benchmark.replay import replay
from mbtl.benchmark.shipped import family_of, load_by_id
from mbtl.benchmark.summary import trainings_to
from mbtl.models.priors import CANDIDATES
from mbtl.objective import value_curve
from mbtl.selectors import SelectionProblem
from mbtl.selectors.auto import Auto

JUDGES_OF_PRIOR = ("cartpole", "pendulum")
COVERING = (0, 2, 3, 4, 6)
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


def trainings(selector: Auto, problem: SelectionProblem, rows: Array) -> Array:
    """(levels,) logarithms."""
    history = replay(selector, problem, lambda source: rows[source]).history
    curve = value_curve(history.rows, problem.weights)
    low, high = rows.mean(axis=0) @ problem.weights, rows.max(axis=0) @ problem.weights
    reached = trainings_to(curve, low, high)
    return np.log([problem.budget + 1 if k is None else k for k in reached])


Stock = Mapping[str, Sequence[tuple[SelectionProblem, Array]]]


def table(stock: Stock, entrants: Mapping[str, Auto]) -> dict[str, dict[str, Array]]:
    """By label and family the mean logarithms (levels,); printed as they come."""
    found: dict[str, dict[str, Array]] = {}
    print(f"{'':22s}" + "".join(f"{f:>24s}" for f in stock))
    for label, selector in entrants.items():
        begin = measure.now()
        found[label] = {
            f: np.mean([trainings(selector, *one) for one in stock[f]], axis=0) for f in stock
        }
        cells = (" ".join(f"{v:6.2f}" for v in np.exp(found[label][f])) for f in stock)
        text = "".join(f"{c:>24s}" for c in cells)
        print(f"{label:22s}{text}   {(measure.now() - begin).cpu:.0f} s", flush=True)
    return found


def best_on(found: Mapping[str, Mapping[str, Array]], judges: Sequence[str]) -> str:
    """Label of the least mean over families and levels."""
    return min(found, key=lambda label: float(np.mean([found[label][f] for f in judges])))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--budget", type=int, default=25)
    parser.add_argument("--write", action="store_true")
    args = parser.parse_args()
    ids = [
        i for i, matrix in open_matrices(["all"]).items()
        if not i.endswith("-final") and matrix.n > args.budget  # twins of the defaults
    ]  # fmt: skip
    families = sorted({family_of(i) for i in ids})
    stock = {
        f: [p for i in ids if family_of(i) == f for p in small(i, args.budget)] for f in families
    }
    by_prior = table(
        {f: stock[f] for f in JUDGES_OF_PRIOR},
        {k: Auto(prior=prior, cover=0) for k, prior in CANDIDATES.items()},
    )
    by_cover: dict[str, dict[str, dict[str, Array]]] = {}
    lines = []
    for left_out in [None, *families]:
        judges = [f for f in families if f != left_out]
        label = best_on(by_prior, [f for f in JUDGES_OF_PRIOR if f != left_out])
        if label not in by_cover:
            print(f"covering picks, prior {label!r}")
            options = {str(n): Auto(prior=CANDIDATES[label], cover=n) for n in COVERING}
            by_cover[label] = table(stock, options)
        every = best_on(by_cover[label], judges)
        print(f"without {left_out}: {label!r}, {every}")
        lines.append(f'    "{left_out or "all"}": ("{label}", {every}),')
    if args.write:
        marks = ("# begin: benchmarks/learn_prior.py --write\n", "# end\n")
        head, rest = FILE.read_text(encoding="utf-8").split(marks[0])
        tail = rest.split(marks[1])[1]
        rows = "\n".join(lines)
        body = f"CHOSEN: Mapping[str, tuple[str, int]] = {{\n{rows}\n}}\n"
        FILE.write_text(f"{head}{marks[0]}{body}{marks[1]}{tail}", encoding="utf-8")


if __name__ == "__main__":
    main()
