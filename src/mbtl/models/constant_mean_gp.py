"""Gaussian process with a learned constant mean and learned noise, by maximum likelihood.

Notation (shapes) as in `gp`; K = c (R(l) + r I), r the noise variance over the amplitude.
For given l and r the mean and the amplitude that maximise the likelihood are known in closed form
(generalised least squares), and with R = Q diag(e) Q' they cost O(n). Two numbers remain: they are
scanned on a grid, one eigendecomposition per length-scale, and the best is refined.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from mbtl.arrays import Array
from mbtl.models.gp import LOG_2PI, FittedGP, GPSettings, checked_data, squared_distances

_LENGTHS, _RATIOS = 20, 31  # points of the scan
_MOST_NOISE = 1e3  # largest r: beyond it the data are noise around a constant
_NEAR, _FAR = 4.0, 10.0  # l from nearest / 4, where R is the identity, to 10 farthest: a constant


def fit_constant_mean(
    points: ArrayLike, y: ArrayLike, settings: GPSettings | None = None
) -> FittedGP:
    """Fit mean, amplitude, length-scale and noise.

    Args:
        points: (n, D) or (n,) locations in grid steps.
        y: (n,) training performances.
        settings: bounds of amplitude and length-scale; `noise_std` is the *least* noise.

    Raises:
        InvalidInput: no observation, unequal lengths, or a value that is not finite.
    """
    from scipy.optimize import minimize  # kept out of `import mbtl`

    settings = settings or GPSettings()
    x, target = checked_data(points, y)
    squared = squared_distances(x, x)
    lengths = _lengths(squared, settings)
    floor, top = settings.noise_std**2, settings.amplitude_bounds[1]
    least = floor / top  # so that an amplitude within bounds always allows the least noise
    ratios = np.linspace(np.log(least), np.log(max(_MOST_NOISE, 10.0 * least)), _RATIOS)

    def lml(log_length: Array, log_ratio: Array) -> tuple[Array, Array, Array]:
        """(lengths, ratios) likelihood at the best mean and amplitude, and these two.

        It has one maximum in the amplitude, so moving that into its bounds is exact.
        """
        e, q = np.linalg.eigh(np.exp(squared * (-0.5 * np.exp(-2.0 * log_length))[:, None, None]))
        spectrum = (np.maximum(e, 0.0), target @ q, q.sum(axis=1))
        e, z, ones = (part[:, None, :] for part in spectrum)
        n, ratio = e.shape[-1], np.exp(log_ratio)
        total = e + ratio[:, None]
        mean = (ones * z / total).sum(axis=-1) / (ones * ones / total).sum(axis=-1)
        misfit = ((z - mean[..., None] * ones) ** 2 / total).sum(axis=-1)
        low = settings.amplitude_bounds[0]
        amplitude = np.maximum(misfit / n, floor / ratio)
        amplitude = np.minimum(np.maximum(amplitude, low), top)
        value = n * np.log(amplitude) + misfit / amplitude + np.log(total).sum(axis=-1)
        return -0.5 * (value + n * LOG_2PI), mean, amplitude

    scan = lml(lengths, ratios)[0]
    i, j = np.unravel_index(int(scan.argmax()), scan.shape)
    bounds = [(lengths[0], lengths[-1]), (ratios[0], ratios[-1])]
    found = minimize(lambda p: -lml(p[:1], p[1:])[0][0, 0], (lengths[i], ratios[j]), bounds=bounds)
    log_length, log_ratio = found.x if -found.fun >= scan[i, j] else (lengths[i], ratios[j])
    best = lml(np.array([log_length]), np.array([log_ratio]))
    mean, amplitude = (float(part[0, 0]) for part in best[1:])
    noise = float(np.exp(log_ratio)) * amplitude
    length = float(np.exp(log_length))
    return FittedGP(x, target - mean, amplitude, length, noise, mean=mean)


def _lengths(squared: Array, settings: GPSettings) -> Array:
    """Log length-scales to scan: between all points apart and all points alike."""
    low, high = settings.length_bounds
    apart = np.sqrt(squared[squared > 0])
    if not apart.size:  # one distinct point: the likelihood does not depend on l
        return np.full(2, np.log(np.clip(1.0, low, high)))
    first, last = np.log(np.clip([apart.min() / _NEAR, _FAR * apart.max()], low, high))
    return np.linspace(float(first), float(last), _LENGTHS)
