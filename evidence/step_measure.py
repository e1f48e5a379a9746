"""What a strategy's V against all-in steps says: steps to a share of the way, area, intervals.

Steps are counted in *units*: what one whole training on a random context costs, all in, with an
evaluation on all targets. So problems can be pooled, and 30 units are what 30 picks cost.

Notation (shapes): S seeds, E events of a run.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from mbtl.arrays import Array
from mbtl.zoo.benchmark.base import Levels, levels
from mbtl.zoo.benchmark.comparison import RESAMPLES, SHARES
from mbtl.zoo.benchmark.oracle import sequential_oracle
from mbtl.zoo.benchmark.steps import StepWorld

BUDGET = 30.0
"""Units that every strategy may spend."""
LEAST = 0.1
"""Units at which the area begins."""
_POINTS = 200
_TIE = 1e-9
PAPER_EPISODES = 100


@dataclass(frozen=True)
class StepScale:
    """What steps and V of one seed are measured against.

    Attributes:
        unit: steps of one whole training with its evaluation, mean over sources.
        paper: of the same by the paper's protocol: no early end, no checks, 100 episodes.
        low: V of one random policy of a whole training.
        high: Oracle Transfer of whole trainings.
        oracle: (K,) V of the Sequential Oracle of whole trainings.
        oracle_spent: (K,) what its trainings cost, with their evaluations.
        oracle_trained: (K,) what they cost without.
    """

    unit: float
    paper: float
    low: float
    high: float
    oracle: Array
    oracle_spent: Array
    oracle_trained: Array

    @classmethod
    def of(cls, world: StepWorld) -> StepScale:
        """Of one seed."""
        matrix = world.curves.matrix(-1, world.kind)
        known: Levels = levels(matrix, world.seed)
        rows = world.episode_steps[-1].sum(axis=1)  # (M,) of one episode on every target
        whole = world.training_price[-1] + rows * world.curves.episodes[0]
        paper = float(world.lengths[-1] + rows.mean() * PAPER_EPISODES)
        picks = min(int(BUDGET), len(whole))
        oracle = sequential_oracle(matrix, world.seed, picks)
        taken = [world.row(s) for s in oracle.sources]
        return cls(
            unit=float(whole.mean()),
            paper=paper,
            low=known.grand_mean,
            high=known.oracle_transfer,
            oracle=oracle.curve,
            oracle_spent=np.cumsum(whole[taken]),
            oracle_trained=np.cumsum(world.training_price[-1, taken]),
        )

    @property
    def budget(self) -> float:
        """Steps that every strategy may spend."""
        return BUDGET * self.unit

    def share(self, value: Array) -> Array:
        """V as a share of the way from one random policy to Oracle Transfer."""
        return np.asarray((value - self.low) / (self.high - self.low))

    def to_levels(self, spent: Array, value: Array) -> Array:
        """(3,) units until V has gone 90, 95 and 99 % of the way; infinite: not within budget."""
        return np.array([self.to(spent, value, share) for share in SHARES])

    def to(self, spent: Array, value: Array, share: float) -> float:
        """Units until V has gone a share of the way; infinite: not within the budget."""
        there = np.flatnonzero(self.share(value) >= share - _TIE)
        return float(spent[there[0]] / self.unit) if len(there) else np.inf

    def area(self, spent: Array, value: Array) -> float:
        """Mean share, at least 0, over the logarithm of steps from 0.1 to 30 units."""
        at = np.geomspace(LEAST, BUDGET, _POINTS) * self.unit
        position = np.searchsorted(spent, at * (1 + 1e-12), side="right")
        share = np.concatenate([[0.0], np.maximum(self.share(value), 0.0)])
        return float(share[position].mean())


def geometric_mean(values: ArrayLike) -> float:
    """Of positive numbers."""
    return float(np.exp(np.mean(np.log(values))))


def paired_interval(differences: Mapping[str, Array]) -> tuple[float, float, float]:
    """Mean over sets of the mean over seeds, and its 95 % interval: seeds of each set drawn again.

    Args:
        differences: (S,) by set, of two strategies on the same seeds.
    """
    rng = np.random.default_rng(0)
    drawn = np.zeros(RESAMPLES)
    for values in differences.values():
        size = (RESAMPLES, len(values))
        drawn += np.asarray(values)[rng.integers(0, len(values), size)].mean(axis=1)
    low, high = np.quantile(drawn / len(differences), [0.025, 0.975])
    mean = float(np.mean([values.mean() for values in differences.values()]))
    return mean, float(low), float(high)
