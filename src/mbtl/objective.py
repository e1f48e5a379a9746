"""Objective: what a set of trained policies is worth. Pure functions on arrays.

Notation (shapes):
    J        (N, N)   transfer matrix, axis order (source, target), performance
    rows     (k, N)   transfer rows of the trained sources, in training order
    weights  (N,)     target weights, >= 0, sum 1 (uniform: 1/N)
    best     (N,)     generalisation performance J(pi_1:k, x') = max over trained policies
    V        scalar   sum_t weights_t best_t; with a risk r < 1, the mean over the worst share r of
                      the weight alone (conditional value at risk)
Return is in raw units; performance is return after normalisation, larger is better.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from mbtl.arrays import Array
from mbtl.errors import InvalidInput
from mbtl.plain import LARGEST, is_finite, short

__all__ = [
    "Bounds",
    "Direction",
    "Objective",
    "direction_named",
    "generalisation_gap",
    "generalisation_performance",
    "k_star",
    "marginal_gain",
    "regret",
    "value",
    "value_curve",
    "worst_share_mean",
    "worst_share_weights",
]

Direction = Literal["maximize", "minimize"]


_DIRECTIONS: dict[str, Direction] = {"max": "maximize", "min": "minimize"}


def direction_named(text: str) -> Direction:
    """The direction behind a name: "maximize" or "max", "minimize" or "min".

    Raises:
        InvalidInput: anything else.
    """
    for brief, long in _DIRECTIONS.items():
        if isinstance(text, str) and text in (brief, long):
            return long
    raise InvalidInput(
        f"direction must be 'maximize' or 'minimize' ('max' or 'min' for short), got {short(text)}"
    )


@dataclass(frozen=True)
class Bounds:
    """Affine normalisation of returns: performance 0 at the worst bound, 1 at the best.

    A return beyond a bound gives a performance below 0 or above 1, unless there is a floor. Bounds
    unpack like the pair (low, high), and may be given wherever that is asked for.

    Attributes:
        low: smaller return.
        high: larger return.
        direction: "maximize" (`high` is best) or "minimize" (`low` is best); "max" and "min" will
            do, and are kept as the long names.
        floor: return below which none is worse (above which, if minimised); None: nothing is
            clipped.
    """

    low: float
    high: float
    direction: Direction = "maximize"
    floor: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "direction", direction_named(self.direction))
        most = 2.0 * LARGEST  # means of returns are rounded
        proper = is_finite(self.low, most) and is_finite(self.high, most)
        if not (proper and float(self.high) - float(self.low) >= 1.0 / LARGEST):
            raise InvalidInput(
                f"bounds must be finite, within {most:g}, and low < high by {1.0 / LARGEST:g} or "
                f"more, got ({short(self.low)}, {short(self.high)}); where small returns are good, "
                "say so by direction='minimize' and keep this order"
            )
        if self.floor is not None and not is_finite(self.floor):
            raise InvalidInput(
                f"a floor must be a return within {LARGEST:g}, got {short(self.floor)}"
            )

    def __iter__(self) -> Iterator[float]:
        return iter((self.low, self.high))

    def __len__(self) -> int:
        return 2

    def __getitem__(self, index: int) -> float:
        return (self.low, self.high)[index]

    def __str__(self) -> str:
        """What performance 0 and 1 mean, in a sentence."""
        worst, best = self if self.direction == "maximize" else (self.high, self.low)
        clipped = "nothing is clipped"
        if self.floor is not None:
            clipped = f"returns that are worse than {self.floor:g} count as {self.floor:g}"
        return f"performance 0 is a return of {worst:g}, 1 of {best:g}; {clipped}"

    @classmethod
    def of(cls, returns: ArrayLike, direction: Direction = "maximize") -> Bounds:
        """Smallest bounds that hold all finite `returns`; a constant array gets a width."""
        values = np.asarray(returns, dtype=np.float64)
        values = values[np.isfinite(values)]
        if values.size == 0:
            raise InvalidInput("automatic bounds need at least one finite return; got none")
        low, high = float(values.min()), float(values.max())
        if high - low < 1.0 / LARGEST:
            high = low + max(1.0, 1e-9 * abs(low))
        return cls(low, high, direction)

    def normalise(self, returns: ArrayLike) -> Array:
        """Return -> performance, same shape."""
        r = np.asarray(returns, dtype=np.float64)
        span = self.high - self.low
        if self.direction == "maximize":
            return ((r if self.floor is None else np.maximum(r, self.floor)) - self.low) / span
        return (self.high - (r if self.floor is None else np.minimum(r, self.floor))) / span

    def denormalise(self, performance: ArrayLike) -> Array:
        """Performance -> return, same shape."""
        p = np.asarray(performance, dtype=np.float64)
        span = self.high - self.low
        return self.low + p * span if self.direction == "maximize" else self.high - p * span


@dataclass(frozen=True)
class Objective:
    """What a study aims at: the generalisation performance V, on a scale.

    Attributes:
        bounds: (low, high) of the returns, or `Bounds`, whose direction and floor then count; None
            takes those of the problem, else the range told so far.
        direction: "maximize" or "minimize" the returns; None: the problem's, else maximize.
        risk: V is the mean over this share of the targets, those that do worst; 1 for all.
        best_return: the largest return there is (smallest, if minimised); None: not known.
    """

    bounds: tuple[float, float] | Bounds | None = None
    direction: Direction | str | None = None
    risk: float = 1.0
    best_return: float | None = None


def generalisation_performance(rows: Array) -> Array:
    """Per target, the best performance among the trained policies; (k, N) -> (N,).

    Returns:
        (N,) maxima; -inf everywhere when nothing was trained. NaN entries (targets a policy was not
        evaluated on) are ignored.
    """
    rows = np.atleast_2d(np.asarray(rows, dtype=np.float64))
    if rows.shape[0] == 0:
        return np.full(rows.shape[1], -np.inf)
    return np.asarray(np.fmax.reduce(rows, axis=0, initial=-np.inf))


def value(best: Array, weights: Array | None = None, risk: float = 1.0) -> float:
    """V = sum_t w_t best_t (paper, section 3); uniform weights when none are given.

    Args:
        best: (N,) generalisation performance.
        weights: (N,) target weights, sum 1.
        risk: share of the weight, the worst of it, that counts; 1 for all of it.
    """
    if risk < 1.0:
        return float(worst_share_mean(best, weights, risk))
    return float(best.mean()) if weights is None else float(best @ weights)


def worst_share_mean(best: Array, weights: Array | None, risk: float) -> Array:
    """Mean over the targets that do worst, up to a share `risk` of the weight; (..., N) -> (...).

    The last target that fits in part counts with that part, so the measure is continuous.

    Raises:
        InvalidInput: `risk` is not in (0, 1].
    """
    counted = worst_share_weights(best, weights, risk)
    return np.asarray(np.sum(np.where(counted > 0, best, 0.0) * counted, axis=-1))


def worst_share_weights(best: Array, weights: Array | None, risk: float) -> Array:
    """How much each target counts in `worst_share_mean`; (..., N) -> (..., N), sum 1.

    Raises:
        InvalidInput: `risk` is not in (0, 1].
    """
    if not 0.0 < risk <= 1.0:
        raise InvalidInput(f"risk is the share of the worst targets, in (0, 1], got {risk!r}")
    n = best.shape[-1]
    shares = np.full(n, 1.0 / n) if weights is None else weights
    if risk == 1.0:
        return np.broadcast_to(shares, best.shape)
    order = np.argsort(best, axis=-1, kind="stable")
    sorted_shares = shares[order]
    before = np.cumsum(sorted_shares, axis=-1) - sorted_shares
    counted = np.empty(best.shape)
    np.put_along_axis(counted, order, np.clip(risk - before, 0.0, sorted_shares) / risk, axis=-1)
    return counted


def value_curve(rows: Array, weights: Array | None = None, risk: float = 1.0) -> Array:
    """V after 1, 2, ..., k trainings; (k, N) -> (k,). Non-decreasing."""
    running = np.fmax.accumulate(np.asarray(rows, dtype=np.float64), axis=0)
    if risk < 1.0:
        return worst_share_mean(running, weights, risk)
    return running.mean(axis=1) if weights is None else running @ weights


def marginal_gain(rows: Array, best: Array, weights: Array | None = None) -> Array:
    """Gain in V from adding each row alone: sum_t w_t [row_t - best_t]_+; (M, N) -> (M,)."""
    gain = np.maximum(np.atleast_2d(rows) - best, 0.0)
    return gain.mean(axis=1) if weights is None else gain @ weights


def generalisation_gap(matrix: Array) -> Array:
    """dJ(pi_x, x') = |J(pi_x, x) - J(pi_x, x')|; (N, N) -> (N, N)."""
    return np.abs(np.diagonal(matrix)[:, None] - matrix)


def regret(matrix: Array, sources: ArrayLike, weights: Array | None = None) -> Array:
    """Per-pick regret against the best pick given the same history (method, section 4).

    r_k = max_x V(x; pi_1:k-1) - V(x_k; pi_1:k-1)

    Args:
        matrix: (N, N) performance, (source, target).
        sources: (K,) picked source indices in order.
        weights: (N,) target weights; uniform when missing.

    Returns:
        (K,) regrets, >= 0.
    """
    best = np.full(matrix.shape[1], -np.inf)
    regrets = []
    for source in np.asarray(sources, dtype=np.intp):
        reached = np.maximum(matrix, best)
        values = reached.mean(axis=1) if weights is None else reached @ weights
        regrets.append(values.max() - values[source])
        best = reached[source]
    return np.asarray(regrets)


def k_star(curve: ArrayLike, level: float) -> int | None:
    """First number of trainings (1-based) whose V reaches `level`; None if none does."""
    reached = np.flatnonzero(np.asarray(curve, dtype=np.float64) >= level)
    return int(reached[0]) + 1 if reached.size else None
