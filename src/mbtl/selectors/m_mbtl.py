"""M-MBTL: cover the context space by sequential clustering; returns are never read.

Each pick adds one centre to those that are already there and stay where they are, so as to minimise

    Phi(C) = sum_x w_x min_{c in C} |x - c|_1        distance in grid steps

by Lloyd's iteration from many starts: the contexts nearer to the new centre than to any old one are
its cluster, and it moves to their mean. Source: SD-MBTL (AAAI 2026), "M" for mountain: its rule for
constant training performance and return that falls with distance.

Notation (shapes): N contexts, S starts, D columns of grid steps.
    covered  (N,)  distance of each context to the nearest centre so far
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from mbtl.arrays import Array, Indices, Mask
from mbtl.history import History
from mbtl.selectors.base import (
    Proposal,
    SelectionProblem,
    likely_candidates,
    nearest_open,
    open_candidates,
)
from mbtl.selectors.contract import Traits

_SEED = 0  # of the starts: the same contexts at every pick, whatever the study's seed
_ITERATIONS, _TOLERANCE = 300, 1e-6  # published
_DIGITS = 9  # of a mean: a half stays a half however it was summed
_TIE = 1e-9  # distances and costs closer than this are equal, whatever the order of their sums
_BLOCK_ENTRIES = 1 << 20  # start x context distances held at once: two arrays of 8 MiB


@dataclass(frozen=True)
class MMBTL:
    """Mountain MBTL.

    Four things differ from the published code. A centre that rounds to a context already taken is
    passed over for the next best start, where the published code trains that context again. Pending
    and failed contexts are centres too: the first are being trained, and around the second other
    places come first. Contexts where trainings are expected to fail are passed over, too. The
    starts of equal cost are told apart by the lowest index; the published order is a random one.
    Kept, because harmless: assignment by L1 distance with the cluster's mean (not its median) as
    centre, and rounding half to even.

    Attributes:
        starts: number of contexts that Lloyd's iteration starts from; all if there are fewer.
    """

    starts: int = 400
    name: str = "m-mbtl"
    traits: ClassVar[Traits] = Traits(deterministic=True)

    def propose(
        self, problem: SelectionProblem, history: History, rng: np.random.Generator
    ) -> Proposal:
        """The middle first, then where a new centre settles; ties to the lowest index."""
        mask = likely_candidates(problem, history, open_candidates(problem, history))
        if not history.tried:
            return middle(problem, mask)
        covered = _distances(problem.steps[list(history.tried)], problem.steps).min(axis=0)
        centres, costs = settle(problem, covered, problem.steps[self._starts(problem.n)])
        source = _best_open(problem, mask, centres, costs)
        cost = np.minimum(covered, _distances(problem.steps[[source]], problem.steps)[0])
        nearer = float((covered - cost) @ problem.weights)
        return Proposal(source, "centre of the least covered cluster", nearer)

    def _starts(self, n: int) -> Indices:
        if n <= self.starts:
            return np.arange(n)
        return np.sort(np.random.default_rng(_SEED).choice(n, self.starts, replace=False))


def middle(problem: SelectionProblem, mask: Mask) -> Proposal:
    """The mean of all contexts, rounded half to even as published (our own rule rounds down)."""
    centre = _rounded(problem, problem.weights @ problem.steps)
    return Proposal(nearest_open(problem, centre, mask), "middle of the range")


def settle(problem: SelectionProblem, covered: Array, starts: Array) -> tuple[Array, Array]:
    """Lloyd's iteration of one new centre from each start, the old centres staying where they are.

    Args:
        problem: gives steps and weights.
        covered: (N,) distance to the nearest old centre.
        starts: (S, D) grid steps.

    Returns:
        (S, D) centres and (S,) Phi with each of them added, both in grid steps.
    """
    steps = problem.steps
    moments = np.column_stack([problem.weights, problem.weights[:, None] * steps])
    centres, costs = starts.copy(), np.empty(len(starts))
    size = max(_BLOCK_ENTRIES // problem.n, 1)
    for start in range(0, len(starts), size):
        block = np.arange(start, min(start + size, len(starts)))
        moving = block
        for _ in range(_ITERATIONS):
            mine = _distances(centres[moving], steps) < covered - _TIE
            sums = mine @ moments
            filled = sums[:, 0] > 0  # a start that serves nobody better stays where it is
            moving, sums = moving[filled], sums[filled]
            moved = sums[:, 1:] / sums[:, :1]
            still = np.abs(moved - centres[moving]).max(axis=1) <= _TOLERANCE
            centres[moving] = moved
            moving = moving[~still]
            if not moving.size:
                break
        reached = np.minimum(_distances(centres[block], steps), covered)
        costs[block] = reached @ problem.weights
    return centres, costs


def _best_open(problem: SelectionProblem, mask: Mask, centres: Array, costs: Array) -> int:
    """The context of the cheapest centre that is open, the first of equals."""
    left = np.ones(len(costs), dtype=bool)
    everything = np.ones(problem.n, dtype=bool)
    first = None
    while left.any():
        best = int(np.flatnonzero(left & (costs <= costs[left].min() + _TIE))[0])
        centre = _rounded(problem, centres[best])
        context = nearest_open(problem, centre, everything)
        if mask[context]:
            return context
        first = centre if first is None else first
        left &= (np.abs(centres - centres[best]) > _TIE).any(axis=1)  # equal centres, equal fate
    assert first is not None
    return nearest_open(problem, first, mask)


def _rounded(problem: SelectionProblem, point: Array) -> Array:
    """A point moved to the integer grid; on a list of contexts that is none it stays."""
    on_grid = np.array_equal(problem.steps, np.round(problem.steps))
    return np.round(np.round(point, _DIGITS)) if on_grid else point


def _distances(a: Array, b: Array) -> Array:
    """(S, D), (N, D) -> (S, N) L1 distances in grid steps."""
    from scipy.spatial.distance import cdist  # kept out of `import mbtl`

    return np.asarray(cdist(a, b, "cityblock"))
