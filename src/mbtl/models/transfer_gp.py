"""Gaussian process of transfer: every evaluated (source, target) pair is an observation.

The kernel, and what its terms mean, is in `mbtl.models.transfer_kernel`. All are scaled by one
factor fitted to the data. Known noise of an observation may come on top of its own scatter e.

Notation (shapes): n observed pairs, m queried pairs.
    pairs (n, 3)  indices (source, target) and number of the training; `NEW` is one not done yet
    K     (n, n)  prior covariance of the observed pairs, noise included, before the factor
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from mbtl.arrays import Array
from mbtl.errors import InvalidInput
from mbtl.models.transfer_kernel import (
    NEW,
    Pairs,
    Places,
    TransferPrior,
    covariance,
    grid_pairs,
    same_pair,
    variance,
)
from mbtl.processes import threads_for

_SHRINK = 2.0
"""Observations that the prior scale is worth."""
_USUAL = 0.05
"""Prior scale: variance of performance between pairs."""
_ROUNDS = 12
"""At most so many fits to find the factor beside a known noise."""
_SHARES = (0.0, 0.1, 0.3, 1.0)
_NOISIER = 50.0
"""How many times the usual own scatter of pairs is that of pairs that are noisy themselves."""
ENOUGH = 300
"""Observations that decide how noisy the others are."""
_BLOCK_ENTRIES = 1 << 20


class TransferGP:
    """The posterior given some rows.

    Attributes:
        mean: mu, fitted by generalised least squares.
        scale: the factor of all variances.
        log_likelihood: of the data, the mean and the factor fitted.
    """

    def __init__(
        self,
        places: Places,
        prior: TransferPrior,
        pairs: Pairs,
        y: Array,
        noise: Array | None = None,
    ) -> None:
        """Condition on data; O(n^3).

        Args:
            places: of all contexts.
            prior: of the terms.
            pairs: (n, 3) observed.
            y: (n,) performance there, finite.
            noise: (n,) variance of each y around the true mean return, or (n, n) covariance; None
                for none.

        Raises:
            InvalidInput: no pair, or values that are not finite.
            numpy.linalg.LinAlgError: K is singular.
        """
        if len(y) < 1 or len(pairs) != len(y) or not np.isfinite(y).all():
            raise InvalidInput(
                f"a transfer GP needs finite values of n >= 1 pairs, got shapes {pairs.shape} and "
                f"{y.shape}; drop what was not evaluated"
            )
        self._places, self._prior, self._pairs = places, prior, pairs
        with threads_for(len(places.x)):
            kernel = covariance(places, prior, pairs, pairs)
            fit = _fit(kernel, prior.noise, y, noise)
        self._chol, self._residual, self._ones = fit.chol, fit.residual, fit.ones
        self.mean, self.scale, self.log_likelihood = fit.mean, fit.scale, fit.log_likelihood

    def predict(
        self, sources: Pairs, targets: Pairs, trainings: Pairs | None = None
    ) -> tuple[Array, Array]:
        """Mean and standard deviation (M, T) of J, without noise.

        Args:
            sources: (M,) contexts trained on.
            targets: (T,) contexts evaluated on.
            trainings: (M,) numbers of trainings done; None: all are new ones, whose luck is drawn
                again also where the source was trained before.
        """
        mean, std = np.empty((2, len(sources), len(targets)))
        numbers = np.full(len(sources), NEW) if trainings is None else trainings
        for rows in _blocks(len(sources), len(targets) * len(self._pairs)):
            found = self.predict_pairs(grid_pairs(sources[rows], targets, numbers[rows]))
            mean[rows], std[rows] = (values.reshape(-1, len(targets)) for values in found)
        return mean, std

    def predict_pairs(self, pairs: Pairs) -> tuple[Array, Array]:
        """Mean and standard deviation (m,) of J at `pairs` (m, 3), without noise; O(n^2 m)."""
        half = half_solved(self._chol, covariance(self._places, self._prior, self._pairs, pairs))
        own = variance(self._prior)
        left = np.maximum(own - np.einsum("ij,ij->j", half, half), 1e-9 * own)
        return self.mean + half.T @ self._residual, np.sqrt(self.scale * left)

    def returns_at(self, pairs: Pairs) -> tuple[Array, Array]:
        """Mean and standard deviation (m,) of the true mean returns at `pairs`, own scatter e too.

        Unlike `predict_pairs`, e counts as something real that pairs have, observed ones as well:
        only known noise is smoothed away. That the mean mu is fitted counts as well.
        """
        mean, std = np.empty((2, len(pairs)))
        own = variance(self._prior) + self._prior.noise
        with threads_for(len(self._places.x)):
            for some in _blocks(len(pairs), len(self._pairs)):
                half, mean[some], unsure = self._weighed(pairs[some])
                left = own - np.einsum("ij,ij->j", half, half) + unsure**2
                std[some] = np.sqrt(self.scale * np.maximum(left, 0.0))
        return mean, std

    def means_at(self, pairs: Pairs, values: Array) -> Array:
        """(m, F) means as `returns_at`, had the observations been each column of `values` (n, F).

        What is believed of their noise, and the factor, stay.
        """
        found = np.empty((len(pairs), values.shape[1]))
        with threads_for(len(self._places.x)):
            solved = half_solved(self._chol, values)
            means = self._ones @ solved / (self._ones @ self._ones)
            residuals = solved - np.outer(self._ones, means)
            for some in _blocks(len(pairs), len(self._pairs)):
                found[some] = means + self._weighed(pairs[some])[0].T @ residuals
        return found

    def joint_at(self, pairs: Pairs, excess: Array | None = None) -> tuple[Array, Array]:
        """Mean (m,) and covariance (m, m) of the same; O(n^2 m + n m^2).

        Args:
            pairs: (m, 3).
            excess: (n, n) covariance of the noise, less that by which the observations were
                weighed: what is said of the errors is of the true noise then.
        """
        with threads_for(len(self._places.x)):
            half, mean, unsure = self._weighed(pairs)
            left = covariance(self._places, self._prior, pairs, pairs)
            left += self._prior.noise * same_pair(pairs, pairs)
            left -= half.T @ half
            left += np.outer(unsure, unsure)
            left *= self.scale
            if excess is not None:
                weights = half_solved(self._chol, half, "T")
                left += weights.T @ excess @ weights
        return mean, left

    def _weighed(self, pairs: Pairs) -> tuple[Array, Array, Array]:
        """Covariances with the data, halved; the mean; what not knowing mu adds, a deviation."""
        across = covariance(self._places, self._prior, self._pairs, pairs)
        across += self._prior.noise * same_pair(self._pairs, pairs)
        half = half_solved(self._chol, across)
        unsure = (1.0 - half.T @ self._ones) / np.sqrt(self._ones @ self._ones)
        return half, self.mean + half.T @ self._residual, unsure

    def draws(self, sources: Pairs, targets: Pairs, n: int, rng: np.random.Generator) -> Array:
        """(n, M, T) samples of the rows of new trainings, one on each of M sources."""
        pairs = grid_pairs(sources, targets, NEW - 1 - np.arange(len(sources)))
        half = half_solved(self._chol, covariance(self._places, self._prior, self._pairs, pairs))
        left = covariance(self._places, self._prior, pairs, pairs) - half.T @ half
        left[np.diag_indices_from(left)] += 1e-6 * variance(self._prior)
        root = np.sqrt(self.scale) * np.linalg.cholesky(left)
        normal = rng.standard_normal((n, len(pairs)))
        rows = self.mean + half.T @ self._residual + normal @ root.T
        return np.asarray(rows.reshape(n, len(sources), len(targets)))


class _Fit(NamedTuple):
    """Observations less the mean, and ones, times the inverse Cholesky factor; what they say."""

    chol: Array
    residual: Array
    ones: Array
    mean: float
    scale: float
    log_likelihood: float


def _fit(kernel: Array, own: float, y: Array, noise: Array | None) -> _Fit:
    """Mean and factor of the data, with `own` noise (relative) and a known one (absolute)."""
    found = _fit_relative(kernel, own, y)
    if noise is None or not noise.any():
        return found
    own_part = own if noise.ndim == 1 else own * np.eye(len(y))
    for _ in range(_ROUNDS):  # the known noise is absolute and the kernel is not: fixed point
        before = found.scale
        found = _fit_relative(kernel, own_part + noise / before, y)
        if abs(found.scale - before) < 0.05 * before:
            break
    return found


def _fit_relative(kernel: Array, noise: float | Array, y: Array) -> _Fit:
    noisy = kernel.copy()
    noisy[... if np.ndim(noise) == 2 else np.diag_indices_from(noisy)] += noise
    chol = np.asarray(np.linalg.cholesky(noisy), np.float64)
    ones, values = half_solved(chol, np.column_stack([np.ones(len(y)), y])).T
    mean = float(ones @ values / (ones @ ones))
    residual = np.asarray(values - mean * ones)
    n, square = len(y), float(residual @ residual)
    scale = (square + _SHRINK * _USUAL) / (n + _SHRINK)
    log_det = 2.0 * float(np.log(np.diagonal(chol)).sum())
    likelihood = -0.5 * (n * np.log(2.0 * np.pi * scale) + log_det + square / scale)
    return _Fit(chol, residual, ones, mean, scale, float(likelihood))


def half_solved(chol: Array, right: Array, trans: str = "N") -> Array:
    """L^-1, or of it the transpose ("T"), times the right-hand side."""
    from scipy.linalg import solve_triangular  # kept out of `import mbtl`

    return np.asarray(solve_triangular(chol, right, trans, lower=True, check_finite=False))


def likely_noise(
    places: Places,
    prior: TransferPrior,
    pairs: Pairs,
    y: Array,
    known: Array | None = None,
    *,
    shares: Sequence[float] = _SHARES,
    slack: float = 0.0,
) -> tuple[TransferPrior, Array]:
    """The noise that makes the observations most likely: that of the prior, and the known one.

    The prior believes single pairs to scatter little, which is true of simulators that are judged
    on the same episodes; where it is not, every scatter would pass for a good source. `known` may
    in turn be far too much: policies judged on the same episodes share most of their luck there.
    Only where all of it does not explain the scatter are pairs themselves believed to be noisy.

    Args:
        places: of all contexts.
        prior: of the terms.
        pairs: (n, 3) observed.
        y: (n,) performance there.
        known: (n,) variance of each y by its episodes, or (n, n) covariance; None for none.
        shares: of `known` that may count.
        slack: natural logarithms of likelihood by which noisier pairs must be ahead.

    Returns:
        The prior as it was, or with much noisier pairs; the part of `known` that counts.
    """
    known = np.zeros(len(y)) if known is None else known
    some = np.linspace(0, len(y) - 1, min(len(y), ENOUGH)).round().astype(np.intp)
    kernel = covariance(places, prior, pairs[some], pairs[some])
    quiet, noisy = prior.noise, _NOISIER * prior.noise
    beliefs = [(quiet, share) for share in shares if share == 1.0 or known.any()] + [(noisy, 1.0)]
    of_some = known[some] if known.ndim == 1 else known[np.ix_(some, some)]
    with threads_for(len(places.x)):
        fits = {(o, share): _fit(kernel, o, y[some], share * of_some) for o, share in beliefs}

    def likely(belief: tuple[float, float]) -> float:
        return fits[belief].log_likelihood - slack * (belief[0] == noisy)

    own, share = max(beliefs, key=likely)
    return replace(prior, noise=own), share * known


def _blocks(rows: int, entries_per_row: int) -> Iterator[slice]:
    size = max(1, _BLOCK_ENTRIES // max(entries_per_row, 1))
    for start in range(0, rows, size):
        yield slice(start, start + size)
