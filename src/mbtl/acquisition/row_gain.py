"""Gain in V of a whole new row, under a model of transfer.

Notation (shapes): M candidates, T targets.
    a(x) = sum_t w_t E[ (min(J(x, t), top_t) - best_t)_+ ]
closed for a Gaussian J: with e(m) = s (z Phi(z) + phi(z)) and z = m / s, the expectation is
e(E J - best) - e(E J - top).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mbtl.acquisition.gain import unit_improvement
from mbtl.arrays import Array
from mbtl.models.transfer_gp import TransferGP
from mbtl.models.transfer_kernel import NEW
from mbtl.objective import worst_share_mean

_DRAWS = 4000
"""Samples of a row: the standard error of a chance is below 0.01."""


@dataclass(frozen=True)
class RowGain:
    """What one more training may bring on T targets.

    Attributes:
        model: posterior of transfer.
        targets: (T,) context indices.
        best: (T,) generalisation performance so far.
        top: (T,) no policy is expected to do better, >= best.
        seen: best performance seen anywhere.
        weights: (T,) of the targets, sum 1.
        risk: share of the targets, the worst of them, that V is the mean of.
    """

    model: TransferGP
    targets: NDArray[np.intp]
    best: Array
    top: Array
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
        below = unit_improvement((mean - self.top) / std)
        return np.asarray(std * (unit_improvement((mean - self.best) / std) - below))

    def standard_error(self, candidate: int, n: int) -> float:
        """Of `expected`, the targets being a sample of `n`; 0 where they are all."""
        count = len(self.targets)
        if count >= n:
            return 0.0
        gain = self.by_target(np.array([candidate]))[0] * self.weights * count
        return float(gain.std(ddof=1) * np.sqrt((1.0 - count / n) / count))

    def said(self, source: int) -> float:
        """Expected gain of one training on `source`, for people; not to rank by.

        `expected` ranks well and promises too much: where each target is served as well as it can
        be, each still promises a little. Here nobody does better on a target than a training on the
        target itself would; whether those ceilings are high or low is drawn once for all targets.
        Picks by this gain were no better (docs/calibration.md).
        """
        return float(self.drawn(source).mean())

    def drawn(self, source: int) -> Array:
        """(n,) samples of that gain, always the same ones; their mean is `said`."""
        rng, own = np.random.default_rng(0), self.targets
        rows = self.model.draws(np.array([source]), own, _DRAWS, rng)[:, 0]
        mean, std = self.model.predict_pairs(np.column_stack([own, own, np.full(len(own), NEW)]))
        ceiling = mean + std * rng.standard_normal((_DRAWS, 1))
        return self._gained(np.minimum(rows, ceiling))

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
        some = replace(self, best=self.best[at], top=self.top[at], targets=targets, weights=weights)
        return float(np.mean(some._gained(drawn.max(axis=1)) >= least))

    def _gained(self, rows: Array) -> Array:
        """(n,) gains in V from samples of a row, none better than the best performance seen."""
        reached = np.maximum(np.minimum(rows, self.seen), self.best)
        return self._value(reached) - self._value(self.best)

    def _value(self, best: Array) -> Array:
        return worst_share_mean(best, self.weights, self.risk)
