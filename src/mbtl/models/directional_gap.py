"""A gap with a sign and a direction: how performance changes from a source to a target.

    J(x, y) ~ w0 + sum_q left_q min(D_q, 0) + right_q max(D_q, 0),    D = x - y

left_q is the change of performance per grid step while the source lies below the target on axis q,
right_q while it lies above. Where return falls both ways left_q > 0 > right_q; where going one way
is a gain both have one sign. Source: SD-MBTL (AAAI 2026), the gap model of its GP-MBTL.

Notation (shapes): k rows observed, M candidates, N targets, D columns of grid steps.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbtl.arrays import Array

_BLOCK_ENTRIES = 1 << 18  # candidate x target entries held at once: three arrays of 2 MiB
_SINGULAR = 1e-10  # directions of the design weaker than this are not seen: their slope is 0


@dataclass(frozen=True, eq=False)
class DirectionalGap:
    """Slopes of the piecewise linear gap, performance per grid step.

    Attributes:
        left: (D,) slope of min(D_q, 0).
        right: (D,) slope of max(D_q, 0).
    """

    left: Array
    right: Array

    @property
    def tilt(self) -> Array:
        """(D,) what both sides share: a linear trend, left min + right max = tilt D + bend |D|."""
        return np.asarray(0.5 * (self.left + self.right))

    @property
    def bend(self) -> Array:
        """(D,) slope of |D_q|; below 0 where return falls with distance."""
        return np.asarray(0.5 * (self.right - self.left))

    def between(self, sources: Array, targets: Array) -> Array:
        """(m, D), (N, D) -> (m, N) change of performance from each source to each target."""
        trend = (sources @ self.tilt)[:, None] - targets @ self.tilt
        return np.asarray(trend + _weighted_distance(sources, targets, self.bend))

    def gain(
        self, upper: Array, candidates: Array, targets: Array, best: Array, weights: Array
    ) -> Array:
        """Gain in V if training at x turned out as `upper` says and transferred by this gap.

        a(x) = sum_t w_t [ upper(x) + gap(x, t) - best(t) ]_+

        O(M N D) time in blocks of bounded memory.

        Args:
            upper: (M,) optimistic training performance.
            candidates: (M, D) grid steps.
            targets: (N, D) grid steps.
            best: (N,) performance that has to be beaten.
            weights: (N,) target weights, sum 1.

        Returns:
            (M,) gain in units of performance.
        """
        lifted = upper + candidates @ self.tilt  # the trend splits into a part of x and one of t
        bar = best + targets @ self.tilt
        gain = np.empty(len(candidates))
        size = max(_BLOCK_ENTRIES // max(len(targets), 1), 1)
        for start in range(0, len(candidates), size):
            rows = slice(start, start + size)
            reached = _weighted_distance(candidates[rows], targets, self.bend)
            reached += lifted[rows, None]
            reached -= bar
            np.maximum(reached, 0.0, out=reached)
            gain[rows] = reached @ weights
        return gain


def fit_directional_gap(
    sources: Array, targets: Array, rows: Array, *, per_target: bool = False
) -> DirectionalGap:
    """Slopes by least squares over every observed entry; the intercept is dropped.

    With one intercept for all, as published, the slopes also take up what source quality and target
    difficulty have of a linear trend. With one per target, difficulty drops out. Directions that no
    entry shows get slope 0.

    Args:
        sources: (k, D) grid steps of the trained contexts.
        targets: (N, D) grid steps.
        rows: (k, N) performance; NaN (not evaluated) is left out.
        per_target: an intercept for each target; then a target seen once tells nothing.
    """
    n, columns = targets.shape
    seen = np.isfinite(rows)
    middle = rows[seen].mean() if seen.any() else 0.0  # large common levels would cost digits
    normal, moment = np.zeros((2 * columns, 2 * columns)), np.zeros(2 * columns)
    counts, design_sums, sums = np.zeros(n), np.zeros((n, 2 * columns)), np.zeros(n)
    for source, row, known in zip(sources, rows, seen, strict=True):
        difference = source - targets[known]
        design = np.hstack([np.minimum(difference, 0.0), np.maximum(difference, 0.0)])
        value = row[known] - middle
        normal += design.T @ design
        moment += design.T @ value
        counts[known] += 1.0
        design_sums[known] += design
        sums[known] += value
    if not per_target:
        counts, sums = counts.sum(keepdims=True), sums.sum(keepdims=True)
        design_sums = design_sums.sum(axis=0, keepdims=True)
    means = design_sums / np.maximum(counts, 1.0)[:, None]  # an intercept centres its own entries
    normal -= means.T @ design_sums
    moment -= means.T @ sums
    slopes: Array = np.asarray(np.linalg.lstsq(normal, moment, rcond=_SINGULAR)[0], np.float64)
    return DirectionalGap(slopes[:columns], slopes[columns:])


def _weighted_distance(a: Array, b: Array, slopes: Array) -> Array:
    """(M, D), (N, D) -> (M, N) sum_q slopes_q |a_q - b_q|, slopes of either sign."""
    from scipy.spatial.distance import cdist  # kept out of `import mbtl`

    total = np.zeros((len(a), len(b)))
    for sign in (1.0, -1.0):
        axes = sign * slopes > 0
        if axes.any():
            scale = sign * slopes[axes]
            total += sign * cdist(a[:, axes] * scale, b[:, axes] * scale, "cityblock")
    return total
