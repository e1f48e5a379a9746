"""One pick of `specialists` among a million contexts, on one axis and three: time, memory, error.

It looks at a part of the contexts only: candidates that it searches, judged on some targets.
Three figures say what that costs, in a world whose performance is known in closed form:

- the standard error of the expected gain of the pick, from the scatter of its gain over the targets
  it was judged on: s / sqrt(T) (1 - T / N)^(1/2), as if they were drawn at random (on one axis they
  are evenly spaced, which is better than that);
- the gain of the pick on a larger sample of targets, beside the best of a sample of candidates
  there, both under the same posterior;
- the true gain of the pick, beside the best and a random one of 1000 candidates on 2000 targets.
  What the model does not know costs here as well.

The peer is `specialists` on 10,000 contexts with the same number of rows.

example: python benchmarks/million_specialists.py --rows 30
"""

from __future__ import annotations

import measure  # first: threads

from typing import Any  # isort: skip

import numpy as np
from measure import Cost, digits, note, now, peak_gib

from mbtl.arrays import Array, uniform_weights
from mbtl.history import History
from mbtl.selectors.base import SelectionProblem, default_theta
from mbtl.selectors.specialists import Specialists

REACH, LUCK, NOISE = 0.12, 0.03, 0.01
TRUE_CANDIDATES, TRUE_TARGETS = 1000, 2000


def make_problem(n: int, d: int, budget: int) -> SelectionProblem:
    """N contexts: a line, or the nodes of a grid of equal sides (N is rounded to a d-th power)."""
    side = round(n ** (1.0 / d))
    steps = np.indices((side,) * d).reshape(d, -1).T.astype(np.float64)
    n = len(steps)
    return SelectionProblem(
        steps / max(side - 1, 1), steps, uniform_weights(n), min(budget, n), default_theta(n)
    )


def performance(source: Array, targets: Array) -> Array:
    """(n,) expected performance of a policy of `source` (d,) on `targets` (n, d), luck apart.

    A plateau with a cliff: three times as far below the source as above it.
    """
    gap = targets - source
    far = np.where(gap > 0.0, gap, gap / -3.0)
    loss = np.square(far).mean(axis=1) / REACH**2
    level = 0.8 + 0.1 * np.sin(9.0 * source.mean())
    return np.asarray(level / (1.0 + np.square(loss)) - 0.2 * targets[:, 0])


def make_history(problem: SelectionProblem, n_rows: int, dtype: str) -> History:
    """Rows of randomly placed policies, (n_rows, N) of `dtype`: all that is held."""
    n = problem.n
    sources = np.random.default_rng(0).choice(n, n_rows, replace=False)
    rows = np.empty((n_rows, n), dtype=dtype)
    for row, source in zip(rows, sources.tolist(), strict=True):
        rng = np.random.default_rng([1, source])
        expected = performance(problem.unit[source], problem.unit)
        row[:] = expected + LUCK * rng.standard_normal()
        row += NOISE * rng.standard_normal(n, dtype=np.float32)
    return History(n, tuple(sources.tolist()), rows)


def true_gains(problem: SelectionProblem, history: History, pick: int) -> tuple[float, Array]:
    """Expected true gain of the pick, and (1000,) of other candidates, on the same targets."""
    rng = np.random.default_rng(3)
    targets = rng.choice(problem.n, min(TRUE_TARGETS, problem.n), replace=False)
    others = rng.choice(problem.n, min(TRUE_CANDIDATES, problem.n), replace=False)
    best, unit = history.best[targets], problem.unit
    gains = np.array(
        [
            np.maximum(performance(unit[source], unit[targets]) - best, 0.0).mean()
            for source in (pick, *others)
        ]
    )
    return float(gains[0]), gains[1:]


def case(n: int, d: int, args: Any) -> dict[str, Any]:
    """Everything about one pick."""
    note(f"{n} contexts, {d} axes: rows ...")
    problem = make_problem(n, d, args.rows + 1)
    history = make_history(problem, args.rows, args.dtype)
    chooser, before = Specialists(), peak_gib()
    note("  picks ...")
    costs = []
    for _ in range(2):  # the second finds the best performances in the history, as a study does not
        begin = now()
        proposal = chooser.propose(problem, history, np.random.default_rng(0))
        costs.append(now() - begin)
    peak, first = peak_gib(), costs[0]
    note("  errors ...")
    beliefs, chosen = chooser._beliefs(problem, history), np.array([proposal.source])
    outlook = beliefs.row_gain(beliefs.targets)
    rng = np.random.default_rng(4)
    wide = rng.choice(problem.n, min(args.sample_targets, problem.n), replace=False)
    some = rng.choice(problem.n, min(args.sample_candidates, problem.n), replace=False)
    begin = now()
    larger = beliefs.row_gain(wide)
    gains = larger.by_target(some)
    spent = now() - begin
    again = larger.by_target(chosen)[0]
    true_pick, true = true_gains(problem, history, proposal.source)
    return {
        "contexts": problem.n,
        "axes": d,
        "rows": args.rows,
        "dtype": args.dtype,
        "pick_seconds": first.to_json(),
        "pick_again_seconds": costs[1].to_json(),
        "peak_gib": {"before": digits(before, 3), "after": digits(peak, 3)},
        "gain": {
            "expected": digits(float(outlook.expected(chosen)[0])),
            "standard_error": digits(outlook.standard_error(proposal.source, problem.n), 2),
            "targets": len(outlook.targets),
            "on_larger_sample": digits(float(again.mean())),
            "best_of_sample": digits(float(gains.mean(axis=1).max())),
            "standard_error_there": digits(larger.standard_error(proposal.source, problem.n), 2),
            "targets_for_5_percent": int(np.ceil((again.std() / (0.05 * again.mean())) ** 2)),
        },
        "sample": {"candidates": len(some), "targets": len(wide)},
        "milliseconds_per_1000_pairs": digits(1e6 * (spent / gains.size).cpu, 3),
        "true_gain": {
            "pick": digits(true_pick),
            "best": digits(float(true.max())),
            "random": digits(float(true.mean())),
            "better_than_pick": digits(float((true > true_pick).mean()), 3),
        },
    }


def lines_of(found: dict[str, Any]) -> list[str]:
    """For people."""
    gain, true, pick = found["gain"], found["true_gain"], Cost(**found["pick_seconds"])
    sample = found["sample"]
    return [
        f"{found['contexts']:,} contexts on {found['axes']} axes after {found['rows']} rows of "
        f"{found['dtype']}: {pick.wall:.2f} s by the clock, {pick.cpu:.2f} s of processor time; "
        f"peak {found['peak_gib']['after']:.2f} GiB, {found['peak_gib']['before']:.2f} before",
        f"  expected gain {gain['expected']:.4g} +- {gain['standard_error']:.2g} on "
        f"{gain['targets']} targets; on {sample['targets']} others {gain['on_larger_sample']:.4g} "
        f"+- {gain['standard_error_there']:.2g}; +- 5 % needs {gain['targets_for_5_percent']}",
        f"  best gain of {sample['candidates']} candidates there {gain['best_of_sample']:.4g}",
        f"  judging costs {found['milliseconds_per_1000_pairs']:.3g} ms per 1000 pairs",
        f"  true gain {true['pick']:.4g}; best of {TRUE_CANDIDATES} {true['best']:.4g}, random "
        f"{true['random']:.4g}; {100 * true['better_than_pick']:.1f} % are better than the pick",
    ]


def main() -> None:
    """Measure and print."""
    parser = measure.parser(__doc__)
    parser.add_argument("--contexts", type=int, nargs="+", default=[10_000, 1_000_000], help="N")
    parser.add_argument("--axes", type=int, nargs="+", default=[1, 3])
    parser.add_argument("--rows", type=int, default=30, help="policies trained before the pick")
    parser.add_argument("--dtype", choices=("float32", "float64"), default="float64")
    parser.add_argument("--sample-candidates", type=int, default=300)
    parser.add_argument("--sample-targets", type=int, default=300)
    args = parser.parse_args()
    found = [case(n, d, args) for n in args.contexts for d in args.axes]
    document = {"cases": found, "machine": measure.machine()}
    lines = [line for one in found for line in lines_of(one)]
    measure.show(document, lines, as_json=args.json)


if __name__ == "__main__":
    main()
