"""A linear trend of transfer: performance in straight lines along every axis, and scatter.

    J(s, t) = c + a s + b t + sum_q bend_q |s_q - t_q| + e,    e independent of pair to pair

a is how source quality changes along the axes, b how target difficulty does, bend how performance
falls (or rises) with distance. With D = s - t this holds every world that is linear in s, in t, in
min(D, 0) and in max(D, 0), the gap of `mbtl.models.DirectionalGap` among them. Where the world is
one of those, a few rows settle every slope, also far from what was tried; a Gaussian process of
rows needs many, and takes scatter for structure.

Notation (shapes): n observed pairs, M sources, T targets, D columns of grid steps.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbtl.arrays import Array
from mbtl.models.directional_gap import DirectionalGap
from mbtl.models.transfer_kernel import Pairs

_SINGULAR = 1e-10
"""Directions of the design weaker than this are not seen."""
_LEAST = 1e-12
"""Scatter of a perfect fit, as a share of the variance of the data; it is divided by."""


@dataclass(frozen=True, eq=False)
class LinearTrend:
    """Slopes fitted to some pairs; predicts pairs as `mbtl.models.TransferGP` does.

    The scatter e is something real that pairs have: it is part of every deviation here.

    Attributes:
        steps: (N, D) of all contexts.
        level: c.
        difficulty: (D,) b.
        source_and_gap: a and bend, as a gap: its tilt is a.
        scatter: standard deviation of e.
        log_likelihood: of the data, less half a logarithm of n for every number fitted (BIC), so
            that it compares with a marginal likelihood; -inf while the rows leave a slope open.
    """

    steps: Array
    level: float
    difficulty: Array
    source_and_gap: DirectionalGap
    scatter: float
    log_likelihood: float

    def predict(self, sources: Pairs, targets: Pairs) -> tuple[Array, Array]:
        """Mean and standard deviation (M, T) of J."""
        tilted = self.source_and_gap.between(self.steps[sources], self.steps[targets])
        mean = self.level + tilted + self._by_target(targets)
        return mean, np.full(mean.shape, self.scatter)

    def predict_pairs(self, pairs: Pairs) -> tuple[Array, Array]:
        """Mean and standard deviation (m,) of J at `pairs` (m, 3)."""
        gap, source, target = self.source_and_gap, self.steps[pairs[:, 0]], self.steps[pairs[:, 1]]
        change = (source - target) @ gap.tilt + np.abs(source - target) @ gap.bend
        mean = self.level + change + self._by_target(pairs[:, 1])
        return mean, np.full(len(pairs), self.scatter)

    def draws(self, sources: Pairs, targets: Pairs, n: int, rng: np.random.Generator) -> Array:
        """(n, M, T) samples of the rows of new trainings, one on each of M sources."""
        mean = self.predict(sources, targets)[0]
        return mean + self.scatter * rng.standard_normal((n, *mean.shape))

    def believed(self, sources: Pairs, targets: Pairs, rows: Array, known: Array | None) -> Array:
        """(M, T) true performance of policies whose rows were seen.

        Noisy entries are drawn to the trend; what was not evaluated is on it.

        Args:
            sources: (M,) contexts trained on.
            targets: (T,) contexts evaluated on.
            rows: (M, T) performance; NaN where it was not evaluated.
            known: (M, T) variance of each entry around the true mean return; None for none.
        """
        mean = self.predict(sources, targets)[0]
        noise = 0.0 if known is None else np.nan_to_num(known)
        share = self.scatter**2 / (self.scatter**2 + noise)
        return np.asarray(np.where(np.isfinite(rows), mean + share * (rows - mean), mean))

    def _by_target(self, targets: Pairs) -> Array:
        # the gap's tilt counts s - t, the trend s alone
        return np.asarray(self.steps[targets] @ (self.difficulty + self.source_and_gap.tilt))


def fit_linear_trend(
    steps: Array, pairs: Pairs, y: Array, known: Array | None = None
) -> LinearTrend:
    """Slopes by least squares over the observed pairs.

    Args:
        steps: (N, D) of all contexts.
        pairs: (n, 3) observed, n >= 1.
        y: (n,) performance there.
        known: (n,) variance of each y around the true mean return; None for none. It is no scatter.
    """
    source, target, n = steps[pairs[:, 0]], steps[pairs[:, 1]], len(y)
    design = np.hstack([source, target, np.abs(source - target)])
    middle, mean = design.mean(axis=0), float(y.mean())
    slopes, _, rank, _ = np.linalg.lstsq(design - middle, y - mean, rcond=_SINGULAR)
    left = y - mean - (design - middle) @ slopes
    least = _LEAST * max(float(y.var()), _LEAST)
    variance = max(float(left @ left) / n, least)
    noise = 0.0 if known is None else float(known.mean())
    fitted = len(slopes) + 2  # slopes, level and scatter
    likely = -0.5 * n * (np.log(2.0 * np.pi * variance) + 1.0) - 0.5 * fitted * np.log(n)
    a, b, bend = np.split(slopes, 3)
    return LinearTrend(
        steps,
        mean - float(middle @ slopes),
        b,
        DirectionalGap(a - bend, a + bend),
        float(np.sqrt(max(variance - noise, least))),
        float(likely) if rank == len(slopes) else -np.inf,
    )
