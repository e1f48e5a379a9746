"""Auto: train where whole rows seen so far promise the largest expected gain.

    a(x) = sum_t w_t E[ (min(J(x, t), top) - best(t))_+ ]

under the posterior of `mbtl.models.TransferGP`, which learns from every entry of every row. It is
Gaussian, so the expectation is closed: with e(m) = s (z Phi(z) + phi(z)) and z = m / s, it is
e(E J - best) - e(E J - top). `top` is the best performance seen anywhere: a Gaussian far from all
data would promise more than any policy has ever reached. Beyond some hundred contexts a part of the
candidates and targets, spread over the space, stands for all of them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from mbtl.acquisition import TIE, argmax_open, unit_improvement
from mbtl.arrays import Array
from mbtl.errors import InvalidInput
from mbtl.history import History
from mbtl.models.priors import PRIORS, prior_without
from mbtl.models.transfer_gp import (
    Pairs,
    Places,
    TransferGP,
    TransferPrior,
    grid_pairs,
    independent_noise,
)
from mbtl.objective import worst_share_mean
from mbtl.selectors.base import (
    Proposal,
    SelectionProblem,
    farthest_open,
    first_pick,
    open_candidates,
)

Indices = NDArray[np.intp]

_MARGIN = 0.02
"""By how much `top` lies above the best seen, as a share of the range seen."""
_DRAWS = 4000
"""Samples of a row behind the chance of a gain: a standard error below 0.01."""


@dataclass(frozen=True)
class Auto:
    """The middle first, then the largest expected gain over whole rows.

    It takes into account what the problem says of costs (gain per cost), of repeated trainings
    (their luck is drawn again) and of risk (gain of the worst targets), and what the history says
    of evaluation noise and of targets that were not evaluated.

    Attributes:
        prior: of the transfer model; None: the one chosen on shipped matrices.
        most_candidates: contexts considered as sources at once.
        most_targets: contexts considered as targets at once.
        most_pairs: observed pairs used; with more rows, fewer targets of each.
    """

    prior: TransferPrior | None = None
    most_candidates: int = 100
    most_targets: int = 50
    most_pairs: int = 1000
    name: str = "auto"
    predicts_chances: ClassVar[bool] = True

    def without(self, family: str) -> Auto:
        """The same with a prior that has not seen a family of matrices; for honest benchmarks."""
        return self if self.prior else replace(self, prior=prior_without(family))

    def propose(
        self, problem: SelectionProblem, history: History, rng: np.random.Generator
    ) -> Proposal:
        """The largest expected gain; far from what was tried where nothing is known."""
        mask = open_candidates(problem, history, repeats=problem.repeats)
        if not np.isfinite(history.rows).any():
            return first_pick(problem, history, mask)
        candidates = _spread(problem, np.flatnonzero(mask), self.most_candidates)
        try:
            outlook = self._outlook(problem, history)
        except (np.linalg.LinAlgError, InvalidInput) as error:  # or nothing known of these targets
            source = farthest_open(problem, history.sources, mask)
            note = f"the transfer model could not be fitted ({error})"
            return Proposal(source, "far from what was tried so far", None, (note,))
        gain = outlook.gain(candidates)
        score = gain if problem.costs is None else gain / problem.costs[candidates]
        best = argmax_open(score, np.ones(len(score), dtype=bool))
        source, chance = int(candidates[best]), None
        if problem.least_gain is not None:
            chance = outlook.chance(source, problem.least_gain)
        if gain[best] <= TIE:
            source = farthest_open(problem, [*history.sources, *history.pending], mask)
            reason = "no predicted gain anywhere: far from what was tried"
            return Proposal(source, reason, 0.0, chance=chance)
        reason = "largest expected gain"
        if problem.costs is not None:
            reason += " per cost"
        if source in history.sources:
            reason += ", trained again"
        return Proposal(source, reason, float(gain[best]), chance=chance)

    def _outlook(self, problem: SelectionProblem, history: History) -> _Outlook:
        """What is believed, on a part of the targets."""
        count = min(self.most_targets, max(24, self.most_pairs // len(history)))
        targets = _spread(problem, np.arange(problem.n), count)
        places = Places.of(problem.unit, problem.steps)
        sources = np.asarray(history.sources, dtype=np.intp)
        pairs = grid_pairs(sources, targets)
        y = history.rows[:, targets].ravel()
        seen = np.isfinite(y)
        if not seen.all():  # of rows evaluated in part, all that was evaluated
            pairs, y, seen = _evaluated(history, self.most_pairs)
        pairs, y = pairs[seen], y[seen]
        floor = _floor(y)
        y = np.maximum(y, floor)
        prior, noise = self.prior or PRIORS["all"], None
        if history.errors is not None:
            scatter = np.square(history.errors[pairs[:, 2], pairs[:, 1]])
            noise = independent_noise(places, prior, pairs, y, scatter)
        model = TransferGP(places, prior, pairs, y, noise)
        best = np.maximum(history.best[targets], floor)
        trained = np.arange(len(sources))
        if not np.isfinite(history.rows).all() or (noise is not None and noise.any()):
            # the best of noisy or missing entries is what the model believes them to be
            best = model.predict(sources, targets, trained)[0].max(axis=0)
        highest = float(y.max())
        top = highest + _MARGIN * float(np.ptp(y))
        if history.pending:  # believed to give what is expected of them
            waiting = np.asarray(history.pending, dtype=np.intp)
            numbers = len(sources) + np.arange(len(waiting))
            believed = model.predict(waiting, targets)[0]
            best = np.maximum(best, believed.max(axis=0))
            pairs = np.vstack([pairs, grid_pairs(waiting, targets, numbers)])
            noise = None if noise is None else np.append(noise, np.zeros(believed.size))
            model = TransferGP(places, prior, pairs, np.append(y, believed.ravel()), noise)
        weights = problem.weights[targets] / problem.weights[targets].sum()
        return _Outlook(model, targets, best, np.maximum(top, best), highest, weights, problem.risk)


@dataclass(frozen=True)
class _Outlook:
    """What one more training may bring: T targets, with the best so far and the cap of each."""

    model: TransferGP
    targets: Indices
    best: Array
    top: Array
    seen: float
    weights: Array
    risk: float

    def gain(self, candidates: Indices) -> Array:
        """(M,) expected gain in V of each candidate."""
        expected = self._improvement(candidates)
        if self.risk == 1.0:
            return np.asarray(expected @ self.weights)
        return self._value(self.best + expected) - self._value(self.best)

    def chance(self, source: int, least: float) -> float:
        """Probability that V gains `least` or more, from samples of the whole row.

        No higher than the best performance seen: where targets are served as well as any can be, a
        margin above it would promise a little for ever.
        """
        rows = self.model.draws(source, self.targets, _DRAWS, np.random.default_rng(0))
        reached = np.maximum(np.minimum(rows, self.seen), self.best)
        return float(np.mean(self._value(reached) - self._value(self.best) >= least))

    def _value(self, best: Array) -> Array:
        return worst_share_mean(best, self.weights, self.risk)

    def _improvement(self, candidates: Indices) -> Array:
        mean, std = self.model.predict(candidates, self.targets)
        below = unit_improvement((mean - self.top) / std)
        return np.asarray(std * (unit_improvement((mean - self.best) / std) - below))


def _floor(y: Array) -> float:
    """Performance below which all is equally bad: far outside, and far below the bounds as well.

    A policy that jams a junction may be worth -800 where others reach 0.9; as they stand, such
    values would be all that a Gaussian process sees.
    """
    low, high = np.quantile(y, [0.25, 0.75])
    return float(min(low - 3.0 * (high - low), -1.0))


def _evaluated(history: History, most: int) -> tuple[Pairs, Array, NDArray[np.bool_]]:
    """Pairs that were evaluated, an even part of them where they are too many."""
    rows, targets = np.nonzero(np.isfinite(history.rows))
    if len(rows) > most:
        kept = np.linspace(0, len(rows) - 1, most).round().astype(np.intp)
        rows, targets = rows[kept], targets[kept]
    sources = np.asarray(history.sources, dtype=np.intp)[rows]
    y = history.rows[rows, targets]
    return np.column_stack([sources, targets, rows]), y, np.ones(len(y), dtype=bool)


def _spread(problem: SelectionProblem, among: Indices, most: int) -> Indices:
    """At most `most` of the contexts, spread over the space, always the same ones."""
    if len(among) <= most:
        return among
    if problem.is_line:
        order = among[np.argsort(problem.line[among], kind="stable")]
        return np.sort(order[np.linspace(0, len(order) - 1, most).round().astype(np.intp)])
    shuffled = np.random.default_rng(0).permutation(problem.n)
    rank = np.empty(problem.n, dtype=np.intp)
    rank[shuffled] = np.arange(problem.n)
    return np.sort(among[np.argsort(rank[among], kind="stable")[:most]])
