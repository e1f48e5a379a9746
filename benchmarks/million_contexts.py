"""One `mbtl` pick among a million contexts on one axis: time and memory, on one thread.

45 noisy rows of a linear-gap world are generated one by one (no matrix exists), then `propose` runs
once.

example: python benchmarks/million_contexts.py
"""

from __future__ import annotations

from typing import Any

import measure
import numpy as np
from measure import cost_of, digits, note, peak_gib

from mbtl.arrays import uniform_weights
from mbtl.history import History
from mbtl.selectors import MBTL
from mbtl.selectors.base import SelectionProblem, default_theta

GOAL_SECONDS, GOAL_GIB = 10.0, 2.0


def make_problem(n: int) -> SelectionProblem:
    """N contexts in a row."""
    steps = np.arange(n, dtype=np.float64)[:, None]
    unit = steps / max(n - 1, 1)
    return SelectionProblem(unit, steps, uniform_weights(n), 100, default_theta(n))


def make_history(problem: SelectionProblem, n_rows: int) -> History:
    """Rows of randomly placed policies: (n_rows, N) float64 is all that is held."""
    n = problem.n
    sources = np.random.default_rng(0).choice(n, n_rows, replace=False)
    rows = np.empty((n_rows, n))
    for row, source in zip(rows, sources.tolist(), strict=True):
        np.abs(problem.line - source, out=row)
        row *= -problem.theta
        row += 0.75 + 0.2 * np.sin(3.0 * np.pi * source / n)
        row += 0.02 * np.random.default_rng([1, source]).standard_normal(n)
    return History(n, tuple(sources.tolist()), rows)


def main() -> None:
    """Measure and print."""
    parser = measure.parser(__doc__)
    parser.add_argument("--contexts", type=int, default=1_000_000, help="N")
    parser.add_argument("--rows", type=int, default=45, help="policies trained before the pick")
    args = parser.parse_args()
    note("generating rows ...")
    problem = make_problem(args.contexts)
    history = make_history(problem, args.rows)
    before = peak_gib()
    note("proposing ...")
    pick = cost_of(lambda: MBTL().propose(problem, history, np.random.default_rng(0)))
    peak = peak_gib()
    document: dict[str, Any] = {
        "contexts": args.contexts,
        "rows": args.rows,
        "propose_seconds": pick.to_json(),
        "peak_gib": {"before": digits(before, 3), "after": digits(peak, 3)},
        "goal": {"seconds": GOAL_SECONDS, "gib": GOAL_GIB},
        "goal_met": pick.wall <= GOAL_SECONDS and peak <= GOAL_GIB,
        "machine": measure.machine(),
    }
    lines = [
        f"one pick among {args.contexts} contexts after {args.rows} rows: "
        f"{pick.wall:.2f} s by the clock, {pick.cpu:.2f} s of processor time",
        f"peak memory {peak:.2f} GiB, of which {before:.2f} GiB before the pick (rows included)",
        f"goal {GOAL_SECONDS:g} s and {GOAL_GIB:g} GiB: "
        + ("met" if document["goal_met"] else "NOT met"),
    ]
    measure.show(document, lines, as_json=args.json)


if __name__ == "__main__":
    main()
