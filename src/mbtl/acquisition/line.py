"""The optimistic gain on one axis, exactly, in O(N log N) time and O(N) memory.

Split the targets of a candidate x into those on its left and those on its right. On the left
(t <= x), with p_t = theta t - best(t) and q_x = theta x - upper(x), a target improves iff
p_t > q_x, so the sum is a dominance sum

    sum_{t <= x, p_t > q_x} w_t (p_t - q_x) = P - q_x W,

with W, P the sums of w_t and w_t p_t over the dominating targets. The right side is its mirror.
Dominance sums come from one sort by value and log2(M + N) stable partitions by position: at each
level, a candidate in the right half of a node collects the targets of the left half that stand
before it in value order. Every level is a handful of array operations; nodes of 32 are summed
directly.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mbtl.acquisition.gain import check_shapes, optimistic_gain
from mbtl.arrays import Array

Index = NDArray[np.int64]

_LEAF_BITS = 5
_DENSE_BELOW = 500  # contexts; the direct formula is faster for fewer (benchmarks/pick_latency.py)


def linear_gap_gain(
    upper: Array, candidates: Array, targets: Array, best: Array, weights: Array, *, theta: float
) -> Array:
    """`optimistic_gain` by whichever exact method is faster for this size and dimension."""
    if candidates.shape[1] > 1 or len(targets) < _DENSE_BELOW:
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
    x, t = candidates[:, 0], targets[:, 0]
    left = _dominance_sum(x, t, theta * x - upper, theta * t - best, weights, ties=True)
    right = _dominance_sum(-x, -t, -theta * x - upper, -theta * t - best, weights, ties=False)
    return np.maximum(left + right, 0.0)


def _dominance_sum(x: Array, t: Array, q: Array, p: Array, weights: Array, *, ties: bool) -> Array:
    """(M,) sums over targets with t <= x (t < x without `ties`) and p > q of weights (p - q)."""
    m, total = len(x), len(x) + len(t)
    is_target = np.concatenate([np.zeros(m, dtype=bool), np.ones(len(t), dtype=bool)])
    place = np.concatenate([x, t])
    first = is_target if ties else ~is_target  # who stands before whom at an equal place
    rank: Index = np.empty(total, dtype=np.int64)
    rank[np.lexsort((~first, place))] = np.arange(total)

    near = _leaf_sums(rank[:m], rank[m:], q, p, weights)
    order = np.argsort(-np.concatenate([q, p]), kind="stable")
    rank, is_target = rank[order], is_target[order]
    weight = np.concatenate([np.zeros(m), weights])[order]
    weighted = np.concatenate([np.zeros(m), weights * p])[order]
    owner = order
    sum_w, sum_wp = np.zeros(total), np.zeros(total)
    running, lows = np.zeros(total + 1), np.zeros(total + 1, dtype=np.int64)

    index = np.arange(total)
    for bit in range(max(total - 1, 1).bit_length() - 1, _LEAF_BITS - 1, -1):
        start = rank & (-1 << (bit + 1))  # ranks are 0..total-1, so nodes are contiguous
        low = (rank & (1 << bit)) == 0
        gives = low & is_target
        takes = np.flatnonzero(~(low | is_target))
        for terms, sums in ((weight, sum_w), (weighted, sum_wp)):
            np.cumsum(terms * gives, out=running[1:])
            sums[owner[takes]] += running[takes] - running[start[takes]]
        np.cumsum(low, out=lows[1:])
        lows_before = lows[:-1] - lows[start]
        goes = np.where(low, start + lows_before, (1 << bit) + index - lows_before)
        for array in (rank, is_target, weight, weighted, owner):
            array[goes] = array.copy()
    return np.asarray(sum_wp[:m] - q * sum_w[:m] + near)


def _leaf_sums(x_rank: Index, t_rank: Index, q: Array, p: Array, weights: Array) -> Array:
    """The part of the dominance sum whose target lies in the candidate's own leaf of 32 ranks."""
    size = 1 << _LEAF_BITS
    leaves = -(-(len(x_rank) + len(t_rank)) // size)
    by_rank_q, by_rank_p = np.full(leaves * size, np.inf), np.full(leaves * size, -np.inf)
    by_rank_w, out = np.zeros(leaves * size), np.empty((leaves, size))
    by_rank_q[x_rank], by_rank_p[t_rank], by_rank_w[t_rank] = q, p, weights
    before = np.triu(np.ones((size, size)), 1)  # target's rank below the candidate's
    for start in range(0, leaves, 16):  # 16 leaves are 128 KiB
        block = slice(start * size, (start + 16) * size)
        gain = by_rank_p[block].reshape(-1, size, 1) - by_rank_q[block].reshape(-1, 1, size)
        np.maximum(gain, 0.0, out=gain)
        gain *= before
        out[start : start + 16] = np.matmul(by_rank_w[block].reshape(-1, 1, size), gain)[:, 0]
    return np.asarray(out.ravel()[x_rank])
