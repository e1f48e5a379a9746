"""What `auto` believes: the transfer model given the rows told, and picks under way beside them."""

from __future__ import annotations

from dataclasses import dataclass
from threading import local

import numpy as np
from numpy.typing import NDArray

from mbtl.acquisition import RowGain
from mbtl.arrays import Array
from mbtl.history import History
from mbtl.models.growing import Growing
from mbtl.models.linear_trend import LinearTrend
from mbtl.models.transfer_gp import likely_noise
from mbtl.models.transfer_kernel import Pairs, Places, TransferPrior, grid_pairs
from mbtl.selectors.base import SelectionProblem

Indices = NDArray[np.intp]

_PENDING = 150
"""Pairs that stand for a pick under way, divided by how many it makes."""
_STEP = np.log(1.25)
"""A known noise is taken relative to a scale that is rounded to such steps, so that it stays."""


@dataclass(frozen=True)
class Beliefs:
    """The model after the rows told (values `y`), and what is expected of pending picks.

    Attributes:
        trend: the linear trend, where it explains the rows better than the model; else None.
    """

    problem: SelectionProblem
    history: History
    targets: Indices
    y: Array
    floor: float
    model: Growing
    trend: LinearTrend | None = None

    def row_gain(self, targets: Indices) -> RowGain:
        """What one more training may bring on these targets."""
        weights = self.problem.weights[targets] / self.problem.weights[targets].sum()
        risk = self.problem.risk
        if self.trend is not None:  # it says itself what a training on a target gives there
            return RowGain(self.trend, targets, self._best_by_trend(targets), np.inf, weights, risk)
        seen = float(self.y.max())
        return RowGain(self.model, targets, self._best(targets), seen, weights, risk)

    def _best(self, targets: Indices) -> Array:
        """(T,) the best so far, and what is expected of pending picks."""
        best = np.maximum(self.history.best[targets], self.floor)
        if self.model.noisy or not np.isfinite(self.history.rows[:, targets]).all():
            # the best of noisy or missing entries is what the model believes them to be
            best = self._believed(targets).max(axis=0)
            if self.history.others is not None:
                best = np.maximum(best, self.history.others[targets])
        waiting = np.asarray(self.history.pending, dtype=np.intp)
        if len(waiting):
            best = np.maximum(best, self.model.means(waiting, targets).max(axis=0))
        return best

    def _best_by_trend(self, targets: Indices) -> Array:
        """(T,) the same, by the trend."""
        assert self.trend is not None
        told, rows = self.history, np.maximum(self.history.rows[:, targets], self.floor)
        known = None if told.errors is None else np.square(told.errors[:, targets])
        sources, waiting = (np.asarray(s, dtype=np.intp) for s in (told.sources, told.pending))
        best = self.trend.believed(sources, targets, rows, known).max(axis=0)
        if told.others is not None:
            best = np.maximum(best, told.others[targets])
        if len(waiting):
            best = np.maximum(best, self.trend.predict(waiting, targets)[0].max(axis=0))
        return np.asarray(best)

    def _believed(self, targets: Indices) -> Array:
        """(k, T) means of the rows told."""
        sources = np.asarray(self.history.sources, dtype=np.intp)
        asked = grid_pairs(sources, targets)
        if np.array_equal(asked, self.model.told):
            return self.model.smoothed().reshape(len(sources), len(targets))
        return self.model.predict(sources, targets, np.arange(len(sources)))[0]


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


def pending_pairs(
    problem: SelectionProblem, waiting: Indices, targets: Indices, told: int
) -> Pairs:
    """Pairs that stand for the picks under way: all, or of many picks those nearest to each.

    What a pick is believed to give says something of its neighbourhood; far away it is only the
    mean that is known anyway. Those of one pick do not depend on how many come after it.
    """
    where, found = problem.steps, [np.empty((0, 3), dtype=np.intp)]
    for i, source in enumerate(waiting):
        few, near = max(_PENDING // (i + 1), 1), targets
        if few < len(targets):
            far = np.linalg.norm(where[targets] - where[source], axis=1)
            near = targets[np.argsort(far, kind="stable")[:few]]
        found.append(grid_pairs(np.array([source]), near, np.array([told + i])))
    return np.vstack(found)


_known = local()
"""The last two models of this thread: pairs may be believed noisy, and quiet again."""


def forget() -> None:
    """As in a process that has not picked before; for tests and benchmarks."""
    _known.models = []


def conditioned(
    places: Places, prior: TransferPrior, pairs: Pairs, y: Array, known: Array | None
) -> Growing:
    """The model of the rows told; that of the last pick grows, if it was of the first of them."""
    believed, noise, scale = likely_noise(places, prior, pairs, y, known)
    relative = noise / np.exp(_STEP * np.round(np.log(scale) / _STEP))
    models = [one for one in getattr(_known, "models", ()) if one.grows_into(places, pairs)]
    model = next((one for one in models if one.believes(believed, relative)), None)
    if model is None:
        model = Growing(places, believed, pairs, y, relative)
    else:
        models.remove(model)
        model.tell(pairs[len(model.told) :], y, relative[len(model.told) :])
    _known.models = [model, *models[:1]]
    return model


def expect(model: Growing, extra: Pairs) -> None:
    """These pairs, of picks under way, are believed to give what is expected of them."""
    before = model.believed
    if not np.array_equal(before, extra[: len(before)]):
        model.doubt()
        before = extra[:0]
    if len(before) < len(extra):
        model.believe(extra[len(before) :])
