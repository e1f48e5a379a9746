"""Auto: train where whole rows seen so far promise the largest expected gain.

The gain is `mbtl.acquisition.RowGain` under the posterior of `mbtl.models.TransferGP`, which learns
from every entry of every row. The gain that is shown with a pick is the one it was chosen by.
Beyond some hundred contexts a part of the targets, spread over the space, stands for all of them,
and candidates are searched: some spread over the space, then ever nearer to the best. With several
axes the best few are judged again on more targets.

Every third pick is none of the model's: it goes where the sources leave the most uncovered.

Where straight lines explain the rows better (`mbtl.models.linear_trend`), they are the model: all
picks are by their gain, on all targets up to a thousand, since lines cost little and leave no
region unknown.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from mbtl.acquisition import TIE, RowGain, argmax_open, optimistic_gain
from mbtl.arrays import Array
from mbtl.errors import InvalidInput
from mbtl.history import History
from mbtl.models.columns import Columns
from mbtl.models.linear_trend import LinearTrend, fit_linear_trend
from mbtl.models.priors import PRIORS, prior_without
from mbtl.models.transfer_kernel import NEW, TransferPrior
from mbtl.selectors.auto_beliefs import (
    Beliefs,
    conditioned,
    expect,
    floor_of,
    observed,
    pending_pairs,
)
from mbtl.selectors.base import (
    Outlook,
    Proposal,
    SelectionProblem,
    farthest_open,
    first_pick,
    nearest_distance,
    open_candidates,
    spread,
    success_chance,
)
from mbtl.selectors.contract import Traits

Indices = NDArray[np.intp]
Mask = NDArray[np.bool_]

_LEADERS, _AROUND = 3, 12
"""So many of the best candidates are looked around, at so many contexts each and round."""
_ROWS = 20
"""Rows of which all targets are used: a model grows while its targets stay, so they change once."""
_MANY = 20_000
"""Contexts through which every round of the search may look."""
_TREND_TARGETS = 1000
"""Targets at most where straight lines are the model: a bound on memory."""
_LONELY = "largest untested region"
_LEFT = 25
"""Candidates, and targets, that stand for all when it is asked what is left to gain."""


@dataclass(frozen=True)
class Auto:
    """The middle first, then the largest expected gain over whole rows.

    It takes into account what the problem says of costs (gain per cost), of repeated trainings
    (their luck is drawn again) and of risk (gain of the worst targets), and what the history says
    of evaluation noise and of targets that were not evaluated.

    Attributes:
        prior: of the transfer model; None: the one chosen on shipped matrices.
        most_candidates: contexts from which the search for a source begins.
        most_targets: contexts considered as targets at once; half of them after 20 rows.
        finalists: candidates that are judged a second time, on more targets; 0: none.
        final_targets: targets of that.
        cover: with 3, every third pick explores the largest untested region, whatever the model
            says, unless straight lines are the model; with 0 none does.
    """

    prior: TransferPrior | None = None
    most_candidates: int = 100
    most_targets: int = 50
    finalists: int = 10
    final_targets: int = 150
    cover: int = 3
    name: str = "specialists"
    traits: ClassVar[Traits] = Traits(deterministic=True, predicts_chances=True)

    def __post_init__(self) -> None:
        if self.cover < 0:
            raise InvalidInput(f"cover must be >= 0 (0: no pick covers), got {self.cover}")

    def without(self, family: str) -> Auto:
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
        return Outlook("specialists", *row_gain.model.predict_pairs(own), gain, row_gain.drawn)

    def _choose(
        self, problem: SelectionProblem, history: History, mask: Mask, beliefs: Beliefs
    ) -> Proposal:
        costs = np.ones(problem.n)
        if problem.costs is not None:  # their unit must not matter to what counts as a tie
            costs = problem.costs / problem.costs.mean()
        costs = costs / success_chance(problem, history)  # of a training that gives a policy
        wide = spread(problem, np.flatnonzero(problem.weights > 0), self.final_targets)
        outlook = first = self._judged(problem, beliefs)
        if not problem.is_line and self.finalists and len(wide) > len(first.targets):
            # a few targets on several axes are a sample, with its luck; on a line they are even
            outlook = beliefs.row_gain(wide)
        search = partial(
            _search, problem, np.flatnonzero(mask), self.most_candidates, costs, history.pending
        )
        lonely = None
        if beliefs.trend is None:
            lonely = self._least_covered(problem, history, wide, search, costs)
        if lonely is not None and problem.least_gain is None and problem.least_left is None:
            return _covering(lonely, outlook)
        candidates, gain = search(first.expected)
        left = (
            None if problem.least_left is None else _chance_left(first, candidates, gain, problem)
        )
        if outlook is not first:
            few = _finalists(gain / costs[candidates], self.most_candidates, self.finalists)
            candidates = candidates[np.union1d(few, gain.argmax())]
            gain = outlook.expected(candidates)
        chance = None
        if problem.least_gain is not None:
            chance = outlook.chance(int(candidates[gain.argmax()]), problem.least_gain)
        if lonely is not None:
            chosen = _covering(lonely, outlook)
        else:
            chosen = _largest(problem, history, outlook, candidates, gain, costs)
        return replace(chosen, chance=chance, chance_left=left)

    def _least_covered(
        self,
        problem: SelectionProblem,
        history: History,
        targets: Indices,
        search: Callable[[Callable[[Indices], Array]], tuple[Indices, Array]],
        costs: Array,
    ) -> int | None:
        """What would gain most if all trainings succeeded alike; None if it is not its turn.

        The model takes what it has seen for the rule. Where luck decides it would stay for ever
        near small sure gains, and never meet the one training that is good everywhere.
        """
        if not self.cover or len(history.tried) % self.cover != self.cover - 1:
            return None
        steps, weights = problem.steps, problem.weights[targets]
        covered = nearest_distance(steps[targets], steps[list(history.tried)])

        def nearer(candidates: Indices) -> Array:
            flat = np.zeros(len(candidates))
            places = steps[candidates], steps[targets]
            return optimistic_gain(flat, *places, -covered, weights / weights.sum(), theta=1.0)

        candidates, gain = search(nearer)
        best = argmax_open(gain / costs[candidates], np.ones(len(gain), dtype=bool))
        return int(candidates[best]) if gain[best] > TIE else None

    def _beliefs(self, problem: SelectionProblem, history: History) -> Beliefs:
        """Condition the model on the rows, at some of the targets."""
        count = self.most_targets if len(history) <= _ROWS else (self.most_targets + 1) // 2
        targets = spread(problem, np.flatnonzero(problem.weights > 0), count)
        columns = Columns.of(problem.axes, problem.unit.shape[1])
        places = columns.places(problem.unit, problem.steps)
        pairs, y = observed(history, targets)
        floor = floor_of(y)
        y = np.maximum(y, floor)
        prior, known = self.prior or PRIORS["all"], None
        if history.errors is not None:
            known = np.square(history.errors[pairs[:, 2], pairs[:, 1]])
        model = conditioned(places, prior, pairs, y, known)
        waiting = np.asarray(history.pending, dtype=np.intp)
        expect(model, pending_pairs(problem, waiting, targets, len(history)))
        trend = fit_linear_trend(problem.steps, pairs, y, known)
        likelier = trend.log_likelihood > model.log_likelihood
        return Beliefs(problem, history, targets, y, floor, model, trend if likelier else None)

    def _judged(self, problem: SelectionProblem, beliefs: Beliefs) -> RowGain:
        """The gain on the targets by which candidates are searched."""
        if beliefs.trend is None:
            return beliefs.row_gain(beliefs.targets)
        counted = np.flatnonzero(problem.weights > 0)
        return beliefs.row_gain(spread(problem, counted, _TREND_TARGETS))


def _largest(
    problem: SelectionProblem,
    history: History,
    outlook: RowGain,
    candidates: Indices,
    gain: Array,
    costs: Array,
) -> Proposal:
    """The candidate of the largest gain per cost; far from all where nothing is to be gained."""
    best = argmax_open(gain / costs[candidates], np.ones(len(gain), dtype=bool))
    source = int(candidates[best])
    if gain[best] <= TIE:
        mask = open_candidates(problem, history)
        source = farthest_open(problem, [*history.sources, *history.pending], mask)
        return Proposal(source, "no predicted gain anywhere: far from what was tried", 0.0)
    reason = "largest expected gain"
    if isinstance(outlook.model, LinearTrend):
        reason += " by straight lines"
    if problem.costs is not None:
        reason += " per cost"
    counted = int(np.count_nonzero(problem.weights))
    sampling = outlook.standard_error(source, counted)
    judged = f"gain +- {sampling:.2g}: {len(outlook.targets)} of {counted} targets judged"
    return Proposal(source, reason, _shown(gain[best]), (judged,) if sampling else ())


def _covering(source: int, outlook: RowGain) -> Proposal:
    return Proposal(source, _LONELY, _shown(outlook.expected(np.array([source]))[0]))


def _shown(gain: float) -> float:
    """Rounded: the last digits depend on whether the model grew or was made anew."""
    return round(float(gain), 10)


def _chance_left(
    outlook: RowGain, candidates: Indices, gain: Array, problem: SelectionProblem
) -> float:
    """That trainings on all contexts left together gain `least_left` or more.

    The most promising and some spread ones stand for all of them, and few targets for all targets.
    """
    assert problem.least_left is not None
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
