"""Fit the prior of `auto`: once to all shipped families, and once without each of them.

    .venv/bin/python benchmarks/learn_prior.py [--rows 4] [--sets 12] [--write]

For `--sets` random matrices of the other families, `--rows` random rows each (30 targets), the
marginal likelihood is maximised over the logarithms of the prior's numbers, with a weak pull
towards its defaults. `--write` puts the result into src/mbtl/models/priors.py.

What is reported on a family must use the prior fitted without it (`benchmarks/leaderboard.py`).
"""

from __future__ import annotations

import argparse
import time
from dataclasses import fields
from pathlib import Path

import numpy as np
from scipy.optimize import minimize

from mbtl.benchmark.shipped import load_by_id, shipped_matrices
from mbtl.models.transfer_gp import Places, TransferGP, TransferPrior, grid_pairs

TARGETS = 30
PULL = 0.01
"""Weight of the squared distance to the default logarithms, against nats per pair."""
FILE = Path(__file__).parents[1] / "src/mbtl/models/priors.py"

Data = tuple[Places, np.ndarray, np.ndarray]


def family(matrix_id: str) -> str:
    return matrix_id.split("-")[0]


def data(ids: list[str], sets: int, rows: int, rng: np.random.Generator) -> list[Data]:
    """Random rows of random matrices; no matrix twice as long as there are enough."""
    found = []
    pool = [(m, s) for m in map(load_by_id, ids) for s in range(m.n_seeds)]
    for k in rng.permutation(len(pool))[:sets]:
        matrix, seed = pool[int(k)]
        problem = matrix.problem(rows)
        sources = np.sort(rng.choice(problem.n, rows, replace=False))
        targets = np.sort(rng.choice(problem.n, min(TARGETS, problem.n), replace=False))
        y = matrix.rows(seed, sources)[:, targets].ravel()
        found.append((Places.of(problem.unit, problem.steps), grid_pairs(sources, targets), y))
    return found


def loss(logs: np.ndarray, sets: list[Data]) -> float:
    prior = TransferPrior.of_logs(logs)
    pull = PULL * float(np.square(logs - TransferPrior().logs).sum())
    nats = [TransferGP(p, prior, pairs, y).log_likelihood / len(y) for p, pairs, y in sets]
    return pull - float(np.mean(nats))


def fit(sets: list[Data]) -> tuple[TransferPrior, float, float]:
    start = TransferPrior().logs
    found = minimize(
        loss, start, args=(sets,), method="L-BFGS-B", bounds=[(v - 4.0, v + 4.0) for v in start],
        options={"maxiter": 25, "maxfun": 500},
    )  # fmt: skip
    return TransferPrior.of_logs(found.x), loss(start, sets), float(found.fun)


def written(prior: TransferPrior) -> str:
    numbers = ", ".join(f"{f.name}={getattr(prior, f.name):.4g}" for f in fields(prior))
    return f"TransferPrior({numbers})"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rows", type=int, default=4)
    parser.add_argument("--sets", type=int, default=12)
    parser.add_argument("--write", action="store_true")
    args = parser.parse_args()
    ids = shipped_matrices()
    families = sorted({family(i) for i in ids})
    lines = []
    for left_out in [None, *families]:
        rng, begin = np.random.default_rng(0), time.perf_counter()
        kept = [i for i in ids if family(i) != left_out]
        if not kept:
            continue
        prior, before, after = fit(data(kept, args.sets, args.rows, rng))
        label = "all" if left_out is None else left_out
        seconds = time.perf_counter() - begin
        print(
            f"without {left_out}: loss {before:.3f} -> {after:.3f} nats per pair, {seconds:.0f} s"
        )
        print("   ", written(prior), flush=True)
        lines.append(f'    "{label}": {written(prior)},')
    if args.write:
        text = FILE.read_text(encoding="utf-8")
        head, rest = text.split("# begin: benchmarks/learn_prior.py --write\n")
        tail = rest.split("# end\n")[1]
        table = "\n".join(lines)
        body = f"PRIORS: Mapping[str, TransferPrior] = {{\n{table}\n}}\n"
        FILE.write_text(
            f"{head}# begin: benchmarks/learn_prior.py --write\n{body}# end\n{tail}",
            encoding="utf-8",
        )


if __name__ == "__main__":
    main()
