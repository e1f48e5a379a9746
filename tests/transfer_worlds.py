"""Transfer data in closed form: what trainings of every kind return is a formula."""

from collections.abc import Callable, Sequence

import numpy as np

from mbtl.contexts import ContextSpace, Linear
from mbtl.objective import Bounds
from mbtl.zoo.benchmark.transfers import TransferData

MARKS = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 15.0)
PARENTS, UNITS = (1.0, 4.0), (0.5, 1.0)
EPISODES = 10

Everybody = Callable[[float, np.ndarray], np.ndarray]
"""Units and (N,) places to (N,) performance."""
Alone = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""(M, 1) sources and (N,) targets to (M, N) performance."""


def transfers(
    everybody: Everybody,
    gain: Alone,
    alone: Alone,
    *,
    n: int = 41,
    every: int = 2,
    noise: float = 0.0,
    seeds: Sequence[int] = (0,),
    name: str = "formula",
) -> TransferData:
    """Copies have their parent's row and `gain` (half of it after half a unit), floored at 0."""
    x = np.linspace(0.0, 1.0, n)
    sources = np.arange(0, n, every)
    home = x[sources][:, None]

    def measured(exact: np.ndarray, salt: int) -> np.ndarray:
        """(S, 2, ...) with independent noise in both halves."""
        luck = [
            np.random.default_rng((seed, salt)).normal(size=(2, *exact.shape)) for seed in seeds
        ]
        return exact + noise / np.sqrt(EPISODES) * np.array(luck)

    generalists = {u: measured(everybody(u, x), i) for i, u in enumerate(MARKS)}
    tuned = {
        (p, u): measured(everybody(p, x) + u * gain(home, x), 100 + 10 * i + j)
        for i, p in enumerate(PARENTS)
        for j, u in enumerate(UNITS)
    }
    specialists = measured(alone(home, x), 99)
    s, m = len(seeds), len(sources)
    return TransferData(
        name,
        ContextSpace.grid({Linear("x", 0.0, 1.0): n}),
        sources,
        Bounds(0.0, 1.0),
        (EPISODES, EPISODES),
        specialists,
        generalists,
        tuned,
        {
            "specialists": np.full((s, m, n), noise),
            "generalists": np.full((len(MARKS), s, n), noise),
            "tuned": np.full((len(tuned), s, m, n), noise),
        },
        {},
        1,
        ({},) * s,
    )


def bump(height: float, reach: float) -> Alone:
    """Highest at home, gone beyond `reach`."""
    return lambda home, x: height * np.maximum(1.0 - np.abs(home - x) / reach, 0.0)


def rising(end: float, start: float, tilt: float = 0.1) -> Everybody:
    """From `start` at a quarter of a unit towards `end`, the rest halved by every doubling."""
    return lambda units, x: end - (end - start) * 0.25 / units - tilt * np.abs(x - 0.5)


def one_policy_suffices(**how):
    """The policy for all comes near to 1; specialists reach .8 and not far."""
    return transfers(rising(1.0, 0.2, 0.02), bump(0.02, 0.2), bump(0.8, 0.3), **how)


def tuning_pays(**how):
    """The policy for all stays near .55; copies add up to .4 at home and reach a tenth."""
    return transfers(
        rising(0.55, 0.5), bump(0.4, 0.15), lambda home, x: 0.75 - 1.5 * np.abs(home - x), **how
    )


def one_for_all_fails(**how):
    """Half of the contexts turn the meaning of an action; one policy serves neither half."""

    def alone(home, x):
        same = (home < 0.5) == (x < 0.5)
        return np.where(same, 0.9 - 0.6 * np.abs(home - x), 0.1)

    return transfers(rising(0.3, 0.28, 0.0), bump(0.1, 0.05), alone, **how)
