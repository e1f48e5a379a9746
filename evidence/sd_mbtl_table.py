"""SD-MBTL's eight synthetic worlds with three axes, beside the published table: N = 512, K = 50.

    J(x, y) = 500 + f(x) + g(y) - h(x - y) + noise Z(x, y),    Z ~ N(0, 1), independent

The peer is the publication (AAAI 2026, arXiv 2601.08120; the authors' table of 100 trials per
world). Worlds and noise are the same by distribution, the noise is drawn anew. Printed is the mean
of (V - Random) / (oracle - Random) over all trials of all worlds, with half a 95 % interval, Random
and oracle being means of their world; it does not depend on the scale of V. Random is its exact
expectation; published is one order per trial. The oracle is, as published, one order for all
trials, greedy for the mean over all 100 of them.

    python evidence/sd_mbtl_table.py --trials 2 --worlds const-lin-nd const-lin-l1
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator

import numpy as np

from mbtl.arrays import Array
from mbtl.objective import value
from mbtl.selectors import get_selector
from mbtl.zoo.benchmark import SyntheticWorld, random_curve
from mbtl.zoo.benchmark.replay import replay
from mbtl.zoo.benchmark.shipped import synthetic_world

BUDGET, PUBLISHED_TRIALS = 50, 100
NAMES = {
    "gp-mbtl": "GP-MBTL",
    "m-mbtl": "M-MBTL",
    "sd-mbtl": "M/GP-MBTL",
    "specialists": "specialists",
}
WORLDS = tuple(
    f"{f}-{g}-{h}" for f in ("const", "lin") for g in ("lin", "none") for h in ("nd", "l1")
)
"""By source quality f, target difficulty g and dissimilarity h."""
PUBLISHED = {  # by noise: mean and half the width of its 95 % interval
    5: {"gp-mbtl": (0.603, 0.067), "m-mbtl": (0.218, 0.023), "sd-mbtl": (0.871, 0.014)},
    0: {"gp-mbtl": (0.837, 0.027), "m-mbtl": (0.301, 0.026), "sd-mbtl": (0.987, 0.002)},
    30: {"gp-mbtl": (0.213, 0.051), "m-mbtl": (0.015, 0.009), "sd-mbtl": (0.310, 0.028)},
}


def play(name: str, world: SyntheticWorld, trial: int) -> float:
    """V after K picks of one selector."""
    found = replay(
        get_selector(name), world.problem(BUDGET), lambda i: world.rows(trial, [i])[0], trial=trial
    )
    return value(found.history.best)


def common_order(world: SyntheticWorld) -> list[int]:
    """K picks, each the best for the mean over all trials; gains only shrink, so few are redone."""
    everyone = np.arange(world.n)
    rows = np.stack(
        [world.rows(t, everyone).astype(np.float32) for t in range(world.n_seeds)], axis=1
    )  # (source, trial, target)
    picks = [int(rows.mean(axis=(1, 2), dtype=np.float64).argmax())]
    ceiling = np.full(world.n, np.inf)  # of the gain in V
    for _ in range(1, BUDGET):
        ceiling[picks[-1]] = -np.inf
        best = rows[picks].max(axis=0)
        now = float(best.mean(dtype=np.float64))
        gain = np.full(world.n, -np.inf)
        while gain.max() < ceiling.max():
            source = int(ceiling.argmax())
            reached = np.maximum(rows[source], best)
            gain[source] = float(reached.mean(dtype=np.float64)) - now
            ceiling[source] = -np.inf
        picks.append(int(gain.argmax()))
        ceiling = np.maximum(ceiling, gain)
    return picks


def scores(world: SyntheticWorld, trials: int) -> Iterator[list[float]]:
    """By selector, (trials,): 0 at Random and 1 at the common oracle."""
    order = common_order(world)
    oracle = np.mean([value(world.rows(t, order).max(axis=0)) for t in range(trials)])
    random = np.mean([random_curve(world, t, BUDGET)[-1] for t in range(trials)])
    for name in NAMES:
        values = [play(name, world, trial) for trial in range(trials)]
        yield [float((v - random) / (oracle - random)) for v in values]


def spread(values: Array) -> float:
    """Half the width of the 95 % interval of a mean."""
    return 1.96 * float(values.std(ddof=1)) / len(values) ** 0.5 if len(values) > 1 else np.nan


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--trials", type=int, default=5, help="1 to 100; noise 0 has one")
    parser.add_argument("--noise", type=int, choices=sorted(PUBLISHED), default=5)
    parser.add_argument("--worlds", nargs="+", choices=WORLDS, default=WORLDS)
    args = parser.parse_args()
    trials = args.trials if args.noise else 1
    seeds = f"@{PUBLISHED_TRIALS}" if args.noise else ""  # bounds are those over all of them
    found: list[list[float]] = [[] for _ in NAMES]
    for name in args.worlds:
        print(f"{name}: {trials} trials ...", file=sys.stderr)
        world = synthetic_world(f"synthetic:3d-{name}-eta{args.noise}{seeds}")
        for all_worlds, here in zip(found, scores(world, trials), strict=True):
            all_worlds += here
    print(f"| noise {args.noise}, {trials} trials | score | published, all worlds |\n|---|---|---|")
    for (name, title), each in zip(NAMES.items(), map(np.array, found), strict=True):
        known = PUBLISHED[args.noise].get(name)
        published = "" if known is None else f"{known[0]:.3f} ± {known[1]:.3f}"
        print(f"| {title} | {each.mean():.3f} ± {spread(each):.2g} | {published} |")


if __name__ == "__main__":
    main()
