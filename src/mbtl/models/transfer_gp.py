"""Gaussian process of transfer: every evaluated (source, target) pair is an observation.

    J(s, t, r) = mu + g(t) + f(s) + h(x_t - x_s) + h'(z_t - z_s) + i(s, t) + luck(r) + l_r(t) + e

g is how hard a target is, f how good a source, h and h' how performance falls with the signed
difference of the contexts, once on their own scale x and once on a logarithmic one z: a plateau
that ends at a ratio is one shape there. Both may change along the sources. i is what is left of the
pair, luck what one training r does to its whole row, l_r what it does to parts of it: two trainings
on one source differ by those alone. Every term is a zero-mean process with a Matern-3/2 kernel, and
all are scaled by one factor fitted to the data. Known noise of an observation may come on top of e.

Notation (shapes): n observed pairs, m queried pairs, N contexts, D columns.
    x     (N, D)  unit-cube coordinates;  z  (N, D)  the same on a logarithmic scale
    pairs (n, 3)  indices (source, target) and number of the training; `NEW` is one not done yet
    K     (n, n)  prior covariance of the observed pairs, noise included, before the factor
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass, fields, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbtl.arrays import Array
from mbtl.errors import InvalidInput

Pairs = NDArray[np.intp]

NEW = -1
"""Training number of a source that would be trained anew, whatever was trained there before."""

_ROOT3 = float(np.sqrt(3.0))
_SHRINK = 2.0
"""Observations that the prior scale is worth."""
_USUAL = 0.05
"""Prior scale: variance of performance between pairs."""
_ROUNDS = 12
"""At most so many fits to find the factor beside a known noise."""
_SHARES = (0.0, 0.1, 0.3, 1.0)
_NOISIER = 50.0
_ENOUGH = 300
"""Observations that decide how noisy the others are."""
_BLOCK_ENTRIES = 1 << 20


@dataclass(frozen=True)
class TransferPrior:
    """Variances of the terms, relative to each other, and their length-scales in unit coordinates.

    Attributes:
        target, source, gap, log_gap, interaction, luck, row_luck, noise: variances of g, f, h, h',
            i, luck, l_s and the noise.
        target_length, source_length, gap_length, log_gap_length, row_luck_length: length-scales.
        along_length: distance of two sources over which the shape of their gap changes.

    Raises:
        InvalidInput: a number is not finite and > 0.
    """

    target: float = 0.30
    source: float = 0.10
    gap: float = 0.30
    log_gap: float = 0.30
    interaction: float = 0.10
    luck: float = 0.10
    row_luck: float = 0.05
    noise: float = 0.01
    target_length: float = 0.20
    source_length: float = 0.30
    gap_length: float = 0.20
    log_gap_length: float = 0.20
    along_length: float = 0.50
    row_luck_length: float = 0.10

    def __post_init__(self) -> None:
        for name, value in self.record.items():
            if not (np.isfinite(value) and value > 0):
                raise InvalidInput(f"{name} of a prior must be finite and > 0, got {value!r}")

    @property
    def record(self) -> dict[str, float]:
        """By name, JSON-able."""
        return asdict(self)

    @property
    def logs(self) -> Array:
        """(14,) natural logarithms in the order of the fields, for fitting."""
        return np.log([getattr(self, f.name) for f in fields(self)])

    @classmethod
    def of_logs(cls, logs: Array) -> TransferPrior:
        """What `logs` gave."""
        return cls(*np.exp(logs).tolist())


@dataclass(frozen=True)
class Places:
    """Where the contexts lie.

    Attributes:
        x: (N, D) unit-cube coordinates.
        z: (N, D) on a logarithmic scale.
    """

    x: Array
    z: Array

    @classmethod
    def of(cls, unit: Array, steps: Array) -> Places:
        """From both coordinates of a selection problem: z = log(1 + steps), scaled to 0..1.

        A grid that starts one step above zero, as most do, is logarithmic in its values then.
        """
        low = steps.min(axis=0)
        logs = np.log1p(steps - low)
        return cls(unit, logs / np.maximum(logs.max(axis=0), 1e-12))


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
            noise: (n,) variance of each y around the true mean return; None for none.

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
        fit = _fit(covariance(places, prior, pairs, pairs), prior.noise, y, noise)
        self._chol, self._residual = fit.chol, fit.residual
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
        half = _half(self._chol, covariance(self._places, self._prior, self._pairs, pairs))
        own = variance(self._prior)
        left = np.maximum(own - np.einsum("ij,ij->j", half, half), 1e-9 * own)
        return self.mean + half.T @ self._residual, np.sqrt(self.scale * left)

    def draws(self, source: int, targets: Pairs, n: int, rng: np.random.Generator) -> Array:
        """(n, T) samples of the row of one new training on `source`."""
        pairs = grid_pairs(np.array([source]), targets, np.array([NEW]))
        half = _half(self._chol, covariance(self._places, self._prior, self._pairs, pairs))
        prior = covariance(self._places, self._prior, pairs, pairs, one_training=True)
        left = prior - half.T @ half
        left[np.diag_indices_from(left)] += 1e-6 * variance(self._prior)
        root = np.sqrt(self.scale) * np.linalg.cholesky(left)
        normal = rng.standard_normal((n, len(targets)))
        return np.asarray(self.mean + half.T @ self._residual + normal @ root.T)


class _Fit(NamedTuple):
    """Observations less the mean, both times the inverse Cholesky factor, and what they say."""

    chol: Array
    residual: Array
    mean: float
    scale: float
    log_likelihood: float


def _fit(kernel: Array, own: float, y: Array, noise: Array | None) -> _Fit:
    """Mean and factor of the data, with `own` noise (relative) and a known one (absolute)."""
    if noise is None or not noise.any():
        return _fit_relative(kernel, own, y)
    found = _fit_relative(kernel, own, y)
    for _ in range(_ROUNDS):  # the known noise is absolute and the kernel is not: fixed point
        before = found.scale
        found = _fit_relative(kernel, own + noise / before, y)
        if abs(found.scale - before) < 0.05 * before:
            break
    return found


def _fit_relative(kernel: Array, noise: float | Array, y: Array) -> _Fit:
    noisy = kernel.copy()
    noisy[np.diag_indices_from(noisy)] += noise
    chol = np.asarray(np.linalg.cholesky(noisy), np.float64)
    ones, values = _half(chol, np.ones(len(y))), _half(chol, y)
    mean = float(ones @ values / (ones @ ones))
    residual = np.asarray(values - mean * ones)
    n, square = len(y), float(residual @ residual)
    scale = (square + _SHRINK * _USUAL) / (n + _SHRINK)
    log_det = 2.0 * float(np.log(np.diagonal(chol)).sum())
    likelihood = -0.5 * (n * np.log(2.0 * np.pi * scale) + log_det + square / scale)
    return _Fit(chol, residual, mean, scale, float(likelihood))


def _half(chol: Array, right: Array) -> Array:
    from scipy.linalg import solve_triangular  # kept out of `import mbtl`

    return np.asarray(solve_triangular(chol, right, lower=True, check_finite=False))


def likely_noise(
    places: Places, prior: TransferPrior, pairs: Pairs, y: Array, known: Array | None = None
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
        known: (n,) variance of each y by its episodes; None for none.

    Returns:
        The prior, as it is or with much noisier pairs, and (n,) the part of `known` to count.
    """
    known = np.zeros(len(y)) if known is None else known
    some = np.linspace(0, len(y) - 1, min(len(y), _ENOUGH)).round().astype(np.intp)
    kernel = covariance(places, prior, pairs[some], pairs[some])
    quiet, noisy = prior.noise, _NOISIER * prior.noise
    beliefs = [(quiet, share) for share in _SHARES if share == 1.0 or known.any()] + [(noisy, 1.0)]

    def likelihood(belief: tuple[float, float]) -> float:
        own, share = belief
        return _fit(kernel, own, y[some], share * known[some]).log_likelihood

    own, share = max(beliefs, key=likelihood)
    return replace(prior, noise=own), share * known


def covariance(
    places: Places, prior: TransferPrior, a: Pairs, b: Pairs, *, one_training: bool = False
) -> Array:
    """Prior covariance of J at pairs `a` (m, 3) and `b` (n, 3), without noise.

    Terms of sources alone and of targets alone are computed once per distinct context and looked
    up; only those of the shifts are computed for every two pairs.

    Args:
        places: of all contexts.
        prior: of the terms.
        a: pairs of the rows.
        b: pairs of the columns.
        one_training: `NEW` is the same training everywhere; otherwise each is one of its own.

    Returns:
        (m, n).
    """
    x, z = places.x, places.z
    (s, t, r), (s2, t2, r2) = a.T, b.T
    (some, at), (some2, at2) = _distinct(s), _distinct(s2)
    (ends, to), (ends2, to2) = _distinct(t), _distinct(t2)

    def of_sources(table: Array) -> Array:
        return table.take(at, axis=0).take(at2, axis=1)

    def of_targets(table: Array) -> Array:
        return table.take(to, axis=0).take(to2, axis=1)

    apart = _distance(x[ends], x[ends2])
    sources = _distance(x[some], x[some2])
    near = _matern(sources, prior.source_length)
    total = of_targets(prior.target * _matern(apart, prior.target_length))
    total *= of_sources(1.0 + (prior.interaction / prior.target) * near)
    total += of_sources(prior.source * near)
    shapes = (
        (x, prior.gap, prior.gap_length),
        (z, prior.log_gap, prior.log_gap_length),
    )
    for place, size, length in shapes:
        along = _matern(_distance(place[some], place[some2]), prior.along_length)
        shift = _matern(_distance(place[t] - place[s], place[t2] - place[s2]), length)
        shift *= of_sources(size * along)
        total += shift
    same = r[:, None] == r2[None, :]
    if not one_training:
        same &= r[:, None] != NEW
    if same.any():
        luck = prior.luck + prior.row_luck * _matern(apart, prior.row_luck_length)
        total += same * of_targets(luck)
    return total


def variance(prior: TransferPrior) -> float:
    """Prior variance of one J, without noise and before the factor."""
    p = prior
    return p.target + p.source + p.gap + p.log_gap + p.interaction + p.luck + p.row_luck


def grid_pairs(sources: Pairs, targets: Pairs, trainings: Pairs | None = None) -> Pairs:
    """(M * T, 3) each of M trainings on every target; they are numbered from 0 unless told."""
    numbers = np.arange(len(sources)) if trainings is None else trainings
    source, training = (np.repeat(column, len(targets)) for column in (sources, numbers))
    return np.column_stack([source, np.tile(targets, len(sources)), training])


def _distance(a: Array, b: Array) -> Array:
    """(m, D), (n, D) -> (m, n) root mean square differences: in any D, a cube's side is 1."""
    if a.shape[1] == 1:
        distance = a - b[:, 0]
        return np.asarray(np.abs(distance, out=distance))
    d = a.shape[1]
    squared = (a * (-2.0 / d)) @ b.T
    squared += np.square(a).sum(axis=1)[:, None] / d
    squared += np.square(b).sum(axis=1) / d
    np.maximum(squared, 0.0, out=squared)
    return np.asarray(np.sqrt(squared, out=squared))


def _matern(distance: Array, length: float) -> Array:
    """(1 + r) exp(-r) with r = sqrt(3) distance / length; overwrites nothing."""
    scaled = distance * (-_ROOT3 / length)
    fall = np.exp(scaled)
    np.subtract(1.0, scaled, out=scaled)
    scaled *= fall
    return scaled


def _distinct(indices: NDArray[np.intp]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """The distinct contexts, and where each index stands among them."""
    some, at = np.unique(indices, return_inverse=True)
    return some, at


def _blocks(rows: int, entries_per_row: int) -> Iterator[slice]:
    size = max(1, _BLOCK_ENTRIES // max(entries_per_row, 1))
    for start in range(0, rows, size):
        yield slice(start, start + size)
