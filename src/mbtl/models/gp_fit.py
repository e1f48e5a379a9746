"""Fit a Gaussian process to the global optimum of its marginal likelihood; notation as in `gp`.

The paper restarts a local optimiser 15 times. Two hyper-parameters and at most a few hundred points
allow better: one eigendecomposition R = Q diag(e) Q' gives LML for *every* amplitude in O(n), so
the length-scale alone is searched, on a grid fine enough to see each mode, and the best modes are
then refined. No randomness, no restarts, and the same answer every time.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from mbtl.arrays import Array
from mbtl.models.gp import LOG_2PI, FittedGP, GPSettings, checked_data, squared_distances

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
    squared = squared_distances(x, x)
    profile = _Profile(squared, target, settings)
    length, amplitude = profile.maximise()
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
        for _ in range(3):
            log_c = self._within(log_c + self._amplitude_step(log_c, e, z2))
        total = np.exp(log_c)[:, None] * e + self.noise
        polished = -0.5 * (z2 / total + np.log(total)).sum(axis=1)
        return np.maximum(polished, grid.max(axis=1)) - 0.5 * len(self.y) * LOG_2PI, log_c

    def _amplitude_step(self, log_c: Array, e: Array, z2: Array) -> Array:
        """(m,) Newton steps from the derivatives of LML in the log amplitude."""
        signal = np.exp(log_c)[:, None] * e
        total = signal + self.noise
        share = signal / total
        fit = share * (z2 / total)
        excess = fit - share
        slope = 0.5 * excess.sum(axis=1)
        curve = 0.5 * (excess - share * (excess + fit)).sum(axis=1)
        return np.asarray(_safe_step(slope, curve))

    def _within(self, log_c: Array | float) -> Array:
        """Log amplitudes moved into their bounds; `np.clip` takes four times as long."""
        low, high = self.log_amplitudes[0], self.log_amplitudes[-1]
        return np.asarray(np.minimum(np.maximum(log_c, low), high))

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


def _safe_step(slope: Array, curve: Array) -> Array:
    """Newton step to a maximum, at most 1, and uphill where the curvature has the wrong sign."""
    step = slope / np.maximum(-curve, 1e-3 + 0.1 * np.abs(slope))
    return np.asarray(np.minimum(np.maximum(step, -1.0), 1.0))
