"""Choose the prior of `specialists`: once on all shipped families, and once without each of them.

    .venv/bin/python evidence/learn_prior.py [--budget 25]

Every candidate picks on the shipped matrices of one
axis (of 100 contexts every second; coarser grids are left out), on all cores. What counts is the
mean logarithm of the trainings to 90, 95 and 99 % of the way to Oracle Transfer, K + 1 where a
level is not reached. For each family the candidate that is best on the *other* families is kept,
each family counting once; `mbtl bench` uses it there. Judges are CartPole and Pendulum alone:
elsewhere rows are luck more than contexts. How much worse the runner-up is, with one standard
error, is printed beside each choice. The lines with colons say what
`PRIORS` of src/mbtl/models/priors.py must hold.

The likelihood was tried first, and chose worse: it rewards calibrated rows, not good picks.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor as Pool
from dataclasses import replace
from multiprocessing import get_context

import numpy as np

from mbtl.arrays import Array
from mbtl.models.priors import RATIO
from mbtl.models.transfer_kernel import TransferPrior
from mbtl.objective import value_curve
from mbtl.selectors import SelectionProblem
from mbtl.selectors.specialists import Specialists
from mbtl.zoo.benchmark.comparison import trainings_to
from mbtl.zoo.benchmark.replay import replay
from mbtl.zoo.benchmark.shipped import family_of, load_by_id, open_matrices

JUDGES = ("cartpole", "pendulum")
CANDIDATES: Mapping[str, TransferPrior] = {
    "ratio": RATIO,
    "ratio, short": replace(RATIO, log_gap_length=0.15),
    "ratio, long": replace(RATIO, log_gap_length=0.6),
    "ratio, changing": replace(RATIO, along_length=0.5),
    "ratio, rigid": replace(RATIO, along_length=4.0),
    "ratio, hard targets": replace(RATIO, target=0.4),
    "ratio, good sources": replace(RATIO, source=0.4),
    "ratio, luck": replace(RATIO, luck=0.2, row_luck=0.1),
    "difference": replace(RATIO, gap=1.0, gap_length=0.3, log_gap=0.05),
    "both": replace(RATIO, gap=0.5, gap_length=0.3),
    "targets": replace(RATIO, log_gap=0.05, target=1.0, source=0.3, interaction=0.3, luck=0.1),
}
"""How far a policy reaches is a matter of the ratio of contexts, of their difference, or both; or
targets are hard or easy whatever the source."""


def small(matrix_id: str, budget: int) -> Iterator[tuple[SelectionProblem, Array]]:
    """Problem and performance, seed by seed, on at most 50 contexts of a line."""
    matrix = load_by_id(matrix_id)
    problem = matrix.problem(budget)
    skip = 1 if problem.n <= 50 else 2
    kept = np.arange(skip - 1, problem.n, skip)
    weights = problem.weights[kept] / problem.weights[kept].sum()
    part = SelectionProblem(
        problem.unit[kept], problem.steps[kept] / skip, weights, budget, problem.theta * skip
    )
    for seed in range(matrix.n_seeds):
        yield part, matrix.rows(seed, kept)[:, kept]


def trainings(selector: Specialists, problem: SelectionProblem, rows: Array) -> Array:
    """(levels,) their logarithms."""
    history = replay(selector, problem, lambda source: rows[source]).history
    curve = value_curve(history.rows, problem.weights)
    low, high = rows.mean(axis=0) @ problem.weights, rows.max(axis=0) @ problem.weights
    reached = trainings_to(curve, low, high)
    return np.log([problem.budget + 1 if k is None else k for k in reached])


Stock = Mapping[str, Sequence[tuple[SelectionProblem, Array]]]
Found = Mapping[str, Mapping[str, Array]]


def table(pool: Pool, stock: Stock, entrants: Mapping[str, Specialists]) -> Found:
    """By label and family the logarithms (seeds of matrices, levels); means printed at once."""
    found: dict[str, dict[str, Array]] = {}
    print(f"{'':22s}" + "".join(f"{f:>24s}" for f in stock))
    for label, selector in entrants.items():
        unseen = {f: selector.without(f) for f in stock}
        runs = {f: [pool.submit(trainings, unseen[f], *one) for one in stock[f]] for f in stock}
        found[label] = {f: np.array([run.result() for run in runs[f]]) for f in stock}
        means = (np.exp(found[label][f].mean(axis=0)) for f in stock)
        cells = (" ".join(f"{v:6.2f}" for v in mean) for mean in means)
        print(f"{label:22s}" + "".join(f"{c:>24s}" for c in cells), flush=True)
    return found


def cost(found: Found, label: str, judges: Sequence[str]) -> float:
    """Mean logarithm over families and levels, each family counting once."""
    return float(np.mean([found[label][f].mean() for f in judges]))


def against(found: Found, label: str, best: str, judges: Sequence[str]) -> str:
    """How many more trainings than the best one, with one standard error."""
    more = [(found[label][f] - found[best][f]).mean(axis=1) for f in judges]
    error = np.sqrt(sum(d.var(ddof=1) / len(d) for d in more)) / len(judges)
    percent = 100 * np.expm1(np.mean([d.mean() for d in more]))
    return f"{label!r} needs {percent:+.1f} % (± {100 * error:.1f})"


def choices(found: Found, families: Sequence[str]) -> list[str]:
    """The choice for each family left out, what they rest on printed."""
    lines = []
    for left_out in [None, *families]:
        judges = [f for f in JUDGES if f != left_out]
        best, second = sorted(found, key=lambda label: cost(found, label, judges))[:2]
        print(f"without {left_out}: {best!r}; {against(found, second, best, judges)}", flush=True)
        lines.append(f'    "{left_out or "all"}": "{best}",')
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--budget", type=int, default=25)
    args = parser.parse_args()
    ids = [
        i for i, matrix in open_matrices(["all"]).items()
        if not i.endswith("-final") and matrix.n > args.budget  # twins of the defaults
    ]  # fmt: skip
    families = sorted({family_of(i) for i in ids})
    stock = {
        f: [p for i in ids if family_of(i) == f for p in small(i, args.budget)] for f in families
    }
    with Pool(mp_context=get_context("spawn")) as pool:
        judging = {f: stock[f] for f in JUDGES}
        priors = {label: Specialists(prior=prior) for label, prior in CANDIDATES.items()}
        print("\n".join(choices(table(pool, judging, priors), families)))


if __name__ == "__main__":
    main()
