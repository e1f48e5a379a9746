"""Acquisition: how much would the portfolio gain if we trained at x next? The direct formulas.

Notation (shapes): M candidates, N targets, D columns of grid steps.
    upper       (M,)    optimistic training performance mu(x) + sqrt(beta) sigma(x)
    mean, std   (M,)    posterior of the training performance
    candidates  (M, D)  where we could train;  targets (N, D)  where policies will run
    best        (N,)    generalisation performance so far
    weights     (N,)    target weights, sum 1
    theta               slope of the linear gap, performance per grid step
All are O(M N) time in blocks of bounded memory, for any D.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from mbtl.arrays import Array
from mbtl.errors import InvalidInput

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
        InvalidInput: theta < 0, or shapes that do not fit.
    """
    _check_shapes(candidates, targets, best, weights, theta, upper=upper)

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
        InvalidInput: theta < 0, or shapes that do not fit.
    """
    _check_shapes(candidates, targets, best, weights, theta, mean=mean, std=std)
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


def argmax_open(values: Array, mask: NDArray[np.bool_]) -> int:
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

    out = np.empty(len(candidates))
    size = max(entries // max(len(targets), 1), 1)
    sources, ends = theta * candidates, theta * targets  # distances come scaled
    for start in range(0, len(candidates), size):
        rows = slice(start, start + size)
        out[rows] = block(rows, cdist(sources[rows], ends))
    return out


def _check_shapes(
    candidates: Array,
    targets: Array,
    best: Array,
    weights: Array,
    theta: float,
    **per_candidate: Array,
) -> None:
    """Raise `InvalidInput` unless the arrays fit together and theta >= 0."""
    m, n = len(candidates), len(targets)
    if not (np.isfinite(theta) and theta >= 0):
        raise InvalidInput(f"theta must be finite and >= 0, got {theta!r}")
    if candidates.ndim != 2 or targets.ndim != 2 or candidates.shape[1] != targets.shape[1]:
        raise InvalidInput(
            f"candidates and targets must be (M, D) and (N, D), got {candidates.shape}, "
            f"{targets.shape}"
        )
    if best.shape != (n,) or weights.shape != (n,):
        raise InvalidInput(f"best and weights must be ({n},), got {best.shape} and {weights.shape}")
    for name, array in per_candidate.items():
        if array.shape != (m,):
            raise InvalidInput(f"{name} must be ({m},), got {array.shape}")
