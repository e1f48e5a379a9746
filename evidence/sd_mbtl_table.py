"""SD-MBTL's table of its eight synthetic worlds with three axes, beside ours: N = 512, K = 50.

The peer is the publication (AAAI 2026, arXiv 2601.08120; the authors' table of 100 trials per
world). Worlds and noise are the same by distribution, the noise is drawn anew. Returns are scaled
by the extremes over all 100 trials of a world, which are noise too: a whole row may sit some
thousandths above or below the published one. The aggregate does not depend on it: the mean of
(V - Random) / (oracle - Random) over all trials of all worlds run, Random and oracle being means of
their world.

Random is its exact expectation; published is one order per trial. The oracle is, as published, one
order for all trials, greedy for the mean over all 100 of them; beside it stands each trial's own.

example: python evidence/sd_mbtl_table.py --trials 2 --worlds const-lin-nd const-lin-l1
"""

from __future__ import annotations

from typing import Any

import measure
import numpy as np
from measure import digits, note
from sd_worlds import sd_worlds

from mbtl.arrays import Array
from mbtl.objective import value
from mbtl.selectors import get_selector
from mbtl.zoo.benchmark import SyntheticWorld, random_curve, sequential_oracle
from mbtl.zoo.benchmark.replay import replay

BUDGET, PUBLISHED_TRIALS = 50, 100
METHODS = ("random", "gp-mbtl", "m-mbtl", "sd-mbtl", "oracle")
SELECTORS = ("gp-mbtl", "m-mbtl", "sd-mbtl", "specialists")
OWN_ORACLE = "oracle of each trial"
NAMES = {
    "random": "Random", "gp-mbtl": "GP-MBTL", "m-mbtl": "M-MBTL", "sd-mbtl": "M/GP-MBTL",
    "oracle": "oracle", OWN_ORACLE: "own oracle", "specialists": "auto",
}  # fmt: skip
PUBLISHED = {  # V after 50 trainings, in the order of METHODS, by world and noise
    "const-lin-nd": {
        5: (0.6956, 0.7212, 0.6976, 0.7168, 0.7260),
        0: (0.7028, 0.7250, 0.7055, 0.7250, 0.7250),
        30: (0.7083, 0.7274, 0.7091, 0.7202, 0.7319),
    },
    "const-lin-l1": {
        5: (0.7011, 0.6961, 0.7038, 0.7038, 0.7048),
        0: (0.7122, 0.7110, 0.7187, 0.7187, 0.7190),
        30: (0.6879, 0.6825, 0.6879, 0.6876, 0.6952),
    },
    "const-none-nd": {
        5: (0.7906, 0.8369, 0.7936, 0.8334, 0.8375),
        0: (0.8688, 0.9091, 0.8736, 0.9091, 0.9091),
        30: (0.7036, 0.7274, 0.7045, 0.7215, 0.7295),
    },
    "const-none-l1": {
        5: (0.7722, 0.7747, 0.7762, 0.7762, 0.7778),
        0: (0.9244, 0.9364, 0.9374, 0.9374, 0.9382),
        30: (0.7125, 0.7181, 0.7125, 0.7150, 0.7205),
    },
    "lin-lin-nd": {
        5: (0.5773, 0.6088, 0.5782, 0.6086, 0.6090),
        0: (0.5544, 0.5714, 0.5552, 0.5714, 0.5714),
        30: (0.6815, 0.6790, 0.6818, 0.6912, 0.7135),
    },
    "lin-lin-l1": {
        5: (0.5880, 0.6218, 0.5900, 0.6216, 0.6221),
        0: (0.5517, 0.5714, 0.5535, 0.5714, 0.5714),
        30: (0.6840, 0.6810, 0.6844, 0.6953, 0.7234),
    },
    "lin-none-nd": {
        5: (0.6672, 0.7083, 0.6683, 0.7073, 0.7088),
        0: (0.6761, 0.7000, 0.6772, 0.7000, 0.7000),
        30: (0.7240, 0.7202, 0.7244, 0.7272, 0.7586),
    },
    "lin-none-l1": {
        5: (0.7401, 0.7744, 0.7422, 0.7751, 0.7756),
        0: (0.7660, 0.7857, 0.7678, 0.7857, 0.7857),
        30: (0.7246, 0.7366, 0.7250, 0.7393, 0.7670),
    },
}
AGGREGATED = {  # published, over all eight worlds: mean and half the width of its 95 % interval
    5: {"gp-mbtl": (0.603, 0.067), "m-mbtl": (0.218, 0.023), "sd-mbtl": (0.871, 0.014)},
    0: {"gp-mbtl": (0.837, 0.027), "m-mbtl": (0.301, 0.026), "sd-mbtl": (0.987, 0.002)},
    30: {"gp-mbtl": (0.213, 0.051), "m-mbtl": (0.015, 0.009), "sd-mbtl": (0.310, 0.028)},
}


def published(world: str, noise: int) -> dict[str, float]:
    """V by method, of those that are in the publication."""
    return dict(zip(METHODS, PUBLISHED[world][noise], strict=True))


def short(world: SyntheticWorld) -> str:
    """The part of an id that names f, g and h."""
    return world.name.removeprefix("synthetic:3d-").split("-eta")[0]


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


def run_world(world: SyntheticWorld, trials: int) -> tuple[dict[str, Array], dict[str, float]]:
    """(trials,) V by method, and seconds of processor time per trial of each selector."""
    values: dict[str, list[float]] = {name: [] for name in NAMES}
    watch = measure.Stopwatch()
    order = common_order(world)
    for trial in range(trials):
        values["random"].append(float(random_curve(world, trial, BUDGET)[-1]))
        values["oracle"].append(value(world.rows(trial, order).max(axis=0)))
        values[OWN_ORACLE].append(float(sequential_oracle(world, trial, BUDGET).curve[-1]))
        for name in SELECTORS:
            with watch.of(name):
                values[name].append(play(name, world, trial))
    seconds = {name: cost.cpu / trials for name, cost in watch.parts.items()}
    return {name: np.array(found) for name, found in values.items()}, seconds


def spread(values: Array) -> float | None:
    """Half the width of the 95 % interval of a mean; None for a single value."""
    if len(values) < 2:
        return None
    return digits(1.96 * float(values.std(ddof=1)) / len(values) ** 0.5, 2)


def aggregate(results: dict[str, dict[str, Array]], noise: int) -> dict[str, Any]:
    """Normalised scores, 0 at Random and 1 at the common oracle, and the published ones."""
    found: dict[str, Any] = {}
    for name in SELECTORS:
        ours, theirs = [], []
        for world, values in results.items():
            low, high = values["random"].mean(), values["oracle"].mean()
            ours.append((values[name] - low) / (high - low))
            printed = published(world, noise)
            if name in printed:
                low, high = printed["random"], printed["oracle"]
                theirs.append((printed[name] - low) / (high - low))
        scores = np.concatenate(ours)
        found[name] = {
            "mean": digits(float(scores.mean()), 3),
            "interval": spread(scores),
            "published_same_worlds": digits(float(np.mean(theirs)), 3) if theirs else None,
            "published_all_worlds": AGGREGATED[noise].get(name),
        }
    return found


def lines_of(document: dict[str, Any]) -> list[str]:
    """The table as text: ours over published in every cell."""
    noise, trials = document["noise"], document["trials"]
    lines = [
        f"V after {BUDGET} of 512 trainings, noise {noise}: mean of {trials} trials +- half a 95 % "
        "interval; below it published, mean of 100",
        f"  {'f-g-h':14}" + "".join(f"{NAMES[name]:>18}" for name in NAMES),
    ]
    for world, cells in document["worlds"].items():
        ours = "".join(f"{c['mean']:9.4f} +-{c['interval'] or 0:6.4f}" for c in cells.values())
        printed = [cells[name]["published"] for name in METHODS]
        theirs = "".join(f"{v:9.4f}{'':9}" for v in printed)
        lines += [f"  {world:14}{ours}", f"  {'':14}{theirs}".rstrip()]
    lines.append(f"  {'aggregate':14}{'ours':>18}{'published, these':>18}{'published, all':>18}")
    for name, score in document["aggregate"].items():
        line = f"  {NAMES[name]:14}{score['mean']:9.3f} +-{score['interval'] or 0:6.3f}"
        if score["published_all_worlds"] is not None:
            mean, half = score["published_all_worlds"]
            line += f"{score['published_same_worlds']:18.3f}{mean:9.3f} +-{half:6.3f}"
        lines.append(line)
    seconds = ", ".join(f"{NAMES[n]} {s:.2f}" for n, s in document["seconds"].items())
    return [*lines, f"processor seconds per run of {BUDGET} picks: {seconds}"]


def main() -> None:
    """Run what the arguments ask for."""
    parser = measure.parser(__doc__)
    parser.add_argument("--trials", type=int, default=5, help="1 to 100; noise 0 has one")
    parser.add_argument("--noise", type=int, choices=sorted(AGGREGATED), default=5)
    parser.add_argument("--worlds", nargs="+", choices=PUBLISHED, default=list(PUBLISHED))
    args = parser.parse_args()
    if not 1 <= args.trials <= PUBLISHED_TRIALS:
        parser.error(f"--trials must be from 1 to {PUBLISHED_TRIALS}, got {args.trials}")
    trials = args.trials if args.noise else 1
    seeds = PUBLISHED_TRIALS if args.noise else None
    worlds = {short(world): world for world in sd_worlds(3, noise=args.noise, n_seeds=seeds)}
    results: dict[str, dict[str, Array]] = {}
    seconds: dict[str, list[float]] = {}
    for name in args.worlds:
        note(f"{name}: {trials} trials ...")
        results[name], spent = run_world(worlds[name], trials)
        for method, cpu in spent.items():
            seconds.setdefault(method, []).append(cpu)
    document = {
        "noise": args.noise,
        "trials": trials,
        "worlds": {
            world: {
                name: {
                    "mean": digits(float(values[name].mean())),
                    "interval": spread(values[name]),
                    "published": published(world, args.noise).get(name),
                }
                for name in NAMES
            }
            for world, values in results.items()
        },
        "aggregate": aggregate(results, args.noise),
        "seconds": {name: digits(float(np.mean(cpu)), 3) for name, cpu in seconds.items()},
        "machine": measure.machine("scikit-learn"),
    }
    measure.show(document, lines_of(document), as_json=args.json)


if __name__ == "__main__":
    main()
