"""Kernel of transfer: how alike the performance of two (source, target) pairs is beforehand.

    J(s, t, r) = mu + g(t) + f(s) + h(x_t - x_s) + h'(z_t - z_s) + i(s, t) + luck(r) + l_r(t) + e

g is how hard a target is, f how good a source, h and h' how performance falls with the signed
difference of the contexts, once on their own scale x and once on a logarithmic one z: a plateau
that ends at a ratio is one shape there. Both may change along the sources. i is what is left of the
pair, luck what one training r does to its whole row, l_r what it does to parts of it: two trainings
on one source differ by those alone. Every term is a zero-mean process with a Matern-3/2 kernel.

Notation (shapes): m and n pairs, N contexts, D columns.
    x     (N, D)  unit-cube coordinates;  z  (N, D)  the same on a logarithmic scale
    pairs (n, 3)  indices (source, target) and number of the training; `NEW` is one not done yet,
                  another one every time
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Protocol

import numpy as np

from mbtl.arrays import Array, Indices, Mask
from mbtl.contexts import Axis, Categorical, Log
from mbtl.errors import InvalidInput

Pairs = Indices

NEW = -1
"""Training number of a source that would be trained anew, whatever was trained there before."""

_ROOT3 = float(np.sqrt(3.0))


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
        for name, value in asdict(self).items():
            if not (np.isfinite(value) and value > 0):
                raise InvalidInput(f"{name} of a prior must be finite and > 0, got {value!r}")


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


class Located(Protocol):
    """Contexts and where they lie: a `ContextSpace`, or a selection problem."""

    @property
    def axes(self) -> Sequence[Axis]:
        """D columns together; none: D linear axes."""
        ...

    @property
    def unit(self) -> Array:
        """(N, D) unit-cube coordinates."""
        ...

    @property
    def steps(self) -> Array:
        """(N, D) grid-step coordinates."""
        ...


def transfer_places(space: Located) -> Places:
    """Where contexts lie when every axis counts the same, whatever its number of columns.

    Equal ratios have a meaning that x does not show yet: not on a logarithmic axis, where x shows
    them, nor on a categorical one.

    Raises:
        InvalidInput: the axes do not have as many columns as the coordinates.
    """
    plain, columns = Places.of(space.unit, space.steps), space.unit.shape[1]
    widths = [axis.width for axis in space.axes] or [1] * columns
    if sum(widths) != columns:
        raise InvalidInput(
            f"axes must have as many columns as the coordinates ({columns}), got {sum(widths)} "
            f"of {len(widths)} axes; give the axes of the context space itself"
        )
    ratios = [not isinstance(axis, (Categorical, Log)) for axis in space.axes] or [True] * columns
    z = np.where(np.repeat(ratios, widths), plain.z, plain.x)
    scale = np.sqrt(columns / len(widths))  # distances are means over columns
    return Places(plain.x * scale, z * scale)


def covariance(places: Places, prior: TransferPrior, a: Pairs, b: Pairs) -> Array:
    """Prior covariance of J at pairs `a` (m, 3) and `b` (n, 3), without noise.

    Terms of sources alone and of targets alone are computed once per distinct context and looked
    up; only those of the shifts are computed for every two pairs.

    Args:
        places: of all contexts.
        prior: of the terms.
        a: pairs of the rows.
        b: pairs of the columns.

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
    shapes = ((x, prior.gap, prior.gap_length), (z, prior.log_gap, prior.log_gap_length))
    for place, size, length in shapes:
        along = _matern(_distance(place[some], place[some2]), prior.along_length)
        shift = _matern(_distance(place[t] - place[s], place[t2] - place[s2]), length)
        shift *= of_sources(size * along)
        total += shift
    same = (r[:, None] == r2[None, :]) & (r[:, None] != NEW)
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


def same_pair(a: Pairs, b: Pairs) -> Mask:
    """(m, n) True where both are one training on one target."""
    same: Mask = a[:, 1][:, None] == b[:, 1]
    same &= a[:, 2][:, None] == b[:, 2]
    return same


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


def _distinct(indices: Indices) -> tuple[Indices, Indices]:
    """The distinct contexts, and where each index stands among them."""
    some, at = np.unique(indices, return_inverse=True)
    return some, at
