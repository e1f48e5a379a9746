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

import numpy as np
from numpy.typing import NDArray

from mbtl.acquisition import TIE, argmax_open, unit_improvement
from mbtl.arrays import Array
from mbtl.errors import InvalidInput
from mbtl.history import History
from mbtl.models.priors import PRIORS, prior_without
from mbtl.models.transfer_gp import Places, TransferGP, TransferPrior, grid_pairs
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


@dataclass(frozen=True)
class Auto:
    """The middle first, then the largest expected gain over whole rows.

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

    def without(self, family: str) -> Auto:
        """The same with a prior that has not seen a family of matrices; for honest benchmarks."""
        return self if self.prior else replace(self, prior=prior_without(family))

    def propose(
        self, problem: SelectionProblem, history: History, rng: np.random.Generator
    ) -> Proposal:
        """The largest expected gain; far from what was tried where nothing is known."""
        mask = open_candidates(problem, history)
        if not np.isfinite(history.rows).any():
            return first_pick(problem, history, mask)
        candidates = _spread(problem, np.flatnonzero(mask), self.most_candidates)
        count = min(self.most_targets, max(24, self.most_pairs // len(history)))
        targets = _spread(problem, np.arange(problem.n), count)
        try:
            gain = self._gain(problem, history, candidates, targets)
        except (np.linalg.LinAlgError, InvalidInput) as error:  # or nothing known of these targets
            source = farthest_open(problem, history.sources, mask)
            note = f"the transfer model could not be fitted ({error})"
            return Proposal(source, "far from what was tried so far", None, (note,))
        best = argmax_open(gain, np.ones(len(gain), dtype=bool))
        if gain[best] <= TIE:
            source = farthest_open(problem, [*history.sources, *history.pending], mask)
            return Proposal(source, "no predicted gain anywhere: far from what was tried", 0.0)
        return Proposal(int(candidates[best]), "largest expected gain", float(gain[best]))

    def _gain(
        self, problem: SelectionProblem, history: History, candidates: Indices, targets: Indices
    ) -> Array:
        """(M,) expected gain of each candidate."""
        places = Places.of(problem.unit, problem.steps)
        pairs = grid_pairs(np.asarray(history.sources, dtype=np.intp), targets)
        y = history.rows[:, targets].ravel()
        seen = np.isfinite(y)
        pairs, y = pairs[seen], y[seen]
        prior = self.prior or PRIORS["all"]
        model = TransferGP(places, prior, pairs, y)
        best = np.where(np.isfinite(history.best), history.best, y.min())[targets]
        if history.pending:  # believed to give what is expected of them
            waiting = np.asarray(history.pending, dtype=np.intp)
            believed, _ = model.predict(waiting, targets)
            best = np.maximum(best, believed.max(axis=0))
            pairs = np.vstack([pairs, grid_pairs(waiting, targets)])
            model = TransferGP(places, prior, pairs, np.append(y, believed.ravel()))
        mean, std = model.predict(candidates, targets)
        weights = problem.weights[targets] / problem.weights[targets].sum()
        top = np.maximum(y.max() + _MARGIN * float(np.ptp(y)), best)
        gain = unit_improvement((mean - best) / std) - unit_improvement((mean - top) / std)
        return np.asarray((std * gain) @ weights)


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
