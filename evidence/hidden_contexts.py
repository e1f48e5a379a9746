"""What `portfolio.adaptive()` is worth where the context is not told.

    OMP_NUM_THREADS=1 python evidence/hidden_contexts.py [--everybody]

Portfolios of five specialists, as the paper's rule picks them, on the shipped matrices, the set in
which policies do not see the context where there is one; one seed. In every fourth context ten
episodes are drawn three times, normal with the mean of the reporting half and the stored deviation;
policies are chosen by the other half. Shares are of the way from the best single policy (0) to
routing with the context told (1), by the mean returns of the policies that are played; without
exploration, the policy of largest expected return is played.

`--everybody`: on the small problems in which policies do not see the context, at the price of five
trainings: five specialists, or one policy for all and four specialists, beside one policy for all
with four units. V by the mean returns of the policies that are played, and the lead over the last
with its standard error over problems.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from mbtl.portfolio import Portfolio
from mbtl.problems import cmdp_ids, get_cmdp
from mbtl.selectors import get_selector
from mbtl.zoo.benchmark import load_matrix
from mbtl.zoo.benchmark.matrix import TransferMatrix
from mbtl.zoo.benchmark.replay import replay
from mbtl.zoo.benchmark.shipped import shipped_matrices
from mbtl.zoo.benchmark.trainings import TransferWorld, replay_trainings
from mbtl.zoo.benchmark.transfers import load_transfers, transfer_ids

EPISODES, DRAWS, EVERY, SPECIALISTS, SAME = 10, 3, 4, 5, 20
SHOWN = (1, 2, 3, 5, 10)
SMALL = Path(__file__).with_name("small")
LITTLE = 0.005
"""Performance between the best single policy and the told context below which a share is noise."""


def portfolio_of(matrix: TransferMatrix) -> tuple[Portfolio, np.ndarray, np.ndarray]:
    """By half 0; (k, N) performance in half 1, and deviations of episodes, raw."""
    problem = matrix.problem(SPECIALISTS)
    run = replay(get_selector("mbtl"), problem, lambda i: matrix.rows(0, [i])[0])
    picks = list(run.history.sources)
    rows = np.searchsorted(matrix.trained, picks)
    returns, std = matrix.returns[0][rows], matrix.std[0][rows]
    served = Portfolio(matrix.space, tuple(picks), returns, matrix.bounds, episodes(returns, std))
    return served, matrix.fresh_rows(0, picks), std


def episodes(returns: np.ndarray, std: np.ndarray) -> list[np.ndarray]:
    """With the stored mean and deviation; as many as make the deviation well known."""
    return list(returns[..., None] + std[..., None] * np.tile([-1.0, 1.0], SAME))


def reached(
    served: Portfolio, truth: np.ndarray, std: np.ndarray, explore: bool, every: int = EVERY
) -> np.ndarray:
    """(EPISODES,) mean performance of the policies that are played."""
    rng, contexts = np.random.default_rng(0), range(0, served.space.n, every)
    found = np.zeros(EPISODES)
    for x in contexts:
        for _ in range(DRAWS):
            serving = served.adaptive(episodes=EPISODES if explore else 1)
            for t in range(EPISODES):
                k = serving.next
                found[t] += truth[k, x] / (len(contexts) * DRAWS)
                mean = float(served.bounds.denormalise(truth[k, x]))
                serving.observe(float(rng.normal(mean, std[k, x])), k)
    return found


def ends(served: Portfolio, truth: np.ndarray, some: np.ndarray) -> tuple[float, float]:
    """Mean performance in some contexts: of the best single policy, and with the context told."""
    known = served.performance
    low = truth[known.mean(axis=1).argmax(), some].mean()
    return low, truth[known.argmax(axis=0)[some], some].mean()


def main() -> None:
    print(f"| matrix | best single | told | share in episode {SHOWN} | without exploration |")
    print("|---|---|---|---|---|")
    shares: list[tuple[np.ndarray, np.ndarray]] = []
    for id in cmdp_ids():
        hidden = f"{id}-hidden" in shipped_matrices()
        if len(get_cmdp(id).space.axes) > 1 or id not in shipped_matrices():
            continue
        matrix = load_matrix(id, "hidden" if hidden else "default")
        if matrix.std is None or matrix.fresh_returns is None:
            continue
        served, truth, std = portfolio_of(matrix)
        low, high = ends(served, truth, np.arange(0, matrix.n, EVERY))
        row = f"| {id}{'-hidden' if hidden else ''} | {low:.3f} | {high:.3f} |"
        if high - low < LITTLE:
            print(f"{row} little to gain | |", flush=True)
            continue
        both = [(reached(served, truth, std, e) - low) / (high - low) for e in (True, False)]
        shares.append((both[0], both[1]))
        cells = (" ".join(f"{one[e - 1]:.2f}" for e in SHOWN) for one in both)
        print(f"{row} {' | '.join(cells)} |", flush=True)
    for name, one in zip(("exploring", "not"), np.median(shares, axis=0), strict=True):
        print(f"median of {len(shares)}, {name}: {' '.join(f'{one[e - 1]:.2f}' for e in SHOWN)}")
    print(f"mean over episodes: {np.mean(shares, axis=(0, 2)).round(3)}")


def everybody() -> None:
    found: list[list[float]] = []
    for name in transfer_ids(SMALL):
        if "-hidden-" not in name:
            continue
        data = load_transfers(name, folder=SMALL)
        run = replay_trainings(get_selector("mbtl"), TransferWorld(data, 0), SPECIALISTS)
        picks = run.history.sources
        rows = np.searchsorted(data.sources, picks)
        long, short = data.generalists[4.0][0], data.generalists[1.0][0]
        std = data.std["specialists"][0, rows]
        first = data.std["generalists"][list(data.generalists).index(1.0), 0]
        alone = data.specialists[0][:, rows]
        mixed = np.concatenate([short[:, None], alone[:, :-1]], axis=1)
        line = [float(data.bounds.normalise(long[1]).mean())]
        for sources, half, spread in (
            (picks, alone, std),
            ((data.n // 2, *picks[:-1]), mixed, np.concatenate([first[None], std[:-1]])),
        ):
            served = Portfolio(data.space, sources, half[0], data.bounds, episodes(half[0], spread))
            truth = data.bounds.normalise(half[1])
            single, told = ends(served, truth, np.arange(data.n))
            seen = reached(served, truth, spread, True, every=1)
            line += [single, *seen[[0, 2, 9]], told]
        found.append(line)
        print(name, np.round(line, 3), flush=True)
    table = np.array(found)
    heads = ("best single", "episode 1", "3", "10", "told")
    print(f"{len(table)} problems; one policy for all, 4 units: {table[:, 0].mean():.3f}")
    for start, who in ((1, "five specialists"), (6, "one for all, four specialists")):
        for i, head in enumerate(heads, start):
            lead = table[:, i] - table[:, 0]
            error = lead.std(ddof=1) / len(lead) ** 0.5
            print(f"{who}, {head}: {table[:, i].mean():.3f} ({lead.mean():+.3f} +- {error:.3f})")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--everybody", action="store_true", help="beside one policy for all")
    (everybody if parser.parse_args().everybody else main)()
