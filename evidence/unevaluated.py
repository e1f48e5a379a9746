"""What to believe of a policy on a context where it was not evaluated: two rules compared.

    python evidence/unevaluated.py

On every shipped matrix, five random sources, each policy evaluated on the same few targets as a
study spreads them (its own context among them). A rule fills in the rest, which gives a route and a
V. Claimed: that V. Real: V of that route on the reporting episodes of all contexts. A rule is good
where its routes are (real), and honest where it claims what is real (bias).
"""

from __future__ import annotations

from collections import defaultdict

import numpy as np
from scipy.spatial import KDTree

from mbtl.routing import Routing, last_route
from mbtl.selectors.targets import spread_targets
from mbtl.zoo.benchmark import load_matrix, shipped_matrices

SOURCES, DRAWS = 5, 4
SHARES = (0.05, 0.1, 0.2, 0.5)


def believed(rule: str, matrix, sources, rows):
    """(k, N) rows with all entries; a gap counts as its nearest neighbour, or as the model says."""
    if rule != "nearest":
        return Routing(matrix.space, sources, rows).believed
    out, steps = np.array(rows), matrix.space.steps
    for row, known in zip(out, np.isfinite(rows), strict=True):
        if not known.all():
            row[~known] = row[known][KDTree(steps[known]).query(steps[~known])[1]]
    return out


def main() -> None:
    """Print the table."""
    found: dict[tuple[str, float], list[tuple[float, float]]] = defaultdict(list)
    for name in shipped_matrices():
        matrix = load_matrix(name)
        if not matrix.measures_apart:
            continue
        for seed in range(matrix.n_seeds):
            problem = matrix.problem(SOURCES)
            for draw in range(DRAWS):
                rng = np.random.default_rng([seed, draw])
                sources = rng.choice(problem.sources, SOURCES, replace=False)
                full, real = matrix.rows(seed, sources), matrix.fresh_rows(seed, sources)
                for share in SHARES:
                    count = max(2, round(share * problem.n))
                    rows = np.full(full.shape, np.nan)
                    for row, source in enumerate(sources):
                        at = list(spread_targets(problem, int(source), count))
                        rows[row, at] = full[row, at]
                    for rule in ("nearest", "posterior mean", "all evaluated"):
                        known = full
                        if rule != "all evaluated":
                            known = believed(rule, matrix, tuple(sources.tolist()), rows)
                        route = last_route(known, sources.tolist(), problem.steps)
                        every = np.arange(problem.n)
                        claimed = float(known[route, every] @ problem.weights)
                        served = float(real[route, every] @ problem.weights)
                        found[rule, share].append((claimed, served))
        print(f"{name} done", flush=True)
    print(f"\n{'rule':<16}{'evaluated':>10}{'real V':>9}{'bias':>9}{'error':>9}{'cases':>7}")
    for (rule, share), pairs in sorted(found.items(), key=lambda one: (one[0][1], one[0][0])):
        claimed, served = np.array(pairs).T
        off = claimed - served
        print(
            f"{rule:<16}{share:>10.0%}{served.mean():>9.4f}{off.mean():>+9.4f}"
            f"{np.sqrt(np.square(off).mean()):>9.4f}{len(off):>7}"
        )


if __name__ == "__main__":
    main()
