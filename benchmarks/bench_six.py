"""Wall time of a full `mbtl bench`: six selectors, one 100 x 100 matrix, 3 matrix seeds, K = 15.

The command runs as a user runs it, start-up included, on a noisy synthetic matrix in a temporary
`.npz`. The peer, in the same run: the picks of one selector, `mbtl`, with the paper's fit
(scikit-learn, 15 random restarts) in place of its own.

example: python benchmarks/bench_six.py
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from functools import partial
from pathlib import Path
from typing import Any

import measure
import numpy as np
from measure import digits, note
from sklearn_gp import fit_sklearn

from mbtl.selectors import MBTL
from mbtl.zoo.benchmark import compare, linear_gap_world

SELECTORS = ("random", "greedy", "equidistant", "worst-first", "mbtl", "mbtl-ei")
CONTEXTS, MATRIX_SEEDS, BUDGET, SEEDS = 100, 3, 15, 3
GOAL_SECONDS = 10.0


def write_matrix(path: Path) -> None:
    """Waves in the training performance, the linear gap, and noise, as a user's file."""
    level = 0.75 + 0.2 * np.sin(3.0 * np.pi * np.arange(CONTEXTS) / CONTEXTS)
    world = linear_gap_world(CONTEXTS, level=level, noise=0.02, n_seeds=MATRIX_SEEDS)
    everyone = np.arange(CONTEXTS)
    returns = np.stack([world.returns(seed, everyone) for seed in range(MATRIX_SEEDS)])
    np.savez(path, returns=returns)


def command(*arguments: str) -> tuple[float, str]:
    """Seconds and standard output of the `mbtl` beside this interpreter."""
    program = str(Path(sys.executable).with_name("mbtl"))
    done: list[subprocess.CompletedProcess[str]] = []
    cost = measure.cost_of(
        lambda: done.append(
            subprocess.run([program, *arguments], stdout=subprocess.PIPE, text=True, check=True)
        )
    )
    return cost.wall, done[0].stdout


def main() -> None:
    """Measure and print."""
    parser = measure.parser(__doc__)
    parser.add_argument("--repeats", type=int, default=3, help="runs of the command; the median")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        matrix = Path(folder) / "matrix.npz"
        write_matrix(matrix)
        options = ["--matrix", str(matrix), "--selectors", ",".join(SELECTORS)]
        options += ["--budget", str(BUDGET), "--seeds", str(SEEDS), "--json"]
        runs = []
        for repeat in range(args.repeats):
            note(f"mbtl bench, run {repeat + 1} of {args.repeats} ...")
            runs.append(command("bench", *options))
        start_up = min(command("--version")[0] for _ in range(args.repeats))
        note("the same picks with scikit-learn's fit ...")
        paper = MBTL(fitter=partial(fit_sklearn, restarts=15))
        peer = sum(run.select_seconds for run in compare([paper], [matrix], BUDGET, SEEDS).results)
    wall, output = sorted(runs)[len(runs) // 2]
    selecting = dict.fromkeys(SELECTORS, 0.0)
    for result in json.loads(output)["results"]:
        selecting[result["selector"]] += result["select_seconds"]
    document: dict[str, Any] = {
        "selectors": SELECTORS,
        "contexts": CONTEXTS,
        "matrix_seeds": MATRIX_SEEDS,
        "budget": BUDGET,
        "seeds": SEEDS,
        "seconds": digits(wall),
        "start_up_seconds": digits(start_up),
        "select_seconds": {name: digits(seconds) for name, seconds in selecting.items()},
        "peer": {
            "name": "mbtl with scikit-learn's fit, 15 restarts",
            "select_seconds": digits(peer),
            "ratio": digits(peer / selecting["mbtl"], 3),
        },
        "goal_seconds": GOAL_SECONDS,
        "goal_met": wall <= GOAL_SECONDS,
        "machine": measure.machine("scikit-learn"),
    }
    each = ", ".join(f"{name} {seconds:.3f}" for name, seconds in selecting.items())
    lines = [
        f"mbtl bench, {len(SELECTORS)} selectors on {MATRIX_SEEDS} matrices of {CONTEXTS} x "
        f"{CONTEXTS}, K = {BUDGET}: {wall:.2f} s (median of {args.repeats}), "
        f"of which start-up {start_up:.2f} s; goal {GOAL_SECONDS:g} s",
        f"choosing, seconds in all: {each}",
        f"mbtl's picks with scikit-learn's fit, 15 restarts: {peer:.2f} s, "
        f"{peer / selecting['mbtl']:.0f} times as long",
    ]
    measure.show(document, lines, as_json=args.json)


if __name__ == "__main__":
    main()
