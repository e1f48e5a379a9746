"""Transfer data in closed form: what trainings of every kind return is a formula."""

import numpy as np

from mbtl.contexts import ContextSpace, Linear
from mbtl.objective import Bounds
from mbtl.zoo.benchmark.transfers import TransferData

N, SOURCES = 41, np.arange(0, 41, 2)
X = np.linspace(0.0, 1.0, N)
MARKS = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 15.0)
PARENTS, UNITS = (1.0, 4.0), (0.5, 1.0)
EPISODES = (10, 10)


def transfers(everybody, gain, alone, *, noise=0.0, seeds=(0,)):
    """Copies have their parent's row and `gain` (half of it after half a unit), floored at 0.

    Args:
        everybody: units and (N,) places to (N,) performance.
        gain, alone: (M, 1) sources and (N,) targets to (M, N) performance.
        noise: of one episode.
        seeds: one matrix each.
    """
    home, s, m = X[SOURCES][:, None], len(seeds), len(SOURCES)

    def measured(exact, salt):
        """(S, 2, ...) with independent noise in both halves."""
        luck = [np.random.default_rng((z, salt)).normal(size=(2, *exact.shape)) for z in seeds]
        return exact + noise / np.sqrt(EPISODES[0]) * np.array(luck)

    generalists = {u: measured(everybody(u, X), i) for i, u in enumerate(MARKS)}
    tuned = {
        (p, u): measured(everybody(p, X) + u * gain(home, X), 100 + 10 * i + j)
        for i, p in enumerate(PARENTS)
        for j, u in enumerate(UNITS)
    }
    shapes = {"specialists": (s, m, N), "generalists": (7, s, N), "tuned": (len(tuned), s, m, N)}
    return TransferData(
        "formula", ContextSpace.grid({Linear("x", 0.0, 1.0): N}), SOURCES, Bounds(0.0, 1.0),
        EPISODES, measured(alone(home, X), 99), generalists, tuned,
        {kind: np.full(shape, noise) for kind, shape in shapes.items()}, {}, 1, ({},) * s,
    )  # fmt: skip


def bump(height, reach):
    """Highest at home, gone beyond `reach`."""
    return lambda home, x: height * np.maximum(1.0 - np.abs(home - x) / reach, 0.0)


def rising(end, start, tilt=0.1):
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
