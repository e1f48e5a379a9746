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
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mbtl.arrays import Array
from mbtl.contexts import ContextSpace
from mbtl.history import standard_errors
from mbtl.models.beliefs import Beliefs
from mbtl.objective import worst_share_mean, worst_share_weights

Indices = NDArray[np.intp]

TIE_DECIMALS = 12
"""Performances that are equal to so many decimals are a tie."""
SURE = 1.96
"""Standard errors on either side of an interval of 95 %."""
_SAMPLE = 1000
"""Contexts that stand for all where more would have to be predicted, to say what V is."""
_DRAWS = 1000
"""Samples of the served performance, for a V that is no plain mean of it."""
_MANY = 1_000_000
"""Episodes from which on Student's t is the Gaussian; a damaged file may name any number."""


def routes(rows: Array, sources: Sequence[int], steps: Array) -> Indices:
    """Positions of the serving policies after 1, 2, ..., k trainings; (k, N)."""
    found = [route.copy() for route in _growing(rows, sources, steps, steps)]
    return np.array(found, dtype=np.intp).reshape(len(rows), len(steps))


def last_route(
    rows: Array, sources: Sequence[int], steps: Array, targets: Indices | None = None
) -> Indices:
    """Positions of the policies that serve after all k trainings; (N,), the last of `routes`.

    Args:
        rows: (k, N), or (k, T) on `targets` alone.
        sources: (k,).
        steps: (N, D).
        targets: (T,) contexts; None: all N.
    """
    here = steps if targets is None else steps[targets]
    route = np.zeros(len(here), dtype=np.intp)
    for grown in _growing(rows, sources, steps, here):
        route = grown
    return route


def routed(values: Array, routes: Indices) -> Array:
    """What the serving policies have: (k, N) values and (m, N) routes, m <= k -> (m, N)."""
    return np.asarray(np.take_along_axis(values, routes, axis=0))


def rank(values: Array, distance: Array, sources: Indices) -> Indices:
    """(k,) policies on one context from best to worst, by the same rule."""
    return np.lexsort((np.arange(len(sources)), sources, distance, -_scores(values)))


def _growing(rows: Array, sources: Sequence[int], steps: Array, here: Array) -> Iterator[Indices]:
    """The route at places `here` after each training; the same array again, changed in place."""
    n = len(here)
    route = np.zeros(n, dtype=np.intp)
    best, nearest, lowest = np.full(n, -np.inf), np.full(n, np.inf), np.full(n, np.inf)
    for i, (row, source) in enumerate(zip(rows, sources, strict=True)):
        score = _scores(row)
        distance = np.linalg.norm(here - steps[source], axis=1)
        nearer = (distance < nearest) | ((distance == nearest) & (source < lowest))
        wins = (score > best) | ((score == best) & nearer)
        route[wins], best[wins], nearest[wins] = i, score[wins], distance[wins]
        lowest[wins] = source
        yield route


def _scores(values: Array) -> Array:
    known = np.where(np.isfinite(values), values, -np.inf)
    return np.asarray(np.round(known, TIE_DECIMALS), dtype=np.float64)


# ---- of a study or a portfolio -------------------------------------------------------------------


@dataclass(frozen=True)
class Valuation:
    """V of policies as they are routed, by the rows that routed them.

    Attributes:
        value: V, performance.
        error: its standard error: of noise, of what was predicted, of what was sampled.
        measured: share of the weight whose serving policy was evaluated right there.
        margin: half its 95 % interval. Few episodes say little of their own scatter, so what all
            policies share of it counts by Student's t.
    """

    value: float
    error: float
    measured: float
    margin: float

    def at_least(self, confidence: float) -> float:
        """What V is at least, with this probability."""
        from scipy.special import ndtri  # kept out of `import mbtl`

        return self.value - float(ndtri(confidence)) * self.error


class Routing:
    """Who serves which context after every training of a study, and what that is worth.

    What holds after j trainings depends on the first j rows alone.

    Args:
        space: the N contexts.
        sources: (k,) contexts trained on, k >= 1.
        rows: (k, N) performance, NaN where a policy was not evaluated.
        deviations: (k, N) of single episodes, with n - 1, NaN where unknown; None: all are.
        episodes: (k,) behind each row; None: one.
        risk: share of the targets, the worst of them, that V is the mean of.
        earlier: a routing of the first rows of these, whose results are used again.
    """

    def __init__(
        self,
        space: ContextSpace,
        sources: Sequence[int],
        rows: Array,
        deviations: Array | None = None,
        episodes: Sequence[int] | None = None,
        *,
        risk: float = 1.0,
        earlier: Routing | None = None,
    ) -> None:
        """Nothing is computed yet."""
        self.space, self.sources, self.rows, self.risk = space, tuple(sources), rows, risk
        k = len(self.sources)
        self.episodes = (1,) * k if episodes is None else tuple(episodes)
        self.deviations = np.full(rows.shape, np.nan) if deviations is None else deviations
        self._after: dict[int, _After] = {}
        if earlier is not None and self._goes_on(earlier):
            self._after.update(earlier._after)

    def __len__(self) -> int:
        return len(self.sources)

    @cached_property
    def routes(self) -> Indices:
        """(k, N) positions of the serving policies after 1, 2, ..., k trainings."""
        if self.after().beliefs.exact and np.isfinite(self.rows).all():
            return routes(self.rows, self.sources, self.space.steps)
        return np.array([self.after(k).route for k in range(1, len(self) + 1)])

    @property
    def route(self) -> Indices:
        """(N,) positions of the policies that serve now."""
        return self.after().route

    @property
    def beliefs(self) -> Beliefs:
        """What all rows together say."""
        return self.after().beliefs

    @cached_property
    def believed(self) -> Array:
        """(k, N) performance: what was measured, its noise shrunk, or what is predicted."""
        return self.beliefs.on(np.arange(self.space.n))[0]

    @property
    def served(self) -> Array:
        """(N,) performance that is believed of the policies that serve now."""
        return np.asarray(self.believed[self.route, np.arange(self.space.n)])

    def after(self, k: int | None = None) -> _After:
        """What holds after k trainings; None: after all."""
        k = len(self) if k is None else k
        if k not in self._after:
            errors = standard_errors(self.deviations[:k], self.episodes[:k])
            beliefs = Beliefs(self.space, self.sources[:k], self.rows[:k], errors)
            tails = _tails(self.episodes[:k])
            self._after[k] = _After(self.space, self.sources[:k], beliefs, self.risk, tails)
        return self._after[k]

    @property
    def value(self) -> Valuation:
        """V now."""
        return self.after().value

    @property
    def curve(self) -> list[Valuation]:
        """V after 1, 2, ..., k trainings."""
        return [self.after(k).value for k in range(1, len(self) + 1)]

    def gain_over(self, policy: int) -> Valuation:
        """V less the V of one policy alone, which would serve all."""
        return self.after().gain_over(policy)

    @property
    def tails(self) -> float:
        """Student's factor over 1.96, by the fewest episodes from which scatter was told."""
        return _tails(self.episodes)

    @property
    def noise_is_known(self) -> bool:
        """False where no scatter of episodes was told: how much chance there is nobody can say."""
        several = np.asarray(self.episodes) > 1
        return bool(np.isfinite(self.deviations[several]).any())

    @cached_property
    def singles(self) -> Array:
        """(k,) V of each policy alone."""
        targets, weights = self.after().targets
        return worst_share_mean(self.beliefs.on(targets)[0], weights, self.risk)

    def _goes_on(self, earlier: Routing) -> bool:
        k = len(earlier)
        same = earlier.space is self.space and earlier.risk == self.risk
        return (
            same
            and (earlier.sources, earlier.episodes) == (self.sources[:k], self.episodes[:k])
            and np.array_equal(earlier.rows, self.rows[:k], equal_nan=True)
            and np.array_equal(earlier.deviations, self.deviations[:k], equal_nan=True)
        )


def _tails(episodes: Sequence[int]) -> float:
    """How much wider an interval of 95 % is by Student's t than by the Gaussian."""
    from scipy.special import stdtrit  # kept out of `import mbtl`

    told = [count for count in episodes if count > 1]
    return float(stdtrit(min(*told, _MANY) - 1, 0.975)) / SURE if told else 1.0


class _After:
    """What holds after some trainings; made by `Routing.after`."""

    def __init__(
        self,
        space: ContextSpace,
        sources: Sequence[int],
        beliefs: Beliefs,
        risk: float,
        tails: float,
    ) -> None:
        self._space, self._sources, self._risk = space, sources, risk
        self.beliefs, self._tails = beliefs, tails

    @cached_property
    def route(self) -> Indices:
        """(N,) positions of the serving policies."""
        found = self._route(np.arange(self._space.n))
        found.setflags(write=False)
        return found

    @cached_property
    def value(self) -> Valuation:
        """V as believed, and how sure."""
        targets, weights = self.targets
        route = self._route(targets)
        mean = self.beliefs.on(targets)[0][route, np.arange(len(targets))]
        measured = float(weights @ self.beliefs.measured[route, targets])
        counted = worst_share_weights(mean, weights, self._risk)
        found = float(counted @ mean)
        own, shared = self.beliefs.doubts(route, targets, counted)
        if self._risk < 1.0 and (own > 0.0 or shared > 0.0):
            found, worst = self._worst_share(route, targets, weights)
            own = max(own, float(np.sqrt(max(worst**2 - shared**2, 0.0))))
        return self._valued(found, own, shared, self._sampling(mean, weights), measured)

    def gain_over(self, policy: int) -> Valuation:
        """V less that of one policy alone."""
        targets, weights = self.targets
        route = self._route(targets)
        means = self.beliefs.on(targets)[0]
        served, alone = means[route, np.arange(len(targets))], means[policy]
        ours, its = (worst_share_weights(m, weights, self._risk) for m in (served, alone))
        differs = (route != policy) | (ours != its)
        own, shared = self.beliefs.doubts(
            np.concatenate([route[differs], np.full(differs.sum(), policy)]),
            np.tile(targets[differs], 2),
            np.concatenate([ours[differs], -its[differs]]),
        )
        sampling = self._sampling(served - alone, weights)
        gain = float(ours @ served - its @ alone)
        return self._valued(gain, own, shared, sampling, self.value.measured)

    def _valued(
        self, value: float, own: float, shared: float, sampling: float, measured: float
    ) -> Valuation:
        alone = float(np.hypot(own, sampling))
        margin = SURE * float(np.hypot(alone, self._tails * shared))
        return Valuation(value, float(np.hypot(alone, shared)), measured, margin)

    @cached_property
    def targets(self) -> tuple[Indices, Array]:
        """Contexts that V is computed on, and their weights, sum 1: all, if that is affordable."""
        every, weights = np.arange(self._space.n), self._space.weights
        if len(every) <= _SAMPLE or self.beliefs.exact:
            return every, weights
        some = np.random.default_rng(0).choice(len(every), _SAMPLE, replace=False, p=weights)
        return np.sort(some), np.full(_SAMPLE, 1.0 / _SAMPLE)

    def _route(self, targets: Indices) -> Indices:
        if len(targets) == self._space.n and "route" in self.__dict__:
            return self.route
        steps, found = self._space.steps, np.empty(len(targets), dtype=np.intp)
        width = len(targets) if self.beliefs.exact else max(1, 200_000 // len(self._sources))
        for first in range(0, len(targets), width):
            some = targets[first : first + width]
            mean = self.beliefs.on(some)[0]
            found[first : first + width] = last_route(mean, self._sources, steps, some)
        return found

    def _sampling(self, values: Array, weights: Array) -> float:
        """Standard error of a mean over a sample of the contexts; 0 where it is over all."""
        n, some = self._space.n, len(values)
        if some == n:
            return 0.0
        spread = float(np.sqrt(weights @ np.square(values - weights @ values)))
        return spread * float(np.sqrt((1.0 - some / n) / some))

    def _worst_share(self, route: Indices, targets: Indices, weights: Array) -> tuple[float, float]:
        """Mean and deviation of the worst share's mean: which targets are worst is not sure."""
        mean = self.beliefs.on(targets)[0][route, np.arange(len(targets))]
        believed, covariance = self.beliefs.joint(route, targets)
        spread, turn = np.linalg.eigh(covariance)
        root = turn * np.sqrt(np.maximum(spread, 0.0))
        normal = np.random.default_rng(0).standard_normal((_DRAWS, len(spread)))
        unsure = np.diagonal(covariance) > 0
        drawn = np.where(unsure, believed + normal @ root.T, mean)
        values = worst_share_mean(drawn, weights, self._risk)
        return float(values.mean()), float(values.std())
