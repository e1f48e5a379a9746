"""Do the stated intervals contain the truth? Simulated studies of a world whose answer is known.

    python evidence/coverage.py --studies 400

Each study has 40 contexts on a line and six policies trained somewhere on it. Returns fall with the
distance, differ with the context and the luck of the training, and no prior of ours was fitted to
them. Single episodes have a standard deviation of 0.2 on average, which differs between contexts
and policies; policies share half of the luck of a context's episodes. Skewed returns have the tail
of an exponential on the bad side. Printed is how many of 100 intervals of 95 % contain the truth,
and the mean half width: of V while a study runs, of V on fresh episodes, of the return of the
policy that serves a context (`portfolio.explain`), and of the gain over the best single policy.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from mbtl.arrays import Array
from mbtl.contexts import ContextSpace, Linear
from mbtl.episodes import scatter_of_sum, student
from mbtl.objective import Bounds
from mbtl.portfolio import Portfolio

N, K, FEW, SCATTER, SHARED = 40, 6, 10, 0.2, 0.5
SPACE = ContextSpace.grid({Linear("x", 0.0, 1.0): N})
X = SPACE.unit[:, 0]
WHAT = ("V, running", "V, fresh", "a route", "gain")


@dataclass(frozen=True)
class Setting:
    """Episodes of an entry, the tail of returns, and how many contexts a policy is evaluated on."""

    episodes: int
    skewed: bool
    targets: int = N

    def __str__(self) -> str:
        return f"{self.episodes} | {'skewed' if self.skewed else 'normal'} | {self.targets} of {N}"


def true_returns(sources: Array, rng: np.random.Generator) -> Array:
    """(K, N)."""
    apart, slopes = X - X[sources][:, None], rng.uniform(0.2, 0.8, 2)
    fall = slopes[0] * np.maximum(apart, 0.0) - slopes[1] * np.minimum(apart, 0.0)
    hard = 0.2 * np.sin(4.0 * X + rng.uniform(0.0, 6.28))
    luck, rough = 0.05 * rng.standard_normal((K, 1)), 0.01 * rng.standard_normal((K, N))
    return np.asarray(0.9 + luck - fall - hard + rough)


def luck(shape: tuple[int, ...], skewed: bool, rng: np.random.Generator) -> Array:
    """Of mean 0 and variance 1."""
    return 1.0 - rng.exponential(size=shape) if skewed else rng.standard_normal(shape)


def errors(setting: Setting, seed: int) -> dict[str, tuple[float, float]]:
    """Of one study: name -> error of what is said, and half its interval."""
    rng = np.random.default_rng([seed, setting.episodes, setting.skewed, setting.targets])
    sources = rng.choice(N, K, replace=False)
    truth, at = true_returns(sources, rng), np.arange(N)
    deviation = SCATTER * np.exp(0.3 * rng.standard_normal((K, 1)) + 0.4 * rng.standard_normal(N))

    def play() -> Array:
        common = luck((1, N, setting.episodes), setting.skewed, rng)
        own = luck((K, N, setting.episodes), setting.skewed, rng)
        noise = np.sqrt(SHARED) * common + np.sqrt(1.0 - SHARED) * own
        return np.asarray(truth[:, :, None] + deviation[:, :, None] * noise)

    played = play()
    seen = np.linspace(0, N - 1, setting.targets).round().astype(int)
    for policy, source in enumerate(sources):
        played[policy, np.setdiff1d(at, [*seen, source])] = np.nan
    portfolio = Portfolio(
        SPACE, tuple(sources), played.mean(axis=2), Bounds(0.0, 1.0), 0.01, episodes=list(played)
    )
    routing = portfolio.routing
    route, now, best = routing.route, routing.value, routing.best_single
    value = float(truth[route, at].mean())
    over, fresh = routing.gain, play()[route, at] / N
    variance, freedom = scatter_of_sum(fresh)
    asked = int(rng.integers(N))
    choice = portfolio.explain(SPACE.context(asked))
    assert choice.error is not None
    return {
        "V, running": (now.value - value, now.margin),
        "V, fresh": (
            float(fresh.mean(axis=1).sum()) - value,
            student(freedom) * float(np.sqrt(variance)),
        ),
        "a route": (choice.predicted_return - truth[choice.policy, asked], 1.96 * choice.error),
        "gain": (over.value - (value - float(truth[best].mean())), over.margin),
    }


def measured(setting: Setting, studies: int) -> dict[str, Array]:
    """Name -> (studies, 2) of `errors`."""
    found = [errors(setting, seed) for seed in range(studies)]
    return {name: np.array([one[name] for one in found]) for name in WHAT}


def settings() -> Iterator[Setting]:
    """All that are printed."""
    for targets in (N, FEW):
        for episodes in (2, 5, 20, 100):
            for skewed in (False, True):
                yield Setting(episodes, skewed, targets)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--studies", type=int, default=400)
    studies = parser.parse_args().studies
    print(f"| episodes | returns | evaluated on | {' | '.join(WHAT)} | bias of V, running |")
    print("|---" * (4 + len(WHAT)) + "|")
    for setting in settings():
        found = measured(setting, studies)
        cells = [
            f"{100 * np.mean(abs(error) <= half):.0f} (+- {half.mean():.3f})"
            for error, half in (found[name].T for name in WHAT)
        ]
        bias = found["V, running"][:, 0].mean()
        print(f"| {setting} | {' | '.join(cells)} | {bias:+.4f} |", flush=True)


if __name__ == "__main__":
    main()
