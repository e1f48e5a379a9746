"""What `auto` believes: the transfer model given the rows told, and picks under way beside them."""

from __future__ import annotations

from dataclasses import dataclass
from threading import local
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbtl.acquisition import RowGain
from mbtl.arrays import Array
from mbtl.history import History
from mbtl.models.believing import Believing
from mbtl.models.transfer_gp import TransferGP, likely_noise
from mbtl.models.transfer_kernel import Pairs, Places, TransferPrior, grid_pairs
from mbtl.selectors.base import SelectionProblem

Indices = NDArray[np.intp]

_PENDING = 150
"""Pairs that stand for a pick under way, divided by how many it makes."""
_MARGIN = 0.02
"""By how much `top` lies above the best seen, as a share of the range seen."""


@dataclass(frozen=True)
class Beliefs:
    """The model after the rows told (values `y`), and after those expected of pending picks too."""

    problem: SelectionProblem
    history: History
    targets: Indices
    y: Array
    floor: float
    noisy: bool
    told: TransferGP
    expecting: TransferGP

    def row_gain(self, targets: Indices) -> RowGain:
        """What one more training may bring on these targets."""
        sources = np.asarray(self.history.sources, dtype=np.intp)
        best = np.maximum(self.history.best[targets], self.floor)
        if self.noisy or not np.isfinite(self.history.rows[:, targets]).all():
            # the best of noisy or missing entries is what the model believes them to be
            best = self.told.predict(sources, targets, np.arange(len(sources)))[0].max(axis=0)
        waiting = np.asarray(self.history.pending, dtype=np.intp)
        if isinstance(self.expecting, Believing):
            best = np.maximum(best, self.expecting.means(waiting, targets).max(axis=0))
        highest = float(self.y.max())
        top = np.maximum(highest + _MARGIN * float(np.ptp(self.y)), best)
        weights = self.problem.weights[targets] / self.problem.weights[targets].sum()
        return RowGain(self.expecting, targets, best, top, highest, weights, self.problem.risk)


def floor_of(y: Array) -> float:
    """Performance below which all is equally bad: far outside, and far below the bounds as well.

    A policy that jams a junction may be worth -800 where others reach 0.9; as they stand, such
    values would be all that a Gaussian process sees.
    """
    low, high = np.quantile(y, [0.25, 0.75])
    return float(min(low - 3.0 * (high - low), -1.0))


def observed(history: History, targets: Indices, most: int) -> tuple[Pairs, Array]:
    """Pairs and their performance: on `targets`, or all there are where rows are partial.

    Those are thinned evenly to `most`.
    """
    sources = np.asarray(history.sources, dtype=np.intp)
    y = history.rows[:, targets].ravel()
    if np.isfinite(y).all():
        return grid_pairs(sources, targets), y
    rows, seen = np.nonzero(np.isfinite(history.rows))
    if len(rows) > most:
        kept = np.linspace(0, len(rows) - 1, most).round().astype(np.intp)
        rows, seen = rows[kept], seen[kept]
    return np.column_stack([sources[rows], seen, rows]), history.rows[rows, seen]


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


@dataclass
class Model:
    """The model of the rows told, and the last one that believed something beside them.

    Attributes:
        given: all that `told` follows from.
        told: the model.
        noisy: rows have a known noise that counts.
        believing: grows while picks are asked for together.
    """

    given: tuple[Places, TransferPrior, Pairs, Array, Array | None]
    told: TransferGP
    noisy: bool
    believing: Believing | None = None

    def expecting(self, extra: Pairs) -> Believing:
        """With these pairs, of picks under way, believed to give what is expected of them."""
        before = np.empty((0, 3)) if self.believing is None else self.believing.believed
        grown = len(before) <= len(extra) and np.array_equal(before, extra[: len(before)])
        if self.believing is None or not grown:
            self.believing, before = Believing(self.told), extra[:0]
        if len(before) < len(extra):
            self.believing.believe(extra[len(before) :])
        return self.believing


_last = local()
"""The model of this thread's last pick: of a batch, all picks have the same rows told."""


def forget() -> None:
    """As in a process that has not picked before; for tests and benchmarks."""
    _last.model = None


def conditioned(
    places: Places, prior: TransferPrior, pairs: Pairs, y: Array, known: Array | None
) -> Model:
    """The model of the rows told; that of the last pick, if nothing was told since."""
    model: Model | None = getattr(_last, "model", None)
    if model is not None and _same(model.given, (places, prior, pairs, y, known)):
        return model
    believed, noise = likely_noise(places, prior, pairs, y, known)
    told = TransferGP(places, believed, pairs, y, noise)
    _last.model = model = Model((places, prior, pairs, y, known), told, bool(noise.any()))
    return model


def _same(one: tuple[Any, ...], other: tuple[Any, ...]) -> bool:
    """Whether models of these facts are one."""
    (places, prior, *arrays), (places2, prior2, *arrays2) = one, other
    pairs = zip((places.x, places.z, *arrays), (places2.x, places2.z, *arrays2), strict=True)
    return prior == prior2 and all(
        a is b if a is None or b is None else np.array_equal(a, b) for a, b in pairs
    )
