"""Relevance of the axes: along which of them does performance change, and where contexts lie then.

A transfer model measures distance as the root mean square over axes, each counting the same. Whole
rows tell more: what one policy does along every axis. The weight of an axis maximises

    log p(y | w) - sum_a (log w_a - mean)^2 / (2 tau^2)

of the transfer model itself, by a coordinate search over log w. With A axes the weights have mean
square 1: if one alone matters, its weight is sqrt(A), and distance is what it would be without the
others. Two things keep them cautious. Few rows speak softly: logarithms shrink by k / (k + k0)
after k of them. And no weight falls below a floor: two trainings that differ in an irrelevant axis
are still two trainings, and a model that takes them for one blames the place when one has failed.

Notation (shapes): N contexts, D columns, A axes (a categorical axis has a column per level).
    w     (A,)    relevance
    axis  (D,)    which axis a column belongs to
Source: automatic relevance determination (Neal 1996), here on distances and with shrinkage.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mbtl.arrays import Array
from mbtl.contexts import Axis, Categorical, Log
from mbtl.errors import InvalidInput
from mbtl.models.transfer_gp import TransferGP
from mbtl.models.transfer_kernel import Pairs, Places, TransferPrior

_TAU = 1.0
"""Prior standard deviation of log w."""
_ROWS = 2.0
"""Rows that "all axes count the same" is worth (k0)."""
_FLOOR = 0.35
_MOST_PAIRS = 160
"""Observations used: relevance is a matter of few numbers, and every trial value costs O(n^3)."""
_STEPS = (1.0, 0.5)
"""Steps of the search in log w, one sweep over the axes each."""
_FARTHEST = 3.0


@dataclass(frozen=True)
class Columns:
    """What the columns of a context space are.

    Attributes:
        axis: (D,) index of the axis of each column, from 0 without gaps.
        ratios: (D,) True where equal ratios of the values have a meaning that x does not show yet:
            not on a logarithmic axis, where x shows them, nor on a categorical one.
    """

    axis: NDArray[np.intp]
    ratios: NDArray[np.bool_]

    @classmethod
    def of(cls, axes: Sequence[Axis], width: int) -> Columns:
        """Columns of these axes; with none given, `width` linear axes of one column each.

        Raises:
            InvalidInput: the axes do not have `width` columns together.
        """
        if not axes:
            return cls(np.arange(width), np.ones(width, dtype=bool))
        widths = [axis.width for axis in axes]
        if sum(widths) != width:
            raise InvalidInput(
                f"axes must have as many columns as the coordinates ({width}), got {sum(widths)} "
                f"of {len(axes)} axes; give the axes of the context space itself"
            )
        ratios = [not isinstance(axis, (Categorical, Log)) for axis in axes]
        return cls(np.repeat(np.arange(len(axes)), widths), np.repeat(ratios, widths))

    @property
    def count(self) -> int:
        """Number of axes A."""
        return int(self.axis[-1]) + 1

    def places(self, unit: Array, steps: Array) -> Places:
        """Where the contexts lie when every axis counts the same, whatever its number of columns.

        Args:
            unit: (N, D) unit-cube coordinates.
            steps: (N, D) grid steps.
        """
        plain = Places.of(unit, steps)
        z = np.where(self.ratios, plain.z, plain.x)
        if len(self.axis) == self.count:
            return Places(plain.x, z)
        scale = np.sqrt(len(self.axis) / self.count)  # distances are means over columns
        return Places(plain.x * scale, z * scale)


def stretched(places: Places, weights: Array) -> Places:
    """The same with columns scaled by (D,) weights, such as `relevance[columns.axis]`."""
    return Places(places.x * weights, places.z * weights)


def fit_relevance(
    places: Places,
    axis: NDArray[np.intp],
    prior: TransferPrior,
    pairs: Pairs,
    y: Array,
) -> Array:
    """Weights of the axes that the rows seen speak for.

    Args:
        places: of all contexts, every axis counting the same.
        axis: (D,) index of the axis of each column.
        prior: of the transfer model.
        pairs: (n, 3) observed.
        y: (n,) performance there, finite.

    Returns:
        (A,) of mean square 1; ones where there is one axis, no data, or nothing to tell.
    """
    count = int(axis.max()) + 1
    if count == 1 or len(y) < 2:
        return np.ones(count)
    rows = len(np.unique(pairs[:, 2]))
    if len(y) > _MOST_PAIRS:
        some = np.sort(np.random.default_rng(0).choice(len(y), _MOST_PAIRS, replace=False))
        pairs, y = pairs[some], y[some]
    used, where = np.unique(pairs[:, :2], return_inverse=True)
    pairs = np.column_stack([where.reshape(-1, 2), pairs[:, 2]])
    small = Places(places.x[used], places.z[used])

    def score(logs: Array) -> float:
        weights = _unit_mean_square(np.exp(logs))[axis]
        try:
            model = TransferGP(stretched(small, weights), prior, pairs, y)
        except np.linalg.LinAlgError:
            return -np.inf
        spread = np.square(logs - logs.mean()).sum()
        return float(model.log_likelihood - 0.5 * spread / _TAU**2)

    logs = _climb(score, count)
    shrunk = np.exp(logs * rows / (rows + _ROWS))
    return _unit_mean_square(np.maximum(_unit_mean_square(shrunk), _FLOOR))


def _climb(score: Callable[[Array], float], count: int) -> Array:
    """(count,) a local maximum near zero, one coordinate after the other."""
    logs = np.zeros(count)
    best = score(logs)
    for step in _STEPS:
        for axis in range(count):
            for direction in (-step, step):
                while abs(logs[axis] + direction) <= _FARTHEST:
                    tried = logs.copy()
                    tried[axis] += direction
                    value = score(tried)
                    if value <= best:
                        break
                    logs, best = tried, value
    return logs


def _unit_mean_square(weights: Array) -> Array:
    return np.asarray(weights / np.sqrt(np.mean(np.square(weights))))
