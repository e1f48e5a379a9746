"""Which fit finds the higher likelihood: `fit_gp`, or scikit-learn's best of 15 restarts?

On random data sets of up to 45 points: how often the log marginal likelihood (LML) of `fit_gp` is
higher, equal or lower, "equal" meaning within 1e-6 (1 + |LML|); how often the next pick is the same
where the likelihoods are equal, and where they are not; and the ratio of the two times. Data sets
where ours is lower, or where equal likelihoods led to different picks, are listed one by one: two
fits can differ with equal likelihood where it does not depend on the length-scale at all.

example: python benchmarks/gp_optimum.py --datasets 500
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Any

import measure
import numpy as np
from measure import Cost, digits, now
from sklearn_gp import fit_sklearn

from mbtl.acquisition import argmax_open, optimistic_gain
from mbtl.arrays import Array, uniform_weights
from mbtl.models import FittedGP, GPSettings, fit_gp
from mbtl.selectors.mbtl import ucb_weight

SHAPES = ("smooth", "rough", "flat", "failures", "cliff", "noise")


@dataclass(frozen=True)
class DataSet:
    """Training performances seen on a grid of N contexts."""

    shape: str
    n_contexts: int
    points: Array
    y: Array
    settings: GPSettings


def draw(rng: np.random.Generator) -> DataSet:
    """What a run may meet: curves of every roughness, failed trainings, a cliff, or only noise."""
    n_contexts = int(rng.choice([30, 100, 250, 1000]))
    n = int(rng.integers(2, min(45, n_contexts) + 1))
    points = np.sort(rng.choice(n_contexts, n, replace=False)).astype(np.float64)
    where = points / n_contexts
    shape = SHAPES[int(rng.integers(len(SHAPES)))]
    phase, jitter = rng.uniform(0.0, 2.0 * np.pi), rng.standard_normal(n)
    y: Array
    if shape == "smooth":
        y = 0.7 + 0.2 * np.sin(2.0 * np.pi * rng.uniform(0.3, 2.0) * where + phase)
    elif shape == "rough":
        waves = np.arange(1.0, 12.0)
        sizes = rng.normal(scale=0.3 / waves)
        y = 0.6 + np.sin(waves * (2.0 * np.pi * where[:, None] + phase)) @ sizes
    elif shape == "flat":
        y = np.full(n, rng.uniform(0.1, 1.0))
    elif shape == "failures":
        y = np.where(rng.uniform(size=n) < rng.uniform(0.05, 0.4), 0.02, 0.95)
    elif shape == "cliff":
        y = np.where(where < rng.uniform(0.2, 0.8), 0.9, 0.3)
    else:
        y = 0.5 + 0.2 * jitter
    y = y + rng.choice([0.0, 0.001, 0.02, 0.1]) * jitter
    noise_std = float(rng.choice([1e-3, 1e-3, 0.1]))  # the paper's, more often than the release's
    return DataSet(shape, n_contexts, points, y, GPSettings(noise_std))


def next_pick(gp: FittedGP, data: DataSet) -> int:
    """The paper's acquisition on the rows that the linear gap predicts."""
    n, theta = data.n_contexts, 0.5 / (data.n_contexts - 1)
    steps = np.arange(n, dtype=np.float64)[:, None]
    mean, std = gp.predict(steps)
    best = (data.y[:, None] - theta * np.abs(data.points[:, None] - steps[:, 0])).max(axis=0)
    upper = mean + np.sqrt(ucb_weight(len(data.y) + 1, n)) * std
    gain = optimistic_gain(upper, steps, steps, best, uniform_weights(n), theta=theta)
    is_open = np.ones(n, dtype=bool)
    is_open[data.points.astype(np.intp)] = False
    return argmax_open(gain, is_open | (not is_open.any()))


def main() -> None:
    """Measure and print."""
    parser = measure.parser(__doc__)
    parser.add_argument("--datasets", type=int, default=500)
    parser.add_argument("--restarts", type=int, default=15, help="of scikit-learn's optimiser")
    parser.add_argument("--seed", type=int, default=2024)
    args = parser.parse_args()
    verdicts: Counter[str] = Counter()
    same_pick: Counter[str] = Counter()
    odd: list[dict[str, Any]] = []
    gains: list[float] = []
    ours_total, peer_total = Cost(), Cost()
    for number in range(args.datasets):
        data = draw(np.random.default_rng([args.seed, number]))
        start = now()
        ours = fit_gp(data.points, data.y, data.settings)
        middle = now()
        peer = fit_sklearn(data.points, data.y, data.settings, restarts=args.restarts, seed=number)
        end = now()
        if number:  # the first fits also load code
            ours_total, peer_total = ours_total + (middle - start), peer_total + (end - middle)
        difference = (ours.lml - peer.lml) / (1.0 + abs(peer.lml))
        verdict = "higher" if difference > 1e-6 else "lower" if difference < -1e-6 else "equal"
        verdicts[verdict] += 1
        gains.append(ours.lml - peer.lml)
        same = next_pick(ours, data) == next_pick(peer, data)
        same_pick[verdict] += same
        if verdict == "lower" or (verdict == "equal" and not same):
            odd.append(
                {
                    "number": number,
                    "verdict": verdict,
                    "shape": data.shape,
                    "points": len(data.y),
                    "difference": digits(gains[-1], 3),
                    "lengths": [digits(ours.length), digits(peer.length)],
                }
            )
    ratio = peer_total.cpu / ours_total.cpu if ours_total.cpu else float("nan")
    document: dict[str, Any] = {
        "datasets": args.datasets,
        "restarts": args.restarts,
        "seed": args.seed,
        "fit_gp_is": {name: verdicts[name] for name in ("higher", "equal", "lower")},
        "same_pick": {name: same_pick[name] for name in ("higher", "equal", "lower")},
        "largest_gain": digits(max(gains), 3),
        "largest_loss": digits(max(0.0, -min(gains)), 3),
        "lower_or_other_pick": odd,
        "fit_gp_ms": (ours_total / max(args.datasets - 1, 1)).to_json(1e-3),
        "sklearn_ms": (peer_total / max(args.datasets - 1, 1)).to_json(1e-3),
        "ratio": digits(ratio, 3),
        "machine": measure.machine("scikit-learn"),
    }
    lines = [
        f"LML of fit_gp against scikit-learn's best of {args.restarts} restarts "
        f"on {args.datasets} data sets:",
        *(
            f"  {name:7}{verdicts[name]:5} data sets, of these with the same next pick: "
            f"{same_pick[name]}"
            for name in ("higher", "equal", "lower")
        ),
        f"  largest gain {max(gains):.3g}, largest loss {max(0.0, -min(gains)):.3g}",
        f"scikit-learn's fit takes {ratio:.0f} times as long",
        *(
            f"  data set {e['number']} ({e['shape']}, {e['points']} points): {e['verdict']}, "
            f"lengths {e['lengths'][0]} and {e['lengths'][1]}, LML difference {e['difference']}"
            for e in odd
        ),
    ]
    measure.show(document, lines, as_json=args.json)


if __name__ == "__main__":
    main()
