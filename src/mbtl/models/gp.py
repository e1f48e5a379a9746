"""Gaussian process of the training performance: kernel, posterior, likelihood.

Notation (shapes): n observations, M query points, D columns (grid steps).
    X  (n, D)   where policies were trained
    y  (n,)     training performance there; of the paper's GP the prior mean is zero (section 2)
    R  (n, n)   R_ij = exp(-|x_i - x_j|^2 / (2 l^2)), l the length-scale
    K  (n, n)   K = c R + noise^2 I, c the amplitude
    LML         -1/2 y' K^-1 y - 1/2 log|K| - n/2 log 2 pi

The paper restarts a local optimiser of the LML 15 times. Two hyper-parameters and at most a few
hundred points allow better: one eigendecomposition R = Q diag(e) Q' gives LML for *every* amplitude
in O(n), so the length-scale alone is searched, on a grid fine enough to see each mode, and the best
modes are then refined. No randomness, no restarts, and the same answer every time.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from mbtl.arrays import Array
from mbtl.errors import InvalidInput
from mbtl.plain import real

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
        real("noise_std", self.noise_std)
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

    def predict(self, points: ArrayLike) -> tuple[Array, Array]:
        """Posterior mean (M,) and standard deviation (M,) without noise, in bounded memory.

        Args:
            points: (M, D), or (M,) where D = 1.

        Raises:
            InvalidInput: they are no such points.
        """
        points = _located(points, self.points.shape[1])
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
    x = _located(points)
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


def _located(points: ArrayLike, d: int | None = None) -> Array:
    """(M, D) points, of d columns where that is said."""
    x = np.asarray(points, dtype=np.float64)
    x = x[:, None] if x.ndim == 1 else x
    if x.ndim != 2 or d not in (None, x.shape[1]):
        columns = "D" if d is None else d
        raise InvalidInput(f"points of a GP have the shape (n, {columns}), got {x.shape}")
    return x


# ---- the fit -------------------------------------------------------------------------------------


_SPACING = 0.52  # of the first length-scale grid, in log units; halved twice near the top
_PLATEAU = 6.0  # at l = nearest distance / 6, R equals the identity to 2e-8
_MARGINS = (12.0, 3.0)  # LML below the best that is still searched when the spacing is halved
_NEAR = 1e-5  # log units in which the best length-scale is known


def fit_gp(points: ArrayLike, y: ArrayLike, settings: GPSettings | None = None) -> FittedGP:
    """Fit amplitude and length-scale to the global optimum of the marginal likelihood.

    Args:
        points: (n, D) or (n,) locations in grid steps.
        y: (n,) training performances.
        settings: bounds and noise.

    Raises:
        InvalidInput: no observation, unequal lengths, or a value that is not finite.
    """
    settings = settings or GPSettings()
    x, target = checked_data(points, y)
    length, amplitude = _Profile(squared_distances(x, x), target, settings).maximise()
    return FittedGP(x, target, amplitude, length, settings.noise_std**2)


class _Profile:
    """LML maximised over the amplitude, as a function of the log length-scale."""

    def __init__(self, squared: Array, y: Array, settings: GPSettings) -> None:
        self.squared, self.y = squared, y
        self.noise = settings.noise_std**2
        self.low, self.high = np.log(settings.length_bounds)
        lowest, highest = np.log(settings.amplitude_bounds)
        self.log_amplitudes = np.linspace(lowest, highest, 15)
        self.amplitudes = np.exp(self.log_amplitudes)

    def maximise(self) -> tuple[float, float]:
        """Global optimum (length, amplitude)."""
        grid = self._grid()
        values, logs = self._scan(grid)
        for margin in _MARGINS:  # halve the spacing wherever a higher mode could still hide
            near = values >= values.max() - margin
            middles = (0.5 * (grid[1:] + grid[:-1]))[near[1:] | near[:-1]]
            new_values, new_logs = self._scan(middles)
            order = np.argsort(np.concatenate([grid, middles]))
            grid = np.concatenate([grid, middles])[order]
            values = np.concatenate([values, new_values])[order]
            logs = np.concatenate([logs, new_logs])[order]
        best = int(values.argmax())
        answer = (float(values[best]), float(grid[best]), float(logs[best]))
        inner = np.flatnonzero((values[1:-1] >= values[:-2]) & (values[1:-1] > values[2:])) + 1
        for i in [*inner, len(grid) - 1]:
            if i and values[i] >= values[best] - _MARGINS[-1]:
                answer = max(answer, self._climb(grid[i - 1], grid[min(i + 1, len(grid) - 1)]))
        return float(np.exp(answer[1])), float(np.exp(answer[2]))

    def _scan(self, grid: Array) -> tuple[Array, Array]:
        """(m,) log length-scales -> (m,) LML and (m,) log amplitudes, both nearly optimal."""
        e, q = np.linalg.eigh(np.exp(self.squared * (-0.5 * np.exp(-2.0 * grid))[:, None, None]))
        return self._best_amplitude(np.maximum(e, 0.0), np.square(self.y @ q))

    def _grid(self) -> Array:
        """Log length-scales up to the bound, from one point that stands for the plateau R = I."""
        apart = self.squared[self.squared > 0]
        if apart.size == 0:  # one distinct point: LML does not depend on l; 1 is the paper's start
            return np.array([np.clip(0.0, self.low, self.high)])
        edge = float(np.clip(0.5 * np.log(apart.min()) - np.log(_PLATEAU), self.low, self.high))
        steps = max(int(np.ceil((self.high - edge) / _SPACING)), 1)
        grid = np.linspace(edge, self.high, steps + 1)
        grid[0] = min(edge, max(self.low, 0.0))
        return grid

    def _best_amplitude(self, e: Array, z2: Array) -> tuple[Array, Array]:
        """(m, n) spectra -> (m,) LML at nearly the best amplitude, and (m,) log amplitudes."""
        scaled = self.amplitudes[:, None] * e[:, None, :] + self.noise
        terms = z2[:, None, :] / scaled
        terms += np.log(scaled, out=scaled)
        grid = -0.5 * terms.sum(axis=-1)
        log_c = self.log_amplitudes[grid.argmax(axis=1)]
        low, high = self.log_amplitudes[0], self.log_amplitudes[-1]
        for _ in range(3):
            found = log_c + self._amplitude_step(log_c, e, z2)
            log_c = np.minimum(np.maximum(found, low), high)  # `np.clip` takes four times as long
        total = np.exp(log_c)[:, None] * e + self.noise
        polished = -0.5 * (z2 / total + np.log(total)).sum(axis=1)
        return np.maximum(polished, grid.max(axis=1)) - 0.5 * len(self.y) * LOG_2PI, log_c

    def _amplitude_step(self, log_c: Array, e: Array, z2: Array) -> Array:
        """(m,) Newton steps from the derivatives of LML in the log amplitude.

        At most 1, and uphill where the curvature has the wrong sign.
        """
        signal = np.exp(log_c)[:, None] * e
        total = signal + self.noise
        share = signal / total
        fit = share * (z2 / total)
        excess = fit - share
        slope = 0.5 * excess.sum(axis=1)
        curve = 0.5 * (excess - share * (excess + fit)).sum(axis=1)
        step = slope / np.maximum(-curve, 1e-3 + 0.1 * np.abs(slope))
        return np.asarray(np.minimum(np.maximum(step, -1.0), 1.0))

    def _climb(self, low: float, high: float) -> tuple[float, float, float]:
        """(LML, log length-scale, log amplitude) of the top between two log length-scales."""
        from scipy.optimize import minimize_scalar  # kept out of `import mbtl`

        def below(log_length: float) -> float:
            return -float(self._scan(np.array([log_length]))[0][0])

        found = minimize_scalar(
            below, bounds=(low, high), method="bounded", options={"xatol": _NEAR}
        )
        values, logs = self._scan(np.array([found.x]))
        return float(values[0]), float(found.x), float(logs[0])
