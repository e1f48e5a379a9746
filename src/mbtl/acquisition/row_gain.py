"""Gain in V of a whole new row, under a model of transfer.

Notation (shapes): M candidates, T targets.
    a(x) = sum_t w_t E[ (min(J(x, t), c_t, seen) - best_t)_+ ]
Nobody does better on a target than a training on the target itself would, c_t, nor than the best
performance seen anywhere. Whether the ceilings c_t are high or low is drawn once for all targets.
Without them each target would still promise a little where it is served as well as it can be.

For a Gaussian J and a given ceiling the expectation is closed: with e(m) = s (z Phi(z) + phi(z))
and z = m / s it is e(E J - best) - e(E J - top), top = max(min(c, seen), best). The mean over the
ceilings is a sum over a few of them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from mbtl.acquisition.gain import unit_improvement
from mbtl.arrays import Array
from mbtl.models.transfer_kernel import NEW, Pairs
from mbtl.objective import worst_share_mean

_CEILINGS = 7
"""Points at which the height of the ceilings is taken (Gauss-Hermite)."""
_DRAWS = 4000
"""Samples of a row: the standard error of a chance is below 0.01."""


class RowModel(Protocol):
    """A posterior of rows, such as `mbtl.models.TransferGP`."""

    def predict(self, sources: Pairs, targets: Pairs, /) -> tuple[Array, Array]:
        """Mean and standard deviation (M, T) of J for new trainings."""

    def predict_pairs(self, pairs: Pairs, /) -> tuple[Array, Array]:
        """Mean and standard deviation (m,) of J at pairs (m, 3)."""

    def draws(self, sources: Pairs, targets: Pairs, n: int, rng: np.random.Generator, /) -> Array:
        """(n, M, T) samples of the rows of new trainings."""


@dataclass(frozen=True)
class RowGain:
    """What one more training may bring on T targets.

    Attributes:
        model: posterior of transfer.
        targets: (T,) context indices.
        best: (T,) generalisation performance so far.
        seen: best performance seen anywhere; inf: the model is trusted beyond it, then there are no
            ceilings either.
        weights: (T,) of the targets, sum 1.
        risk: share of the targets, the worst of them, that V is the mean of.
    """

    model: RowModel
    targets: NDArray[np.intp]
    best: Array
    seen: float
    weights: Array
    risk: float = 1.0

    def expected(self, candidates: NDArray[np.intp]) -> Array:
        """(M,) expected gain of each candidate; with a risk, the gain of what is expected."""
        gain = self.by_target(candidates)
        if self.risk == 1.0:
            return np.asarray(gain @ self.weights)
        return self._value(self.best + gain) - self._value(self.best)

    def by_target(self, candidates: NDArray[np.intp]) -> Array:
        """(M, T) expected gain of each candidate on each target, without weights."""
        mean, std = self.model.predict(candidates, self.targets)
        gain = unit_improvement((mean - self.best) / std)
        if np.isinf(self.seen):
            return np.asarray(std * gain)
        for height, weight in zip(*_quadrature(), strict=True):
            gain -= weight * unit_improvement((mean - self._top(height)) / std)
        return np.asarray(np.maximum(std * gain, 0.0))

    def standard_error(self, candidate: int, n: int) -> float:
        """Of `expected`, the targets being a sample of `n`; 0 where they are all."""
        count = len(self.targets)
        if count >= n:
            return 0.0
        gain = self.by_target(np.array([candidate]))[0] * self.weights * count
        return float(gain.std(ddof=1) * np.sqrt((1.0 - count / n) / count))

    def drawn(self, source: int) -> Array:
        """(n,) samples of the gain of one training on `source`, always the same ones."""
        rng = np.random.default_rng(0)
        rows = self.model.draws(np.array([source]), self.targets, _DRAWS, rng)[:, 0]
        return self._gained(np.minimum(rows, self._top(rng.standard_normal((_DRAWS, 1)))))

    def chance(self, source: int, least: float) -> float:
        """Probability that one training on `source` gains `least` or more.

        Without those ceilings, so that a study ends rather too late than too early.
        """
        return self.chance_together(np.array([source]), self.targets, least)

    def chance_together(
        self, sources: NDArray[np.intp], targets: NDArray[np.intp], least: float
    ) -> float:
        """Probability that trainings on all of M sources together gain `least` or more.

        Args:
            sources: (M,) contexts, one training on each.
            targets: (T,) some of the targets, which stand for all; M T samples are drawn jointly.
            least: gain in V.
        """
        drawn = self.model.draws(sources, targets, _DRAWS, np.random.default_rng(0))
        at = np.searchsorted(self.targets, targets)
        weights = self.weights[at] / self.weights[at].sum()
        some = replace(self, best=self.best[at], targets=targets, weights=weights)
        return float(np.mean(some._gained(drawn.max(axis=1)) >= least))

    @cached_property
    def _ceilings(self) -> tuple[Array, Array]:
        """Mean and standard deviation (T,) of what a training on each target gives there."""
        own = self.targets
        return self.model.predict_pairs(np.column_stack([own, own, np.full(len(own), NEW)]))

    def _top(self, height: float | Array) -> Array:
        """No policy does better on the targets if ceilings are so many deviations high."""
        if np.isinf(self.seen):
            return np.asarray(self.seen)
        mean, std = self._ceilings
        return np.asarray(np.maximum(np.minimum(mean + height * std, self.seen), self.best))

    def _gained(self, rows: Array) -> Array:
        """(n,) gains in V from samples of a row, none better than the best performance seen."""
        reached = np.maximum(np.minimum(rows, self.seen), self.best)
        return self._value(reached) - self._value(self.best)

    def _value(self, best: Array) -> Array:
        return worst_share_mean(best, self.weights, self.risk)


@cache
def _quadrature() -> tuple[list[float], list[float]]:
    """Points of a standard normal variable, and their weights."""
    points, weights = np.polynomial.hermite_e.hermegauss(_CEILINGS)
    return points.tolist(), (weights / weights.sum()).tolist()
