"""Gaussian process of the training performance: kernel, posterior, likelihood.

Notation (shapes): n observations, M query points, D columns (grid steps).
    X  (n, D)   where policies were trained
    y  (n,)     training performance there; of the paper's GP the prior mean is zero (section 2)
    R  (n, n)   R_ij = exp(-|x_i - x_j|^2 / (2 l^2)), l the length-scale
    K  (n, n)   K = c R + noise^2 I, c the amplitude
    LML         -1/2 y' K^-1 y - 1/2 log|K| - n/2 log 2 pi
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from mbtl.arrays import Array
from mbtl.errors import InvalidInput

LOG_2PI = float(np.log(2.0 * np.pi))
_BLOCK = 1 << 16  # query rows per block: 64 Ki rows x 45 observations is 24 MiB
_JITTERS = (0.0, 1e-12, 1e-10, 1e-8, 1e-6)


@dataclass(frozen=True)
class GPSettings:
    """Kernel bounds and noise; the defaults are the paper's (method, section 2).

    Attributes:
        noise_std: standard deviation of the observation noise, units of performance.
        amplitude_bounds: bounds of c.
        length_bounds: bounds of l, grid steps.
    """

    noise_std: float = 1e-3
    amplitude_bounds: tuple[float, float] = (1e-3, 1e3)
    length_bounds: tuple[float, float] = (1e-2, 1e2)

    def __post_init__(self) -> None:
        if not (np.isfinite(self.noise_std) and self.noise_std > 0):
            raise InvalidInput(f"noise_std must be finite and > 0, got {self.noise_std!r}")
        for low, high in (self.amplitude_bounds, self.length_bounds):
            if not 0 < low < high < np.inf:
                raise InvalidInput(
                    f"kernel bounds must satisfy 0 < low < high, got ({low}, {high})"
                )


Fitter = Callable[[Array, Array, GPSettings], "FittedGP"]


@dataclass(frozen=True)
class FittedGP:
    """A Gaussian process with fixed hyper-parameters and its data.

    Attributes:
        points: (n, D) observed locations.
        y: (n,) observed values.
        amplitude: c.
        length: l, grid steps.
        noise_variance: noise variance.
        notes: what the fit had to do that was not planned.
        mean: prior mean, units of performance; `y` holds the values less this.
    """

    points: Array
    y: Array
    amplitude: float
    length: float
    noise_variance: float
    notes: tuple[str, ...] = ()
    mean: float = 0.0

    @cached_property
    def _factor(self) -> tuple[Array, Array, float]:
        kernel = self.amplitude * rbf(squared_distances(self.points, self.points), self.length)
        for jitter in _JITTERS:
            noise = self.noise_variance + jitter * self.amplitude
            try:
                chol = np.linalg.cholesky(kernel + noise * np.eye(len(self.y)))
            except np.linalg.LinAlgError:
                continue
            inverse = np.linalg.inv(chol)  # n is small; one inverse beats M triangular solves
            return inverse, inverse.T @ (inverse @ self.y), jitter
        raise InvalidInput(
            "the kernel matrix stayed singular with jitter 1e-6; remove repeated contexts"
        )

    @property
    def jitter(self) -> float:
        """What had to be added to the diagonal beside the noise, in units of the amplitude."""
        return self._factor[2]

    @property
    def lml(self) -> float:
        """Log marginal likelihood at these hyper-parameters."""
        inverse, alpha, _ = self._factor
        log_det = -2.0 * np.log(np.diagonal(inverse)).sum()
        return float(-0.5 * self.y @ alpha - 0.5 * log_det - 0.5 * len(self.y) * LOG_2PI)

    def predict(self, points: Array) -> tuple[Array, Array]:
        """Posterior mean (M,) and standard deviation (M,) without noise, in bounded memory."""
        inverse, alpha, _ = self._factor
        mean, variance = np.empty(len(points)), np.empty(len(points))
        for start in range(0, len(points), _BLOCK):
            block = slice(start, start + _BLOCK)
            cross = self.amplitude * rbf(squared_distances(points[block], self.points), self.length)
            mean[block] = cross @ alpha
            half = cross @ inverse.T
            variance[block] = self.amplitude - np.einsum("ij,ij->i", half, half)
        return mean + self.mean, np.sqrt(np.maximum(variance, 0.0))

    def with_believed(self, points: Array) -> FittedGP:
        """The same process with `points` (pending picks) observed at their predicted means."""
        believed = self.predict(points)[0] - self.mean
        y = np.concatenate([self.y, believed])
        return replace(self, points=np.vstack([self.points, points]), y=y)


def squared_distances(a: Array, b: Array) -> Array:
    """(M, D), (n, D) -> (M, n) squared Euclidean distances."""
    if a.shape[1] == 1:
        return np.asarray(np.square(a - b[:, 0]))
    return np.asarray(np.square(a[:, None, :] - b[None, :, :]).sum(axis=2))


def rbf(squared: Array, length: float) -> Array:
    """Correlation exp(-d^2 / (2 l^2)) from squared distances."""
    return np.asarray(np.exp(squared * (-0.5 / length**2)))


def checked_data(points: ArrayLike, y: ArrayLike) -> tuple[Array, Array]:
    """Observations as float64 (n, D) and (n,); raises `InvalidInput` when they are unusable."""
    x = np.asarray(points, dtype=np.float64)
    x = x[:, None] if x.ndim == 1 else x
    target = np.asarray(y, dtype=np.float64)
    if target.ndim != 1 or len(target) < 1 or x.shape[0] != len(target):
        raise InvalidInput(
            f"a GP needs n >= 1 points and values, got shapes {x.shape}, {target.shape}"
        )
    if not (np.isfinite(x).all() and np.isfinite(target).all()):
        raise InvalidInput(
            "a GP needs finite points and values, got NaN or infinity; drop those rows"
        )
    return x, target
