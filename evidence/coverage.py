"""Do the stated intervals contain the truth? Simulated studies of a world whose answer is known.

    python evidence/coverage.py --studies 400

Each study has 40 contexts on a line and six policies trained somewhere on it. Returns fall with the
distance, differ with the context and the luck of the training, and no prior of ours was fitted to
them. Single episodes have a standard deviation of 0.2 on average, which differs between contexts
and policies; policies share half of the luck of a context's episodes. Skewed returns have the tail
of an exponential on the bad side. Printed is how many of 100 intervals of 95 % contain the truth,
and the mean half width: of V while a study runs, of V on fresh episodes of all contexts and of a
sample of half of them, of the return of the policy that serves a context (`portfolio.explain`), and
of the gain over the best single policy, while a study runs and on the sample. The last lines are of
a V that is the mean of the worst tenth of the contexts; it has no fresh episodes.

    python evidence/coverage.py --studies 20 --report

has 400 contexts instead, and evaluates each of ten policies on 20 of them in five episodes, which
are skewed. It prints how wide V's interval is by how many contexts the closing report plays.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np

from mbtl.arrays import Array
from mbtl.contexts import ContextSpace, Linear
from mbtl.objective import Bounds, worst_share_mean
from mbtl.portfolio import Portfolio
from mbtl.study.closing_report import drawn, estimated

N, FEW, SCATTER, SHARED = 40, 10, 0.2, 0.5
WHAT = ("V, running", "V, fresh", "V, sampled", "a route", "gain", "gain, sampled")


@dataclass(frozen=True)
class Setting:
    """One line of the table.

    Attributes:
        episodes: of an entry.
        skewed: returns have a tail.
        targets: contexts that a policy is evaluated on.
        risk: share of the contexts, the worst of them, that V is the mean of.
        n: number of contexts.
        k: number of policies.
        report: contexts that the sample has.
    """

    episodes: int
    skewed: bool
    targets: int = N
    risk: float = 1.0
    n: int = N
    k: int = 6
    report: int = N // 2

    def __str__(self) -> str:
        worst = f", worst {self.risk:.0%}" if self.risk < 1.0 else ""
        tail = "skewed" if self.skewed else "normal"
        return f"{self.episodes} | {tail} | {self.targets} of {self.n}{worst}"


def true_returns(x: Array, sources: Array, rng: np.random.Generator) -> Array:
    """(K, N) of policies trained at some of the places x (N,)."""
    apart, slopes = x - x[sources][:, None], rng.uniform(0.2, 0.8, 2)
    fall = slopes[0] * np.maximum(apart, 0.0) - slopes[1] * np.minimum(apart, 0.0)
    hard = 0.2 * np.sin(4.0 * x + rng.uniform(0.0, 6.28))
    luck, rough = (
        0.05 * rng.standard_normal((len(sources), 1)),
        0.01 * rng.standard_normal(apart.shape),
    )
    return np.asarray(0.9 + luck - fall - hard + rough)


def luck(shape: tuple[int, ...], skewed: bool, rng: np.random.Generator) -> Array:
    """Of mean 0 and variance 1."""
    return 1.0 - rng.exponential(size=shape) if skewed else rng.standard_normal(shape)


def errors(setting: Setting, seed: int) -> dict[str, tuple[float, float]]:
    """Of one study: name -> error of what is said, and half its interval."""
    n, k = setting.n, setting.k
    space = ContextSpace.grid({Linear("x", 0.0, 1.0): n})
    rng = np.random.default_rng([seed, setting.episodes, setting.skewed, setting.targets])
    sources = rng.choice(n, k, replace=False)
    truth, at = true_returns(space.unit[:, 0], sources, rng), np.arange(n)
    deviation = SCATTER * np.exp(0.3 * rng.standard_normal((k, 1)) + 0.4 * rng.standard_normal(n))

    def play() -> Array:
        common = luck((1, n, setting.episodes), setting.skewed, rng)
        own = luck((k, n, setting.episodes), setting.skewed, rng)
        noise = np.sqrt(SHARED) * common + np.sqrt(1.0 - SHARED) * own
        return np.asarray(truth[:, :, None] + deviation[:, :, None] * noise)

    played = play()
    seen = np.linspace(0, n - 1, setting.targets).round().astype(int)
    for policy, source in enumerate(sources):
        played[policy, np.setdiff1d(at, [*seen, source])] = np.nan
    portfolio = Portfolio(
        space,
        tuple(sources),
        played.mean(axis=2),
        Bounds(0.0, 1.0),
        episodes=list(played),
        risk=setting.risk,
    )
    routing = portfolio.routing
    route, now, best, over = routing.route, routing.value, routing.best_single, routing.gain
    value, single = worst_share_mean(truth[[route, np.full(n, best)], at], None, setting.risk)
    fresh, asked = play(), int(rng.integers(n))
    choice = portfolio.explain(space.context(asked))
    assert choice.error is not None
    found = {
        "V, running": (now.value - value, now.margin),
        "a route": (choice.predicted_return - truth[choice.policy, asked], 1.96 * choice.error),
        "gain": (over.value - (value - single), over.margin),
    }
    if setting.risk < 1.0:
        return found
    some = drawn(np.full(n, setting.report / n), rng)
    believed, alone, true = routing.served, routing.believed[best], value - single
    for name, base, episodes, right in (
        ("V", believed, fresh[route, at], value),
        ("gain", believed - alone, fresh[route, at] - fresh[best], true),
    ):
        sampled = np.full_like(episodes, np.nan)
        sampled[some] = episodes[some]
        for how, one in (("fresh", episodes), ("sampled", sampled)):
            said, half = estimated(base, one, space.weights)
            assert half is not None
            found[f"{name}, {how}"] = said - right, half
    return found


def measured(setting: Setting, studies: int) -> dict[str, Array]:
    """Name -> (studies, 2) of `errors`."""
    found = [errors(setting, seed) for seed in range(studies)]
    return {name: np.array([one[name] for one in found]) for name in found[0]}


def settings() -> Iterator[Setting]:
    """All that are printed."""
    for targets, episodes, skewed in product((N, FEW), (2, 5, 20, 100), (False, True)):
        yield Setting(episodes, skewed, targets)
    for targets, episodes in product((N, FEW), (2, 5, 20)):
        yield Setting(episodes, True, targets, risk=0.1)


def reports() -> Iterator[Setting]:
    """Samples of more and more contexts."""
    for report in (30, 50, 100, 200, 400):
        yield Setting(5, True, 20, n=400, k=10, report=report)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--studies", type=int, default=400)
    parser.add_argument("--report", action="store_true")
    given = parser.parse_args()
    first = "played | " if given.report else ""
    print(f"| {first}episodes | returns | evaluated on | {' | '.join(WHAT)} | bias of V, running |")
    print("|---" * (4 + given.report + len(WHAT)) + "|")
    for setting in reports() if given.report else settings():
        found = measured(setting, given.studies)
        cells = ["-"] * len(WHAT)
        for i, name in enumerate(WHAT):
            if name in found:
                error, half = found[name].T
                cells[i] = f"{100 * np.mean(abs(error) <= half):.0f} (+- {half.mean():.3f})"
        bias, played = found["V, running"][:, 0].mean(), f"{setting.report} | " if first else ""
        print(f"| {played}{setting} | {' | '.join(cells)} | {bias:+.4f} |", flush=True)


if __name__ == "__main__":
    main()
