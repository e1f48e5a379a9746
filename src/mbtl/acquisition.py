"""Acquisition: how much would the portfolio gain if we trained at x next?

Formulas over posteriors, and the argmax over a finite set. All are O(M N) time in blocks of bounded
memory, for any D. Notation (shapes): M candidates, N targets, D columns of grid steps.

    upper       (M,)    optimistic training performance mu(x) + sqrt(beta) sigma(x)
    mean, std   (M,)    posterior of the training performance
    candidates  (M, D)  where we could train;  targets (N, D)  where policies will run
    best        (N,)    generalisation performance so far
    weights     (N,)    target weights, sum 1
    theta               slope of the linear gap, performance per grid step
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np

from mbtl.arrays import Array, Indices, Mask
from mbtl.errors import InvalidInput
from mbtl.models.linear_trend import LinearTrend
from mbtl.models.transfer_gp import TransferGP
from mbtl.models.transfer_kernel import NEW
from mbtl.objective import worst_share_mean

__all__ = ["TIE", "RowGain", "argmax_open", "expected_gain", "optimistic_gain", "unit_improvement"]

TIE = 1e-12
"""Values closer than this are equal: two exact formulas may differ in their last digits."""

# candidate x target entries held at once, so that temporaries stay in cache: one array for the
# optimistic gain, four for the expected one
_BLOCK_ENTRIES = 1 << 18
_EXPECTED_BLOCK_ENTRIES = 1 << 14


def optimistic_gain(
    upper: Array, candidates: Array, targets: Array, best: Array, weights: Array, *, theta: float
) -> Array:
    """Gain in V if training at x turned out as well as `upper` and decayed linearly.

    a(x) = sum_t w_t [ upper(x) - theta |x - t| - best(t) ]_+        (paper, eq. 4)

    Returns:
        (M,) gain in units of performance; 0 where no target would improve.

    Raises:
        InvalidInput: theta is negative or not finite.
    """

    def block(rows: slice, gap: Array) -> Array:
        gain = np.subtract(upper[rows, None], gap, out=gap)  # in place: memory traffic is the cost
        gain -= best
        np.maximum(gain, 0.0, out=gain)
        return np.asarray(gain @ weights)

    return _blocked(block, candidates, targets, theta, _BLOCK_ENTRIES)


def expected_gain(
    mean: Array,
    std: Array,
    candidates: Array,
    targets: Array,
    best: Array,
    weights: Array,
    *,
    theta: float,
) -> Array:
    """Expected gain in V, the training performance being Gaussian and the gap linear.

    a(x) = sum_t w_t ( m Phi(m/s) + s phi(m/s) ),  m = mean(x) - theta |x - t| - best(t)

    with s = std(x), and max(m, 0) where s = 0. Source: method, section 2 (EI).

    Returns:
        (M,) expected gain in units of performance.

    Raises:
        InvalidInput: theta is negative or not finite.
    """
    scale = np.maximum(std, 1e-300)

    def block(rows: slice, gap: Array) -> Array:
        m = mean[rows, None] - gap - best
        return np.asarray(scale[rows] * (unit_improvement(m / scale[rows, None]) @ weights))

    return _blocked(block, candidates, targets, theta, _EXPECTED_BLOCK_ENTRIES)


def unit_improvement(z: Array) -> Array:
    """E[(z + standard normal)_+] = z Phi(z) + phi(z), without cancellation below zero."""
    from scipy.special import erfcx  # kept out of `import mbtl`

    # the gain at z is z more than at -z; there Phi(-a) = phi(a) sqrt(pi/2) erfcx(a / sqrt 2), so
    # that both terms share the factor phi(a)
    a = np.minimum(np.abs(z), 40.0)
    tail = 1.0 - a * np.sqrt(np.pi / 2.0) * erfcx(a / np.sqrt(2.0))
    tail *= np.exp(-0.5 * a * a) / np.sqrt(2.0 * np.pi)
    return np.asarray(np.maximum(tail, 0.0) + np.maximum(z, 0.0))


def argmax_open(values: Array, mask: Mask) -> int:
    """Index of the largest value among the open ones; the lowest index on a tie.

    Raises:
        InvalidInput: nothing is open, or a value is NaN.
    """
    if not mask.any():
        raise InvalidInput("argmax needs at least one open candidate, got none")
    if np.isnan(values[mask]).any():
        raise InvalidInput("argmax needs values that are numbers, got NaN")
    open_values: Array = np.where(mask, values, -np.inf)
    top = open_values.max()
    return int(np.flatnonzero(open_values >= top - TIE * max(1.0, abs(float(top))))[0])


def _blocked(
    block: Callable[[slice, Array], Array],
    candidates: Array,
    targets: Array,
    theta: float,
    entries: int,
) -> Array:
    """Run `block(rows, gap)` over blocks of candidates; gap is (rows, N)."""
    from scipy.spatial.distance import cdist  # kept out of `import mbtl`

    if not (np.isfinite(theta) and theta >= 0):
        raise InvalidInput(f"theta must be finite and >= 0, got {theta!r}")
    out = np.empty(len(candidates))
    size = max(entries // max(len(targets), 1), 1)
    sources, ends = theta * candidates, theta * targets  # distances come scaled
    for start in range(0, len(candidates), size):
        rows = slice(start, start + size)
        out[rows] = block(rows, cdist(sources[rows], ends))
    return out


# ---- of whole rows, under a model of transfer ---------------------------------------------------


_CEILINGS = 7
"""Points at which the height of the ceilings is taken (Gauss-Hermite)."""
_DRAWS = 4000
"""Samples of a row: the standard error of a chance is below 0.01."""


@dataclass(frozen=True)
class RowGain:
    """What one more training may bring on T targets: gain in V of a whole new row.

    a(x) = sum_t w_t E[ (min(J(x, t), c_t, seen) - best_t)_+ ]

    Nobody does better on a target than a training on the target itself would, c_t, nor than the
    best performance seen anywhere. Whether the ceilings c_t are high or low is drawn once for all
    targets. Without them each target would still promise a little where it is served as well as it
    can be.

    For a Gaussian J and a given ceiling the expectation is closed: with e(m) = s (z Phi(z) +
    phi(z)) and z = m / s it is e(E J - best) - e(E J - top), top = max(min(c, seen), best). The
    mean over the ceilings is a sum over a few of them.

    Attributes:
        model: posterior of transfer.
        targets: (T,) context indices.
        best: (T,) generalisation performance so far.
        seen: best performance seen anywhere; inf: the model is trusted beyond it, then there are no
            ceilings either.
        weights: (T,) of the targets, sum 1.
        risk: share of the targets, the worst of them, that V is the mean of.
    """

    model: TransferGP | LinearTrend
    targets: Indices
    best: Array
    seen: float
    weights: Array
    risk: float = 1.0

    def expected(self, candidates: Indices) -> Array:
        """(M,) expected gain of each candidate; with a risk, the gain of what is expected."""
        gain = self.by_target(candidates)
        if self.risk == 1.0:
            return np.asarray(gain @ self.weights)
        return self._value(self.best + gain) - self._value(self.best)

    def by_target(self, candidates: Indices) -> Array:
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

    def chance_together(self, sources: Indices, targets: Indices, least: float) -> float:
        """Probability that trainings on all of M sources together gain `least` or more.

        Without those ceilings, so that a study ends rather too late than too early.

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
