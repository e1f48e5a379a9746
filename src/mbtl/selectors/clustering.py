"""K-means: the clustering baseline that knows its budget and never looks at a return."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar

import numpy as np

from mbtl.arrays import Array
from mbtl.history import History
from mbtl.selectors.base import Proposal, SelectionProblem, open_candidates
from mbtl.selectors.contract import Traits

_SEED, _RESTARTS = 0, 10


@dataclass(frozen=True)
class KMeansSelector:
    """The contexts nearest to the centres of a K-means with K = budget, largest cluster first.

    Clusters are found in unit-cube coordinates, targets counting by their weight. As with
    `Equidistant`, every training that was begun uses up its centre, whatever came of it.
    """

    name: str = "kmeans"
    traits: ClassVar[Traits] = Traits(deterministic=True)

    def propose(
        self, problem: SelectionProblem, history: History, rng: np.random.Generator
    ) -> Proposal:
        """The open context nearest to the next centre; the lowest index on a tie."""
        mask = open_candidates(problem, history)
        unit, weights = problem.unit, problem.weights
        centres = _centres(unit.tobytes(), weights.tobytes(), unit.shape, problem.budget)
        distance = np.linalg.norm(unit - centres[len(history.tried) % problem.budget], axis=1)
        distance[~mask] = np.inf
        source = int(np.flatnonzero(distance <= distance.min() + 1e-9)[0])
        return Proposal(source, f"centre of one of {problem.budget} clusters")


@lru_cache(maxsize=4)
def _centres(unit: bytes, weights: bytes, shape: tuple[int, int], k: int) -> Array:
    """(K, D) centres, largest cluster first, then the one whose first context comes first.

    A pure function of its arguments, remembered: all picks of a study share one clustering.
    """
    from sklearn.cluster import KMeans  # kept out of `import mbtl`

    points = np.frombuffer(unit).reshape(shape)
    share = np.frombuffer(weights)
    share = share / share.max()  # equal weights become ones: sizes are counts, and ties are exact
    fit = KMeans(k, n_init=_RESTARTS, random_state=_SEED).fit(points, sample_weight=share)
    sizes = np.bincount(fit.labels_, weights=share, minlength=k)
    labels, first = np.unique(fit.labels_, return_index=True)
    opens = np.full(k, len(points))
    opens[labels] = first
    order = np.lexsort((opens, -sizes))
    return np.asarray(fit.cluster_centers_[order])
