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

from mbtl.arrays import Array, Indices, Mask
from mbtl.contexts import ContextSpace
from mbtl.episodes import Episodes, scatter_of_sum, student
from mbtl.history import USUAL
from mbtl.models.beliefs import Beliefs
from mbtl.objective import worst_share_mean, worst_share_weights

__all__ = ["TIE_DECIMALS", "Routing", "Valuation", "last_route", "rank", "routed", "routes"]


TIE_DECIMALS = 12
"""Performances that are equal to so many decimals are a tie."""
SURE = 1.96
"""Standard errors on either side of an interval of 95 %."""
_SAMPLE = 1000
"""Contexts that stand for all where more would have to be predicted, to say what V is."""
_DRAWS = 1000
"""Samples of the served performance, for a V that is no plain mean of it."""


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
    """V of policies as they are routed.

    Attributes:
        value: V, performance, by episodes that did not choose the routes, and without flattery.
        error: its standard error: of noise, of what was predicted, of what was sampled.
        measured: share of the weight whose serving policy was evaluated right there.
        margin: half its 95 % interval. Contexts are independent, so their scatter is known by all
            their episodes together, as well as Student's t says.
    """

    value: float
    error: float
    measured: float
    margin: float

    def at_least(self, confidence: float) -> float:
        """What V is at least, with this probability."""
        from scipy.special import ndtri  # kept out of `import mbtl`

        return self.value - float(ndtri(confidence)) * self.margin / SURE


class Routing:
    """Who serves which context after all trainings of a study, and what that is worth.

    What holds after j trainings depends on the first j rows alone (`after`).

    Args:
        space: the N contexts.
        sources: (k,) contexts trained on, k >= 1.
        rows: (k, N) performance, NaN where a policy was not evaluated.
        episodes: behind the rows; None: one each, or exact.
        risk: share of the targets, the worst of them, that V is the mean of.
        earlier: a routing of the first rows of these, whose results are used again.
    """

    def __init__(
        self,
        space: ContextSpace,
        sources: Sequence[int],
        rows: Array,
        episodes: Episodes | None = None,
        *,
        risk: float = 1.0,
        earlier: Routing | None = None,
    ) -> None:
        """Nothing is computed yet."""
        self.space, self.sources, self.rows, self.risk = space, tuple(sources), rows, risk
        self.episodes = episodes
        self._before: dict[int, Routing] = {}
        if earlier is not None:
            self._before = {**earlier._before, len(earlier): earlier}

    def __len__(self) -> int:
        return len(self.sources)

    def after(self, k: int) -> Routing:
        """Of the first k trainings."""
        if k == len(self):
            return self
        if k not in self._before:
            episodes = None if self.episodes is None else self.episodes.first(k)
            self._before[k] = Routing(
                self.space, self.sources[:k], self.rows[:k], episodes, risk=self.risk
            )
        return self._before[k]

    @cached_property
    def route(self) -> Indices:
        """(N,) positions of the policies that serve now."""
        n, steps = self.space.n, self.space.steps
        found = np.empty(n, dtype=np.intp)
        width = n if self.beliefs.exact else max(1, 200_000 // len(self.sources))
        for first in range(0, n, width):
            some = np.arange(first, min(first + width, n))
            mean = self.beliefs.on(some)[0]
            found[some] = last_route(mean, self.sources, steps, some)
        found.setflags(write=False)
        return found

    @cached_property
    def beliefs(self) -> Beliefs:
        """What all rows together say."""
        errors = None if self.episodes is None else self.episodes.errors
        own = 1.0 if self.episodes is None or errors is None else self.episodes.own_share
        return Beliefs(self.space, self.sources, self.rows, errors, own)

    @cached_property
    def believed(self) -> Array:
        """(k, N) performance: what was measured, its noise shrunk, or what is predicted."""
        return self.beliefs.on(np.arange(self.space.n))[0]

    @property
    def served(self) -> Array:
        """(N,) performance that is believed of the policies that serve now."""
        return np.asarray(self.believed[self.route, np.arange(self.space.n)])

    @property
    def measured(self) -> Mask:
        """(N,) whether the policy that serves now was evaluated right there."""
        return np.asarray(self.beliefs.measured[self.route, np.arange(self.space.n)])

    @cached_property
    def value(self) -> Valuation:
        """V now."""
        return self._valued(None)

    @property
    def curve(self) -> list[Valuation]:
        """V after 1, 2, ..., k trainings."""
        return [self.after(k).value for k in range(1, len(self) + 1)]

    @cached_property
    def gain(self) -> Valuation:
        """V less the V of the best single policy, which would serve all."""
        return self._valued(self.best_single)

    @cached_property
    def best_single(self) -> int:
        """Position of the policy that would serve all best, by what is believed."""
        targets, weights = self.targets
        return int(worst_share_mean(self.beliefs.on(targets)[0], weights, self.risk).argmax())

    @property
    def tails(self) -> float:
        """How much wider an interval of 95 % of one context is than the Gaussian's."""
        if self.episodes is None or not self.episodes.several:
            return 1.0
        return student(USUAL + self.episodes.fewest - 1) / SURE

    @property
    def noise_is_known(self) -> bool:
        """False where no scatter of episodes was told: how much chance there is nobody can say."""
        return self.episodes is not None and self.episodes.several

    def _valued(self, alone: int | None) -> Valuation:
        """V, or what it is more than that of one policy."""
        targets, weights = self.targets
        (mean, *left_out), at = self._means(targets), np.arange(len(targets))
        route = last_route(mean, self.sources, self.space.steps, targets)
        measured = self.beliefs.measured[:, targets]
        seen = min(float(weights @ measured[route, at]), 1.0)
        served = mean[route, at]
        rival = np.zeros(len(at)) if alone is None else mean[alone]
        spread = self._sampling(served - rival, weights)
        if self.risk < 1.0:
            return self._worst_share(alone, route, seen, spread)
        predicted = np.flatnonzero(~(measured[route, at] & (alone is None or measured[alone])))
        if alone is not None:
            predicted = predicted[route[predicted] != alone]
        some = route[predicted], targets[predicted], weights[predicted]
        doubt = self.error(*some, alone) if len(predicted) else 0.0
        doubt = float(np.hypot(doubt, spread))
        if not left_out:
            return Valuation(float(weights @ (served - rival)), doubt, seen, SURE * doubt)
        value, variance, freedom = self._cross_fitted(route, alone, left_out)
        margin = float(np.hypot(student(freedom) * np.sqrt(variance), SURE * doubt))
        return Valuation(value, float(np.hypot(np.sqrt(variance), doubt)), seen, margin)

    def _means(self, targets: Indices) -> Array:
        """(1 + F, k, T) what is believed, and had each fold of the episodes been left out.

        There are no folds without noise that is known, nor of a V of the worst, which needs none.
        """
        episodes = self.episodes
        if self.risk < 1.0 or episodes is None or episodes.errors is None:
            return self.beliefs.on(targets)[0][None]

        def told(row: Indices, target: Indices) -> Array:
            return np.column_stack([self.rows[row, target], episodes.kept(row, target)])

        return self.beliefs.on_folds(targets, told)

    def _cross_fitted(
        self, route: Indices, alone: int | None, believed: Sequence[Array]
    ) -> tuple[float, float, float]:
        """V or a gain, the variance that noise gives it, and the degrees of freedom of that.

        Each fold of episodes is left out in turn: those that stay choose the routes (and the best
        single policy) and say what they are worth, and where it was measured, those left out say by
        how much that flatters.

        Folds choose by each other's episodes, so that they are lucky together: their scatter says
        too little where a choice is close. By how much the mean of all episodes exceeds what is
        found by those that did not choose is the luck of the choices. Half of its square comes on
        top: between two equals .39 of it is missing, more where one is better. A policy is lucky in
        all contexts that it serves. Only measured contexts count, each with its own weight: what is
        predicted from them has its doubt from the model.
        """
        assert self.episodes is not None
        (targets, weights), steps = self.targets, self.space.steps
        at, folds = np.arange(len(targets)), self.episodes.folds
        says, flattery = np.zeros((2, len(at), folds))
        luck = np.zeros((len(self.sources), len(at)))
        choices = [(1.0, route)]
        if alone is not None:
            choices.append((-1.0, np.full(len(at), alone)))
        for sign, serves in choices:
            luck[serves, at] += sign * self._held(serves, targets).mean(axis=1)
            for fold, mean in enumerate(believed):
                if sign > 0.0:
                    chosen = last_route(mean, self.sources, steps, targets)
                else:
                    chosen = np.full(len(at), (mean @ weights).argmax())
                found = self._held(chosen, targets)[:, fold]
                says[:, fold] += sign * mean[chosen, at]
                flattery[:, fold] += sign * (mean[chosen, at] - found)
                luck[serves, at] -= sign * found / folds
        known = np.isfinite(flattery).all(axis=1)
        counted = np.where(known, weights, 0.0)
        counted /= max(counted.sum(), np.finfo(float).tiny)
        value = float(weights @ says.mean(axis=1))
        if not known.any():
            return value, 0.0, np.inf
        value -= float(counted[known] @ flattery[known].mean(axis=1))
        parts = weights[:, None] * says - counted[:, None] * flattery
        variance, freedom = scatter_of_sum(parts[known])
        together = np.nan_to_num(luck[:, known]) @ weights[known]
        return value, variance + float(together @ together) / 2.0, freedom

    def _held(self, route: Indices, targets: Indices) -> Array:
        """(T, F) of the serving policies by the episodes left out; NaN where not evaluated."""
        assert self.episodes is not None
        found = np.full((len(targets), self.episodes.folds), np.nan)
        there = self.beliefs.measured[route, targets]
        found[there] = self.episodes.held(route[there], targets[there])
        return found

    def error(
        self, route: Indices, targets: Indices, weights: Array, alone: int | None = None
    ) -> float:
        """Standard deviation of V, or of a gain, as far as some of the targets make it unsure.

        Args:
            route: (m,) who serves them.
            targets: (m,).
            weights: (m,) of them in V.
            alone: whose V the gain is over; None: V itself.
        """
        if alone is None:
            return self.beliefs.error(route, targets, weights)
        return self.beliefs.error(
            np.concatenate([route, np.full(len(route), alone)]),
            np.tile(targets, 2),
            np.concatenate([weights, -weights]),
        )

    def _worst_share(
        self, alone: int | None, route: Indices, seen: float, spread: float
    ) -> Valuation:
        """The mean over the worst share, over what may be true: which targets are worst is unsure.

        Of a gain, each of the two V is of its own worst targets.
        """
        targets, weights = self.targets
        serves = np.array([route] if alone is None else [route, np.full(len(targets), alone)])
        pairs, place = np.unique(
            serves * len(targets) + np.arange(len(targets)), return_inverse=True
        )
        row, at = np.divmod(pairs, len(targets))
        drawn = self._drawn(row, at)[:, place.reshape(serves.shape)]
        values = worst_share_mean(drawn, weights, self.risk)
        likely = worst_share_weights(drawn.mean(axis=0), weights, self.risk)
        error = 0.0
        for one in (values, (drawn * likely).sum(axis=2)):  # the latter of targets that stay
            error = max(error, float((one[:, 0] - one[:, 1:].sum(axis=1)).std()))
        error = float(np.hypot(error, spread))
        found = float(values[:, 0].mean() - values[:, 1:].sum(axis=1).mean())
        return Valuation(found, error, seen, SURE * error)

    @cached_property
    def targets(self) -> tuple[Indices, Array]:
        """Contexts that V is computed on, and their weights, sum 1: all, if that is affordable."""
        every, weights = np.arange(self.space.n), self.space.weights
        if len(every) <= _SAMPLE or self.beliefs.exact:
            return every, weights
        some = np.random.default_rng(0).choice(len(every), _SAMPLE, replace=False, p=weights)
        return np.sort(some), np.full(_SAMPLE, 1.0 / _SAMPLE)

    def _sampling(self, values: Array, weights: Array) -> float:
        """Standard error of a mean over a sample of the contexts; 0 where it is over all."""
        n, some = self.space.n, len(values)
        if some == n:
            return 0.0
        spread = float(np.sqrt(weights @ np.square(values - weights @ values)))
        return spread * float(np.sqrt((1.0 - some / n) / some))

    def _drawn(self, row: Indices, at: Indices) -> Array:
        """(D, m) performance that may be true, of policies at places among the targets."""
        targets = self.targets[0]
        mean = self.beliefs.on(targets)[0][row, at]
        unsure = np.flatnonzero(self.beliefs.unsure(row, targets[at]))
        if not len(unsure):
            return mean[None]
        believed, covariance = self.beliefs.joint(row[unsure], targets[at[unsure]])
        spread, turn = np.linalg.eigh(covariance)
        root = turn * np.sqrt(np.maximum(spread, 0.0))
        drawn = np.tile(mean, (_DRAWS, 1))
        normal = np.random.default_rng(0).standard_normal((_DRAWS, len(spread)))
        drawn[:, unsure] = believed + normal @ root.T
        return drawn
