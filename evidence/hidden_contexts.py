"""What `portfolio.adaptive()` is worth where the context is not told.

    OMP_NUM_THREADS=1 python evidence/hidden_contexts.py

Portfolios of the policy for all of one unit and four specialists, as the paper's rule picks them,
on all transfer data, one seed. In every fourth context ten episodes are drawn three times, normal
with the mean of the reporting half and the stored deviation; policies are chosen by the other half.
Shares are of the way from the best single policy (0) to routing with the context told (1), by the
mean returns of the policies that are played.
"""

from __future__ import annotations

import numpy as np

from mbtl.portfolio import Adaptive, Portfolio
from mbtl.selectors import get_selector
from mbtl.zoo.benchmark.replay import replay
from mbtl.zoo.benchmark.trainings import specialists_of
from mbtl.zoo.benchmark.transfers import TransferData, load_transfers, transfer_ids

EPISODES, DRAWS, EVERY, SPECIALISTS = 10, 3, 4, 4
SHOWN = (1, 2, 3, 5, 10)
LITTLE = 0.005
"""Performance between the best single policy and the told context below which a share is noise."""


def portfolio_of(data: TransferData) -> tuple[Portfolio, np.ndarray, np.ndarray]:
    """The portfolio by half 0; (k, N) raw returns of half 1, and deviations."""
    matrix = specialists_of(data, None)
    chosen = replay(
        get_selector("mbtl"), matrix.problem(SPECIALISTS), lambda i: matrix.rows(0, [i])[0]
    )
    picks = list(chosen.history.sources)
    rows = np.searchsorted(data.sources, picks)
    halves = np.concatenate(
        [data.generalists[1.0][0][:, None], data.specialists[0][:, rows]], axis=1
    )
    at = list(data.generalists).index(1.0)
    std = np.vstack([data.std["generalists"][at][:1], data.std["specialists"][0][rows]])
    everyone = tuple(range(data.n))
    # two episodes at a distance have the stored mean and deviation, and stand for many
    drawn = [
        (mean[:, None] + np.outer(s, [-1, 1]) / np.sqrt(2)).repeat(20, 1)
        for mean, s in zip(halves[0], std, strict=True)
    ]
    return (
        Portfolio(
            space=data.space, sources=(data.n // 2, *picks), returns=halves[0],
            bounds=data.bounds, episodes=drawn, sets={0: everyone},
        ),
        halves[1],
        std,
    )  # fmt: skip


def main() -> None:
    print("| CMDP | all | best single | told | in episode 1, 2, 3, 5, 10 |\n|---|---|---|---|---|")
    shares = []
    for name in transfer_ids():
        served, fresh, std = portfolio_of(data := load_transfers(name))
        truth, rng = data.bounds.normalise(fresh), np.random.default_rng(0)
        contexts = range(0, data.n, EVERY)
        reached = np.zeros(EPISODES)
        for x in contexts:
            for _ in range(DRAWS):
                serving = Adaptive(served, EPISODES)
                for t in range(EPISODES):
                    k = serving.next
                    reached[t] += truth[k, x] / (len(contexts) * DRAWS)
                    serving.observe(float(rng.normal(fresh[k, x], std[k, x])), k)
        known = served.performance
        single, told = truth[known.mean(1).argmax()], truth[known.argmax(0), np.arange(data.n)]
        low, high = single[list(contexts)].mean(), told[list(contexts)].mean()
        share = (reached - low) / (high - low)
        cells = "little to gain"
        if high - low > LITTLE:
            shares.append(share)
            cells = " ".join(f"{share[e - 1]:.2f}" for e in SHOWN)
        print(f"| {name} | {truth[0].mean():.3f} | {low:.3f} | {high:.3f} | {cells} |", flush=True)
    middle = np.median(shares, axis=0)
    print(f"\nmedian of {len(shares)}: {' '.join(f'{middle[e - 1]:.2f}' for e in SHOWN)}")


if __name__ == "__main__":
    main()
