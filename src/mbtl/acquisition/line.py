"""The optimistic gain on one axis, exactly, in O(N log N) time and O(N) memory.

Halve the candidates by position, again and again, and the targets with them. Between two halves the
distance has one sign, so each side has a number of its own: a candidate x on the right improves a
target t on the left iff a_t < b_x with a_t = best(t) - theta t and b_x = upper(x) - theta x, and

    sum_{t: a_t < b_x} w_t (b_x - a_t) = b_x W - A,

with W, A the sums of w_t and w_t a_t over those targets: prefix sums over sorted a, found by one
search. For candidates on the left of their targets theta changes sign. The orders by a and b are
made once and only split afterwards; small halves are summed directly.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbtl.acquisition.gain import check_shapes, optimistic_gain
from mbtl.arrays import Array

_LEAF = 192  # candidates; the direct formula is faster for fewer (benchmarks/pick_latency.py)


def linear_gap_gain(
    upper: Array, candidates: Array, targets: Array, best: Array, weights: Array, *, theta: float
) -> Array:
    """`optimistic_gain` by whichever exact method is faster for this size and dimension."""
    if candidates.shape[1] > 1 or len(candidates) <= 2 * _LEAF:
        return optimistic_gain(upper, candidates, targets, best, weights, theta=theta)
    return line_gain(upper, candidates, targets, best, weights, theta=theta)


def line_gain(
    upper: Array, candidates: Array, targets: Array, best: Array, weights: Array, *, theta: float
) -> Array:
    """`optimistic_gain` for one axis (D = 1), in any order of candidates and targets.

    Args:
        upper: (M,) optimistic training performance.
        candidates: (M, 1) grid steps.
        targets: (N, 1) grid steps.
        best: (N,) generalisation performance so far.
        weights: (N,) target weights.
        theta: performance lost per grid step.

    Returns:
        (M,) gain in units of performance.

    Raises:
        InvalidInput: theta < 0, or shapes that do not fit.
    """
    check_shapes(candidates, targets, best, weights, theta, upper=upper)
    by_place = np.argsort(candidates[:, 0], kind="stable")
    targets_by_place = np.argsort(targets[:, 0], kind="stable")
    line = _Line(
        upper[by_place],
        candidates[by_place],
        targets[targets_by_place],
        best[targets_by_place],
        weights[targets_by_place],
        theta,
    )
    gain = np.empty(len(candidates))
    gain[by_place] = np.maximum(line.gain(), 0.0)
    return gain


class _Sorted(NamedTuple):
    """Numbers in ascending order, each with the place of its owner along the line."""

    place: NDArray[np.intp]
    number: Array

    @classmethod
    def of(cls, numbers: Array) -> _Sorted:
        order = np.argsort(numbers)
        return cls(order, numbers[order])

    def split(self, place: int) -> tuple[_Sorted, _Sorted]:
        """Owners before `place`, and the others; both stay sorted."""
        before = self.place < place
        parts = [np.flatnonzero(side) for side in (before, ~before)]
        left, right = (_Sorted(self.place[part], self.number[part]) for part in parts)
        return left, right


class _Side(NamedTuple):
    """Numbers of the targets (a) and the candidates (b) of one stretch, for one sign of theta."""

    targets: _Sorted
    candidates: _Sorted

    def split(self, target: int, candidate: int) -> tuple[_Side, _Side]:
        targets, candidates = self.targets.split(target), self.candidates.split(candidate)
        return _Side(targets[0], candidates[0]), _Side(targets[1], candidates[1])


class _Line:
    """Candidates and targets ordered along the line, and the gain summed up so far."""

    def __init__(
        self,
        upper: Array,
        candidates: Array,
        targets: Array,
        best: Array,
        weights: Array,
        theta: float,
    ) -> None:
        self.upper, self.candidates = upper, candidates
        self.targets, self.best, self.weights, self.theta = targets, best, weights, theta
        self.total = np.zeros(len(candidates))

    def gain(self) -> Array:
        """(M,) gains along the line."""
        t, x = self.theta * self.targets[:, 0], self.theta * self.candidates[:, 0]
        left = _Side(_Sorted.of(self.best - t), _Sorted.of(self.upper - x))
        right = _Side(_Sorted.of(self.best + t), _Sorted.of(self.upper + x))
        self._halve(slice(0, len(x)), slice(0, len(t)), left, right)
        return self.total

    def _halve(self, candidates: slice, targets: slice, left: _Side, right: _Side) -> None:
        """Add what the targets of a stretch give its candidates; `left`: targets on the left."""
        if candidates.stop - candidates.start <= _LEAF:
            self.total[candidates] += optimistic_gain(
                self.upper[candidates],
                self.candidates[candidates],
                self.targets[targets],
                self.best[targets],
                self.weights[targets],
                theta=self.theta,
            )
            return
        middle = (candidates.start + candidates.stop) // 2
        here = self.candidates[middle, 0]
        cut = targets.start + int(np.searchsorted(self.targets[targets, 0], here))
        (near_l, far_l), (near_r, far_r) = left.split(cut, middle), right.split(cut, middle)
        self._add(near_l.targets, far_l.candidates)
        self._add(far_r.targets, near_r.candidates)
        self._halve(slice(candidates.start, middle), slice(targets.start, cut), near_l, near_r)
        self._halve(slice(middle, candidates.stop), slice(cut, targets.stop), far_l, far_r)

    def _add(self, targets: _Sorted, candidates: _Sorted) -> None:
        """Add b W - A to candidates that all lie on the same side of all these targets."""
        weights = self.weights[targets.place]
        below = np.searchsorted(targets.number, candidates.number)
        sums = np.zeros((2, len(weights) + 1))
        np.cumsum(weights, out=sums[0, 1:])
        np.cumsum(weights * targets.number, out=sums[1, 1:])
        self.total[candidates.place] += candidates.number * sums[0][below] - sums[1][below]
