"""Fit a Gaussian process to the global optimum of its marginal likelihood; notation as in `gp`.

The paper restarts a local optimiser 15 times. Two hyper-parameters and at most a few hundred points
allow better: one eigendecomposition R = Q diag(e) Q' gives LML for *every* amplitude in O(n), so
the length-scale alone is searched, on a grid fine enough to see each mode, and the best modes are
then refined. No randomness, no restarts, and the same answer every time.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from mbtl.arrays import Array
from mbtl.models.gp import LOG_2PI, FittedGP, GPSettings, checked_data, squared_distances

_SPACING = 0.52  # of the first length-scale grid, in log units; halved twice near the top
_PLATEAU = 6.0  # at l = nearest distance / 6, R equals the identity to 2e-8
_MARGINS = (12.0, 3.0)  # LML below the best that is still searched when the spacing is halved


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


class _Local(NamedTuple):
    """LML at one point, with derivatives in the log length-scale l and the log amplitude c."""

    value: float
    slope_l: float
    slope_c: float
    curve_l: float
    curve_c: float
    cross: float


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
            if values[i] >= values[best] - _MARGINS[-1]:
                around = slice(max(i - 1, 0), i + 2)
                answer = max(answer, self._climb(grid[around], values[around], logs[around]))
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

    def _at(self, log_length: float, log_c: float) -> _Local:
        """LML and its derivatives at one point, from one Cholesky factor and one inverse.

        With B = K^-1, a = B y, S = c R, W = squared / l^2 and T = S * W, the derivatives of K are S
        in log c and T in log l, and those of S and T in log l are T and U = T * (W - 2). B S equals
        I - noise B, so no product with S is formed.

        Raises:
            numpy.linalg.LinAlgError: the noise is below rounding and K is not positive definite.
        """
        n, noise = len(self.y), self.noise
        w = self.squared * np.exp(-2.0 * log_length)
        s = np.exp(log_c - 0.5 * w)
        k = s.copy()
        k.flat[:: n + 1] += noise
        log_det = 2.0 * np.log(np.diagonal(np.linalg.cholesky(k))).sum()
        b = np.linalg.inv(k)
        a = b @ self.y
        t = s * w
        u = t * (w - 2.0)
        ba, ta, bt = b @ a, t @ a, b @ t
        y_a, a_a, a_t_a = self.y @ a, a @ a, a @ ta
        a_s_a, a_sbs_a = y_a - noise * a_a, y_a - 2.0 * noise * a_a + noise**2 * (a @ ba)
        trace_b, trace_bt = np.trace(b), np.trace(bt)
        return _Local(
            value=-0.5 * float(y_a + log_det + n * LOG_2PI),
            slope_l=0.5 * float(a_t_a - trace_bt),
            slope_c=0.5 * float(a_s_a - n + noise * trace_b),
            curve_l=float(0.5 * (a @ u @ a - np.vdot(b, u) + np.vdot(bt, bt.T)) - ta @ b @ ta),
            curve_c=float(0.5 * (a_s_a - noise * trace_b + noise**2 * np.vdot(b, b)) - a_sbs_a),
            cross=float(noise * (ba @ ta - 0.5 * np.vdot(b, bt)) - 0.5 * a_t_a),
        )

    def _climb(self, x: Array, values: Array, logs: Array) -> tuple[float, float, float]:
        """Climb within [x[0], x[-1]] from scanned points: Newton on both, the length bracketed.

        The amplitude follows its own optimum, so the bracket may go by the slope of the profile.

        Returns:
            (LML, log length-scale, log amplitude) of the best point seen.
        """
        left, right = float(x[0]), float(x[-1])
        now = right
        if len(x) == 3:  # start at the vertex of the parabola through the three
            bend, slope, now = _parabola(x, values)
            now = min(max(now - slope / bend, left), right)
        log_c = float(np.interp(now, x, logs))
        best = (-np.inf, now, log_c)
        for _ in range(40):
            try:
                here = self._at(now, log_c)
            except np.linalg.LinAlgError:
                break  # the scanned optimum stands
            best = max(best, (here.value, now, log_c))
            top = float(self._within(log_c + _safe_step(here.slope_c, here.curve_c)))
            free = self.log_amplitudes[0] < top < self.log_amplitudes[-1] and here.curve_c < 0
            follow = -here.cross / here.curve_c if free else 0.0
            move = top - log_c
            slope = here.slope_l + here.cross * move
            near = abs(move) < 0.1  # else this is not yet the slope of the profile
            if near:
                left, right = (now, right) if slope > 0 else (left, now)
            step = now - slope / min(here.curve_l + here.cross * follow, -1e-9)
            if not left < step < right:
                step = 0.5 * (left + right) if near else min(max(step, left), right)
            gain = abs(slope * (step - now)) + abs(here.slope_c * move)
            log_c = float(self._within(top + min(max(follow * (step - now), -1.0), 1.0)))
            if gain < 1e-8 * (1.0 + abs(here.value)) or right - left < 1e-9:
                return max(best, (here.value + 0.5 * gain, step, log_c))
            now = step
        return best


def _safe_step(slope: Any, curve: Any) -> Any:
    """Newton step to a maximum, at most 1, and uphill where the curvature has the wrong sign."""
    step = slope / np.maximum(-curve, 1e-3 + 0.1 * np.abs(slope))
    return np.minimum(np.maximum(step, -1.0), 1.0)


def _parabola(x: Array, values: Array) -> tuple[float, float, float]:
    """Curvature (< 0), slope and place of the middle of three points, unevenly spaced."""
    before, after = (values[1] - values[0]) / (x[1] - x[0]), (values[2] - values[1]) / (x[2] - x[1])
    bend = 2.0 * (after - before) / (x[2] - x[0])
    slope = before + 0.5 * bend * (x[1] - x[0])
    return min(float(bend), -1e-6), float(slope), float(x[1])
