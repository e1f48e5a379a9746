"""Routes: which of the trained policies serves which context, after every training.

One rule for everything that is shown and everything that is served: the best policy by what is
believed of it; of equals the one trained nearest, then the lowest source. Reports, fresh
evaluations, benchmarks and portfolios all take their routes from here.

Notation (shapes): k policies in training order, N targets.
    rows     (k, N)  performance believed or measured; NaN where nothing is known, which loses
    sources  (k,)    context index each policy was trained on
    steps    (N, D)  grid steps of the contexts
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from mbtl.arrays import Array

Indices = NDArray[np.intp]

TIE_DECIMALS = 12
"""Performances that are equal to so many decimals are a tie."""


def routes(rows: Array, sources: Sequence[int], steps: Array) -> Indices:
    """Positions of the serving policies after 1, 2, ..., k trainings; (k, N)."""
    found = [route.copy() for route in _growing(rows, sources, steps)]
    return np.array(found, dtype=np.intp).reshape(len(rows), len(steps))


def last_route(rows: Array, sources: Sequence[int], steps: Array) -> Indices:
    """Positions of the policies that serve after all k trainings; (N,), the last of `routes`."""
    route = np.zeros(len(steps), dtype=np.intp)
    for grown in _growing(rows, sources, steps):
        route = grown
    return route


def routed(values: Array, routes: Indices) -> Array:
    """What the serving policies have: (k, N) values and (m, N) routes, m <= k -> (m, N)."""
    return np.asarray(np.take_along_axis(values, routes, axis=0))


def rank(values: Array, distance: Array, sources: Indices) -> Indices:
    """(k,) policies on one context from best to worst, by the same rule."""
    return np.lexsort((np.arange(len(sources)), sources, distance, -_scores(values)))


def _growing(rows: Array, sources: Sequence[int], steps: Array) -> Iterator[Indices]:
    """The route after each training; the same array again, changed in place."""
    n = len(steps)
    route = np.zeros(n, dtype=np.intp)
    best, nearest, lowest = np.full(n, -np.inf), np.full(n, np.inf), np.full(n, n)
    for i, (row, source) in enumerate(zip(rows, sources, strict=True)):
        score = _scores(row)
        distance = np.linalg.norm(steps - steps[source], axis=1)
        nearer = (distance < nearest) | ((distance == nearest) & (source < lowest))
        wins = (score > best) | ((score == best) & nearer)
        route[wins], best[wins], nearest[wins] = i, score[wins], distance[wins]
        lowest[wins] = source
        yield route


def _scores(values: Array) -> Array:
    known = np.where(np.isfinite(values), values, -np.inf)
    return np.asarray(np.round(known, TIE_DECIMALS), dtype=np.float64)
