"""Specialists: train where whole rows seen so far promise the largest expected gain.

The gain is `mbtl.acquisition.RowGain` under the posterior of `mbtl.models.transfer_gp`, which
learns from every entry of every row. The gain that is shown with a pick is the one it was chosen
by.
Beyond some hundred contexts a part of the targets, spread over the space, stands for all of them,
and candidates are searched: some spread over the space, then ever nearer to the best. With several
axes the best few are judged again on more targets.

Where straight lines explain the rows better (`mbtl.models.linear_trend`), they are the model, on
all targets up to a thousand, since lines cost little.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from mbtl.acquisition import TIE, RowGain, argmax_open
from mbtl.arrays import Array, Indices, Mask
from mbtl.errors import InvalidInput
from mbtl.history import History
from mbtl.models.linear_trend import LinearTrend, fit_linear_trend
from mbtl.models.priors import PRIORS, prior_without
from mbtl.models.transfer_gp import TransferGP, likely_noise
from mbtl.models.transfer_kernel import NEW, Pairs, TransferPrior, grid_pairs, transfer_places
from mbtl.selectors.base import (
    Outlook,
    Proposal,
    SelectionProblem,
    farthest_open,
    first_pick,
    open_candidates,
    spread,
    success_chance,
)
from mbtl.selectors.contract import Traits

_LEADERS, _AROUND = 3, 12
"""So many of the best candidates are looked around, at so many contexts each and round."""
_PAIRS, _FEW = 300, 10
"""Pairs that the model is conditioned on, about, and targets at least: it is cubic in them."""
_PENDING = 100
"""Pairs that stand for a pick under way, divided by how many it makes."""
_MANY = 20_000
"""Contexts through which every round of the search may look."""
_TREND_TARGETS = 1000
"""Targets at most where straight lines are the model: a bound on memory."""
_LEFT = 25
"""Candidates, and targets, that stand for all when it is asked what is left to gain."""


@dataclass(frozen=True)
class Specialists:
    """The middle first, then the largest expected gain over whole rows.

    It takes into account what the problem says of costs (gain per cost), of repeated trainings
    (their luck is drawn again) and of risk (gain of the worst targets), and what the history says
    of evaluation noise and of targets that were not evaluated.

    Attributes:
        prior: of the transfer model; None: the one chosen on shipped matrices.
        most_candidates: contexts from which the search for a source begins.
        most_targets: contexts considered as targets at once; fewer from the seventh row on.
        finalists: candidates that are judged a second time, on more targets; 0: none.
        final_targets: targets of that.
        lines: try straight lines as a model.
        ceilings: nobody does better than has been seen, see `RowGain`.
    """

    prior: TransferPrior | None = None
    most_candidates: int = 100
    most_targets: int = 50
    finalists: int = 10
    final_targets: int = 150
    lines: bool = True
    ceilings: bool = True
    name: str = "specialists"
    traits: ClassVar[Traits] = Traits(deterministic=True)

    def without(self, family: str) -> Specialists:
        """The same with a prior that has not seen a family of matrices; for honest benchmarks."""
        return replace(self, prior=self.prior or prior_without(family))

    def propose(
        self, problem: SelectionProblem, history: History, rng: np.random.Generator
    ) -> Proposal:
        """The largest expected gain; far from what was tried where nothing is known."""
        mask = open_candidates(problem, history)
        if not np.isfinite(history.rows).any():
            return first_pick(problem, history, mask)
        try:
            beliefs = self._beliefs(problem, history)
        except (np.linalg.LinAlgError, InvalidInput) as error:  # or nothing known of these targets
            source = farthest_open(problem, history.sources, mask)
            note = f"the transfer model could not be fitted ({error})"
            return Proposal(source, "far from what was tried so far", None, (note,))
        return self._choose(problem, history, mask, beliefs)

    def outlook(self, problem: SelectionProblem, history: History, candidates: Indices) -> Outlook:
        """What the model believes of every training, and the gain it expects of some candidates.

        Raises:
            InvalidInput: nothing was evaluated so far.
            numpy.linalg.LinAlgError: the model cannot be fitted.
        """
        beliefs, everyone = self._beliefs(problem, history), np.arange(problem.n)
        own = np.column_stack([everyone, everyone, np.full(problem.n, NEW)])
        gain = np.full(problem.n, np.nan)
        row_gain = self._judged(problem, beliefs)
        gain[candidates] = row_gain.expected(candidates)
        return Outlook("specialists", *row_gain.model.predict_pairs(own), gain)

    def _choose(
        self, problem: SelectionProblem, history: History, mask: Mask, beliefs: Conditioned
    ) -> Proposal:
        """The largest gain per cost; far from all where nothing is to be gained."""
        costs = np.ones(problem.n)
        if problem.costs is not None:  # their unit must not matter to what counts as a tie
            costs = problem.costs / problem.costs.mean()
        costs = costs / success_chance(problem, history)  # of a training that gives a policy
        wide = spread(problem, np.flatnonzero(problem.weights > 0), self.final_targets)
        outlook = first = self._judged(problem, beliefs)
        if not problem.is_line and self.finalists and len(wide) > len(first.targets):
            # a few targets on several axes are a sample, with its luck; on a line they are even
            outlook = beliefs.row_gain(wide)
        candidates, gain = _search(
            problem, np.flatnonzero(mask), self.most_candidates, costs, history.pending,
            first.expected,
        )  # fmt: skip
        left = _chance_left(first, candidates, gain, problem)
        if outlook is not first:
            few = _finalists(gain / costs[candidates], self.most_candidates, self.finalists)
            candidates = candidates[np.union1d(few, gain.argmax())]
            gain = outlook.expected(candidates)
        best = argmax_open(gain / costs[candidates], np.ones(len(gain), dtype=bool))
        source = int(candidates[best])
        if gain[best] <= TIE:
            source = farthest_open(problem, [*history.sources, *history.pending], mask)
            reason = "no predicted gain anywhere: far from what was tried"
            return Proposal(source, reason, 0.0, chance_left=left)
        reason = "largest expected gain"
        if isinstance(outlook.model, LinearTrend):
            reason += " by straight lines"
        if problem.costs is not None:
            reason += " per cost"
        counted = int(np.count_nonzero(problem.weights))
        sampling = outlook.standard_error(source, counted)
        judged = f"gain +- {sampling:.2g}, judged on {len(outlook.targets)} of {counted} targets"
        shown = round(float(gain[best]), 10)  # the last digits depend on the order of sums
        return Proposal(source, reason, shown, (judged,) if sampling else (), left)

    def _beliefs(self, problem: SelectionProblem, history: History) -> Conditioned:
        """Condition the model on the rows, at some of the targets."""
        count = min(self.most_targets, max(_PAIRS // len(history), _FEW))
        targets = spread(problem, np.flatnonzero(problem.weights > 0), count)
        places = transfer_places(problem)
        pairs, y = observed(history, targets)
        floor = floor_of(y)
        y = np.maximum(y, floor)
        prior, known = self.prior or PRIORS["all"], None
        if history.errors is not None:
            known = np.square(history.errors[pairs[:, 2], pairs[:, 1]])
        believed, noise = likely_noise(places, prior, pairs, y, known)
        told = model = TransferGP(places, believed, pairs, y, noise)
        extra = pending_pairs(problem, history, targets)
        if len(extra):  # as if they had given what is expected of them
            expected = np.append(y, told.predict_pairs(extra)[0])
            noise_too = np.append(noise, np.zeros(len(extra)))
            model = TransferGP(places, believed, np.vstack([pairs, extra]), expected, noise_too)
        trend = fit_linear_trend(problem.steps, pairs, y, known)
        likelier = self.lines and trend.log_likelihood > told.log_likelihood
        return Conditioned(
            problem, history, targets, float(y.max()) if self.ceilings else np.inf, floor, told,
            model, bool(noise.any()), trend if likelier else None,
        )  # fmt: skip

    def _judged(self, problem: SelectionProblem, beliefs: Conditioned) -> RowGain:
        """The gain on the targets by which candidates are searched."""
        if beliefs.trend is None:
            return beliefs.row_gain(beliefs.targets)
        counted = np.flatnonzero(problem.weights > 0)
        return beliefs.row_gain(spread(problem, counted, _TREND_TARGETS))


def _chance_left(
    outlook: RowGain, candidates: Indices, gain: Array, problem: SelectionProblem
) -> float | None:
    """That trainings on all contexts left together gain `least_left` or more, where it is asked.

    The most promising and some spread ones stand for all of them, and few targets for all targets.
    """
    if problem.least_left is None:
        return None
    best = candidates[np.argsort(-gain, kind="stable")[: _LEFT // 2]]
    rest = np.setdiff1d(candidates, best)
    sources = np.union1d(best, spread(problem, rest, _LEFT - len(best)))
    return outlook.chance_together(
        sources, spread(problem, outlook.targets, _LEFT), problem.least_left
    )


def _search(
    problem: SelectionProblem,
    among: Indices,
    most: int,
    costs: Array,
    pending: Sequence[int],
    gain_of: Callable[[Indices], Array],
) -> tuple[Indices, Array]:
    """Candidates and their gains: `most` spread over the space first, then some near the best.

    Those first ones stay the same while picks are asked for together, but for the picks themselves.

    Near is meant in unit coordinates and in grid steps, so that neither fine nor coarse axes are
    left out, and shrinks from round to round; the last rounds go on while they find a better one.
    """
    found = among
    if len(among) > most:
        stay = spread(problem, np.union1d(among, np.asarray(pending, dtype=np.intp)), most)
        found = np.intersect1d(stay, among)
        found = found if len(found) else spread(problem, among, most)
    gain = gain_of(found)
    reach, pool = max(4 * len(among) // most, _AROUND), among
    while len(found) < len(among):
        worth = gain / costs[found]
        leaders = [*found[np.argsort(-worth, kind="stable")[:_LEADERS]], found[gain.argmax()]]
        near = [
            _nearest(scale, pool, leader, reach)
            for leader in dict.fromkeys(leaders)
            for scale in (problem.unit, problem.steps)
        ]
        width = 4 * _AROUND if reach == _AROUND else _AROUND  # in the end, all neighbours
        some = [spread(problem, around, width) for around in near]
        new = np.setdiff1d(np.concatenate(some), found)
        if len(new):
            found, gain = np.append(found, new), np.append(gain, gain_of(new))
        if reach == _AROUND and (gain / costs[found]).max() <= worth.max():
            break
        if len(pool) > _MANY:  # too many to look through again
            pool = np.unique(np.concatenate(near))
        reach = max(reach // _AROUND, _AROUND)
    return found, gain


def _finalists(worth: Array, spread: int, count: int) -> Indices:
    """The best of all, and the best of the first `spread`: the others may lie on one hill."""
    half = count // 2
    best, apart = (np.argsort(-w, kind="stable") for w in (worth, worth[:spread]))
    return np.union1d(best[: count - half], apart[:half])


def _nearest(places: Array, among: Indices, place: int, count: int) -> Indices:
    """The contexts that are no farther from one than the `count`-th nearest, itself among them."""
    if len(among) <= count:
        return among
    squared = np.square(places[among] - places[place]).sum(axis=1)
    limit = np.partition(squared, count)[count]  # a value; which of equals comes first varies
    return np.asarray(among[squared <= limit * (1.0 + 1e-9)])


# ---- what is believed ----------------------------------------------------------------------------


@dataclass(frozen=True)
class Conditioned:
    """The model after the rows told, and what is expected of pending picks.

    Attributes:
        targets: among whose pairs the model looked.
        seen: best performance there; inf: it is no limit.
        floor: performance below which all counts as equally bad.
        told: the model of the rows told alone.
        model: that beside which picks under way gave what is expected of them.
        noisy: a known noise counts.
        trend: the linear trend, where it explains the rows better than the model; else None.
    """

    problem: SelectionProblem
    history: History
    targets: Indices
    seen: float
    floor: float
    told: TransferGP
    model: TransferGP
    noisy: bool
    trend: LinearTrend | None = None

    def row_gain(self, targets: Indices) -> RowGain:
        """What one more training may bring on these targets."""
        weights = self.problem.weights[targets] / self.problem.weights[targets].sum()
        best, risk = self._best(targets), self.problem.risk
        if self.trend is not None:  # it says itself what a training on a target gives there
            return RowGain(self.trend, targets, best, np.inf, weights, risk)
        return RowGain(self.model, targets, best, self.seen, weights, risk)

    def _best(self, targets: Indices) -> Array:
        """(T,) the best so far, and what is expected of pending picks.

        The best of noisy or missing entries is what the model believes them to be.
        """
        told, rows = self.history, np.maximum(self.history.rows[:, targets], self.floor)
        sources, waiting = (np.asarray(s, dtype=np.intp) for s in (told.sources, told.pending))
        if self.trend is not None:
            known = None if told.errors is None else np.square(told.errors[:, targets])
            rows = self.trend.believed(sources, targets, rows, known)
        elif self.noisy or not np.isfinite(rows).all():
            rows = self.told.predict(sources, targets, np.arange(len(sources)))[0]
        if told.others is not None:
            rows = np.vstack([rows, told.others[targets]])
        if len(waiting):
            rows = np.vstack([rows, (self.trend or self.told).predict(waiting, targets)[0]])
        return np.asarray(rows.max(axis=0))


def floor_of(y: Array) -> float:
    """Performance below which all is equally bad: far outside, and far below the bounds as well.

    A policy that jams a junction may be worth -800 where others reach 0.9; as they stand, such
    values would be all that a Gaussian process sees.
    """
    low, high = np.quantile(y, [0.25, 0.75])
    return float(min(low - 3.0 * (high - low), -1.0))


def observed(history: History, targets: Indices) -> tuple[Pairs, Array]:
    """Pairs and their performance: on `targets`; of rows that are partial as many, evenly thinned.

    What is taken of a row does not depend on the rows after it.
    """
    sources = np.asarray(history.sources, dtype=np.intp)
    found, values = [], []
    for number, (source, row) in enumerate(zip(sources, history.rows, strict=True)):
        at = targets
        if not np.isfinite(row[targets]).all():
            at = np.flatnonzero(np.isfinite(row))
            if len(at) > len(targets):
                at = at[np.linspace(0, len(at) - 1, len(targets)).round().astype(np.intp)]
        found.append(grid_pairs(np.array([source]), at, np.array([number])))
        values.append(row[at])
    return np.vstack(found), np.concatenate(values)


def pending_pairs(problem: SelectionProblem, history: History, targets: Indices) -> Pairs:
    """Pairs that stand for the picks under way: all, or of many picks those nearest to each.

    What a pick is believed to give says something of its neighbourhood; far away it is only the
    mean that is known anyway. Those of one pick do not depend on how many come after it.
    """
    where, found = problem.steps, [np.empty((0, 3), dtype=np.intp)]
    for i, source in enumerate(history.pending):
        few, near = max(_PENDING // (i + 1), 1), targets
        if few < len(targets):
            far = np.linalg.norm(where[targets] - where[source], axis=1)
            near = targets[np.argsort(far, kind="stable")[:few]]
        found.append(grid_pairs(np.array([source]), near, np.array([len(history) + i])))
    return np.vstack(found)
