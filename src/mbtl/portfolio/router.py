"""Routing: which trained policy serves a context, and what return it should earn there.

On a listed context the measured returns decide; a policy evaluated on some contexts only counts as
on the nearest of those (`mbtl.objective.nearest_filled`). Elsewhere each is judged by its own row:

    grid, one axis    linear interpolation between the grid points around the context (multilinear
                      with more axes; beyond the outermost grid value, that value's return)
    other point list  mean of the 2d nearest listed contexts, weighted by 1 / distance^2 in steps
    nothing measured  linear gap model: J(pi_i, x_i) - theta |x - x_i|, distance in grid steps
                      (paper, Assumption 1); also for a categorical level that no listed context has

Notation (shapes): k policies, N listed contexts.
    performance  (k, N)   larger is better; NaN where a policy was not evaluated
    sources      (k,)     context index each policy was trained on
    distance     (k,)     Euclidean norm, in grid steps, from each source to the context
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mbtl.arrays import Array
from mbtl.contexts import Categorical, ContextSpace, Value
from mbtl.errors import ContextMismatch

Basis = Literal["observed", "interpolated", "gap model"]
Indices = NDArray[np.intp]

_TIE_DECIMALS = 12  # performances equal to this many decimals are a tie


@dataclass(frozen=True, eq=False)
class Forecast:
    """What each policy should achieve on one context.

    Attributes:
        performance: (k,) NaN where nothing can be said.
        basis: (k,) where each number comes from.
        distance: (k,) grid steps from each source.
        target: index of the context, None off the list.
    """

    performance: Array
    basis: tuple[Basis, ...]
    distance: Array
    target: int | None

    def ranking(self, sources: Sequence[int]) -> list[int]:
        """Policies from best to worst (ties: distance, source index); unknown ones left out."""
        order = _order(self.performance, self.distance, np.asarray(sources, dtype=np.intp))
        return [int(i) for i in order if np.isfinite(self.performance[i])]


def forecast(
    space: ContextSpace,
    sources: Sequence[int],
    performance: Array,
    theta: float,
    context: Mapping[str, Value],
) -> Forecast:
    """Performance of every policy on `context`, and how it is known.

    On a listed context that any policy was evaluated on, measured values are all that counts: a
    policy without one is left out (NaN) rather than compared by a guess.

    Raises:
        ContextMismatch: the context lies outside the axes.
    """
    here = space.encode_steps(context)
    distance = np.linalg.norm(space.steps[list(sources)] - here, axis=1)
    target = _listed(space, context)
    if target is not None and np.isfinite(performance[:, target]).any():
        seen_here: tuple[Basis, ...] = tuple("observed" for _ in performance)
        return Forecast(performance[:, target], seen_here, distance, target)
    nearby, weights = _neighbours(space, here)
    values = np.empty(len(performance))
    basis: list[Basis] = []
    for i, (row, source) in enumerate(zip(performance, sources, strict=True)):
        seen = np.isfinite(row[nearby]) & (weights > 0)
        if seen.any():
            values[i] = np.average(row[nearby][seen], weights=weights[seen])
            basis.append("interpolated")
        else:
            values[i] = row[source] - theta * distance[i]
            basis.append("gap model")
    return Forecast(values, tuple(basis), distance, target)


def assign(space: ContextSpace, sources: Sequence[int], performance: Array) -> Indices:
    """(N,) policy of every listed context by measured returns; -1 where none was evaluated.

    The same rule as `forecast(...).ranking(...)[0]`, for all contexts at once.
    """
    index = np.asarray(sources, dtype=np.intp)
    scores = np.round(np.where(np.isfinite(performance), performance, -np.inf), _TIE_DECIMALS)
    best = scores.max(axis=0)
    chosen = np.full(space.n, -1, dtype=np.intp)
    nearest = np.full(space.n, np.inf)
    for i in np.lexsort(
        (np.arange(len(index)), index)
    ):  # lowest source index first, so it wins a tie
        distance = np.linalg.norm(space.steps - space.steps[index[i]], axis=1)
        wins = (scores[i] == best) & np.isfinite(best) & (distance < nearest)
        chosen[wins], nearest[wins] = i, distance[wins]
    return chosen


def _order(performance: Array, distance: Array, sources: Indices) -> Indices:
    scores = np.round(np.where(np.isfinite(performance), performance, -np.inf), _TIE_DECIMALS)
    return np.lexsort((np.arange(len(sources)), sources, distance, -scores))


def _listed(space: ContextSpace, context: Mapping[str, Value]) -> int | None:
    try:
        return space.index(context)
    except ContextMismatch:  # inside the axes, as `encode_steps` has checked, but not on the list
        return None


def _neighbours(space: ContextSpace, here: Array) -> tuple[Indices, Array]:
    """Listed contexts around a point, and their weights (sum 1)."""
    if space.shape:
        return _cell(space, here)
    if space.steps.shape[1] == 1:
        return _bracket(space.steps[:, 0], float(here[0]))
    squared = ((space.steps - here) ** 2).sum(axis=1)
    n = min(2 * space.d, space.n)
    nearby = np.argsort(squared, kind="stable")[:n]
    weights = 1.0 / np.maximum(squared[nearby], 1e-18)
    return nearby, weights / weights.sum()


def _bracket(line: Array, x: float) -> tuple[Indices, Array]:
    order = np.argsort(line, kind="stable")
    position = np.interp(x, line[order], np.arange(len(line)))
    below = int(np.floor(position))
    above = min(below + 1, len(line) - 1)
    share = position - below
    return order[[below, above]], np.array([1.0 - share, share])


def _cell(space: ContextSpace, here: Array) -> tuple[Indices, Array]:
    """Corners of the grid cell that holds the point, with multilinear weights."""
    assert space.shape is not None
    corners: list[list[tuple[int, float]]] = []  # per axis: (level, weight)
    start = 0
    for axis, n in zip(space.axes, space.shape, strict=True):
        part = here[start : start + axis.width]
        start += axis.width
        if isinstance(axis, Categorical):
            listed = list(dict.fromkeys(space.values(axis.name)))
            value = axis.decode(part[None, :])[0]
            corners.append([(listed.index(value), 1.0)] if value in listed else [])
            continue
        below = min(int(np.floor(part[0])), n - 1)
        share = float(part[0]) - below
        corners.append([(below, 1.0 - share)] + ([(below + 1, share)] if share > 0 else []))
    picks = list(itertools.product(*corners))
    if not picks:  # a categorical level that no listed context has: no neighbours
        return np.empty(0, dtype=np.intp), np.empty(0)
    levels = np.array([[level for level, _ in pick] for pick in picks]).T
    weights = np.array([float(np.prod([w for _, w in pick])) for pick in picks])
    return np.ravel_multi_index(tuple(levels), space.shape), weights
