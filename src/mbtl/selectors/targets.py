"""Targets: where to evaluate a policy when not everywhere.

The same targets for every policy, but for one, so that policies can be compared: evenly spaced on
one axis, centres of clusters in unit coordinates on several, by weight, with every level of a
categorical axis among them. Targets chosen by expected gain were worse (docs/studies.md).

Notation (shapes): N contexts, D columns, T targets.
"""

from __future__ import annotations

import numpy as np

from mbtl.arrays import Array, Indices
from mbtl.contexts import Categorical
from mbtl.selectors.base import SelectionProblem

_SAMPLE = 5000
"""Contexts that are clustered, where there are more."""
_SEED, _RESTARTS = 0, 4


def spread_targets(problem: SelectionProblem, source: int, count: int) -> tuple[int, ...]:
    """At most `count` targets spread over the contexts, the nearest one moved to the source.

    Contexts without weight are no targets, but for the source itself.
    """
    if count >= problem.n:
        return tuple(range(problem.n))
    chosen = list(_base(problem, count))
    if source not in chosen and len(chosen) < count:
        chosen.append(source)
    elif source not in chosen:
        chosen[_replaceable(problem, chosen, source)] = source
    return tuple(sorted(chosen))


def _base(problem: SelectionProblem, count: int) -> tuple[int, ...]:
    """Without a source; a study asks with the same problem again and again."""
    key = (problem.unit.tobytes(), problem.weights.tobytes(), count)
    known = _KNOWN.get(key)
    if known is None:
        weighty = np.flatnonzero(problem.weights > 0)
        if len(weighty) <= count:
            found = weighty
        elif problem.is_line:
            found = _even(problem, weighty, count)
        else:
            found = _with_levels(problem, weighty, _centres(problem, weighty, count))
        _KNOWN.clear()
        known = _KNOWN[key] = tuple(found.tolist())
    return known


_KNOWN: dict[tuple[bytes, bytes, int], tuple[int, ...]] = {}


def _even(problem: SelectionProblem, among: Indices, count: int) -> Indices:
    """Both ends, and between them as many as there is weight."""
    order = among[np.argsort(problem.line[among], kind="stable")]
    weight = problem.weights[order]
    middle = np.cumsum(weight) - weight / 2.0
    share = (middle - middle[0]) / (middle[-1] - middle[0])
    at = np.linspace(0.0, 1.0, count) if count > 1 else np.array([0.5])
    return order[_distinct(np.interp(at, share, np.arange(len(order))), len(order))]


def _distinct(places: Array, n: int) -> Indices:
    """Rising places as whole numbers below n, no two alike."""
    found = places.round().astype(np.intp)
    for i in range(1, len(found)):
        found[i] = max(found[i], found[i - 1] + 1)
    for i in reversed(range(len(found))):
        found[i] = min(found[i], n - len(found) + i)
    return found


def _centres(problem: SelectionProblem, among: Indices, count: int) -> Indices:
    """Contexts nearest to the centres of as many clusters, no two alike."""
    from sklearn.cluster import KMeans  # kept out of `import mbtl`

    if len(among) > _SAMPLE:
        some = np.random.default_rng(_SEED).permutation(len(among))[:_SAMPLE]
        among = np.sort(among[some])
    points, weight = problem.unit[among], problem.weights[among]
    fit = KMeans(count, n_init=_RESTARTS, random_state=_SEED).fit(
        points, sample_weight=weight / weight.max()
    )
    free = np.ones(len(among), dtype=bool)
    found = []
    for centre in fit.cluster_centers_:
        distance = np.where(free, np.square(points - centre).sum(axis=1), np.inf)
        found.append(int(distance.argmin()))
        free[found[-1]] = False
    return np.asarray(among[np.sort(found)])


def _with_levels(problem: SelectionProblem, among: Indices, chosen: Indices) -> Indices:
    """Every level of every categorical axis, as far as there are targets for them."""
    chosen = chosen.copy()
    for column in _level_columns(problem):
        has = problem.unit[:, column] > 0
        if has[chosen].any() or not has[among].any():
            continue
        here = among[has[among]]
        middle = np.average(problem.unit[here], axis=0, weights=problem.weights[here])
        source = int(here[np.square(problem.unit[here] - middle).sum(axis=1).argmin()])
        chosen[_replaceable(problem, chosen.tolist(), source)] = source
    return np.sort(chosen)


def _replaceable(problem: SelectionProblem, chosen: list[int], by: int) -> int:
    """Position of the target to give up for another: the nearest whose levels others have, too."""
    unit, columns = problem.unit, _level_columns(problem)
    levels = unit[np.ix_(chosen, columns)] > 0
    needed = levels & (levels.sum(axis=0) == 1) & ~(unit[by, columns] > 0)
    distance = np.square(unit[chosen] - unit[by]).sum(axis=1)
    if not needed.any(axis=1).all():
        distance = np.where(needed.any(axis=1), np.inf, distance)
    return int(distance.argmin())


def _level_columns(problem: SelectionProblem) -> list[int]:
    """Columns that are a level of a categorical axis each."""
    kinds = [isinstance(axis, Categorical) for axis in problem.axes for _ in range(axis.width)]
    return np.flatnonzero(kinds).tolist()
