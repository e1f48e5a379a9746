"""Beliefs: what the rows of some policies say of their true mean returns, everywhere.

A row has entries that were measured exactly, entries measured with noise, and none at all where a
policy was not evaluated. What is believed of an entry is its measured value where that is exact,
the posterior mean of the transfer model (`mbtl.models.TransferGP`) elsewhere: noise is smoothed
away, gaps are predicted, and both come with a standard deviation.

The model weighs how much of the known noise is its own luck of every pair. The rest, of episodes
that all policies share, moves all of them alike: it changes no route, and counts fully into what
is said of V.

Notation (shapes): k policies, N contexts, T targets asked about, n observations of the model.
    rows    (k, N)  performance measured; NaN where it was not
    errors  (k, N)  their standard errors; None: unknown, taken as exact
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mbtl.arrays import Array
from mbtl.contexts import ContextSpace
from mbtl.models.columns import Columns
from mbtl.models.priors import PRIORS
from mbtl.models.transfer_gp import TransferGP, likely_noise
from mbtl.models.transfer_kernel import Pairs, Places, TransferPrior

Indices = NDArray[np.intp]

_MOST, _LEAST = 1000, 200
"""Observations that the model is conditioned on: fewer where many entries are asked about."""
_SLACK = 2.0
"""Natural logarithms of likelihood by which a belief in more noise may be behind."""
_WORK = 1e10
"""Arithmetic that one answer about all entries may cost."""


def transfer_places(space: ContextSpace) -> Places:
    """Where the contexts of a space lie, for the transfer model."""
    return Columns.of(space.axes, space.unit.shape[1]).places(space.unit, space.steps)


class Beliefs:
    """What k rows say of the true mean returns of their policies.

    Args:
        space: the N contexts.
        sources: (k,) contexts trained on, k >= 1.
        rows: (k, N) performance, NaN where not evaluated; something must be.
        errors: (k, N) standard errors of the rows; None: none known.
        prior: of the transfer model; the one chosen on all shipped matrices when missing.
    """

    def __init__(
        self,
        space: ContextSpace,
        sources: Sequence[int],
        rows: Array,
        errors: Array | None = None,
        prior: TransferPrior | None = None,
    ) -> None:
        """Nothing is fitted before something is asked that the rows do not say themselves."""
        self._space, self._rows = space, rows
        self._sources = np.asarray(sources, dtype=np.intp)
        self._known = None if errors is None else np.square(np.nan_to_num(errors))
        self._prior = prior or PRIORS["all"]
        self.measured: NDArray[np.bool_] = np.isfinite(rows)

    @property
    def exact(self) -> bool:
        """True where the rows are complete and no noise of their own is believed to be in them."""
        return bool(self.measured.all()) and not self._luck[1]

    def on(self, targets: Indices) -> tuple[Array, Array]:
        """Mean and standard deviation of every policy on some targets; (k, T) each.

        The deviation compares policies: noise that all share is not in it, but in `error`.
        """
        mean, std = self._rows[:, targets].copy(), np.zeros((len(self._rows), len(targets)))
        share = self._luck[1]
        here = self.measured[:, targets]
        asked = ~here | (share * self._variances[:, targets] > 0)
        row, at = np.nonzero(asked)
        if len(row):
            mean[row, at], std[row, at] = self._believed(row, targets[at])
        return mean, std

    def error(self, row: Indices, target: Indices, weights: Array) -> float:
        """Standard deviation of a weighted sum of true returns, sum_i w_i J(row_i, target_i).

        Args:
            row: (m,) positions of policies.
            target: (m,) contexts.
            weights: (m,) of the sum; of any sign.
        """
        return float(np.hypot(*self.doubts(row, target, weights)))

    def doubts(self, row: Indices, target: Indices, weights: Array) -> tuple[float, float]:
        """The two parts of `error`: of what pairs have for themselves, and of shared episodes."""
        share = self._luck[1]
        common = np.zeros(self._space.n)
        np.add.at(common, target, weights * np.sqrt(self._variances[row, target]))
        shared = float(np.sqrt(1.0 - share) * np.abs(common).sum())
        unsure = ~self.measured[row, target] | (share * self._variances[row, target] > 0)
        own = 0.0
        if unsure.any():
            covariance = self.joint(row[unsure], target[unsure])[1]
            own = float(weights[unsure] @ covariance @ weights[unsure])
        return float(np.sqrt(max(own, 0.0))), shared

    def joint(self, row: Indices, target: Indices) -> tuple[Array, Array]:
        """Mean (m,) and covariance (m, m) of true returns, without noise that all share."""
        model, used = self._model(len(row))
        mean, covariance = model.joint_at(self._pairs(row, target))
        extra = np.flatnonzero(self.measured[row, target] & ~used[row, target])
        if len(extra):  # measured, but not among the data: its own value counts now
            noise = self._noise(row[extra], target[extra])
            total = covariance[np.ix_(extra, extra)] + np.diag(noise)
            gain = np.linalg.solve(total, covariance[extra]).T
            mean = mean + gain @ (self._rows[row[extra], target[extra]] - mean[extra])
            covariance = covariance - gain @ covariance[extra]
        return mean, covariance

    # ---- inside ------------------------------------------------------------------------------

    @cached_property
    def _places(self) -> Places:
        return transfer_places(self._space)

    @cached_property
    def _variances(self) -> Array:
        """(k, N) of the errors; zero where none is known."""
        return np.zeros(self._rows.shape) if self._known is None else self._known

    @cached_property
    def _luck(self) -> tuple[TransferPrior, float]:
        """The prior of the rows, and the share of the known noise that each pair has for itself."""
        noisy = self._known is not None and bool(self._known.any())
        if not noisy and self.measured.all():
            return self._prior, 0.0  # nothing will be asked of the model
        row, target = self._observed(_MOST)
        known = self._variances[row, target]
        pairs, y = self._pairs(row, target), self._rows[row, target]
        prior, counted, _ = likely_noise(self._places, self._prior, pairs, y, known, slack=_SLACK)
        some = known > 0
        return prior, float(np.median(counted[some] / known[some])) if some.any() else 0.0

    def _observed(self, most: int) -> tuple[Indices, Indices]:
        """Rows and targets of at most so many measured entries, evenly thinned."""
        row, target = np.nonzero(self.measured)
        if len(row) > most:
            kept = np.linspace(0, len(row) - 1, most).round().astype(np.intp)
            row, target = row[kept], target[kept]
        return row, target

    def _noise(self, row: Indices, target: Indices) -> Array:
        return self._luck[1] * self._variances[row, target]

    def _pairs(self, row: Indices, target: Indices) -> Pairs:
        return np.column_stack([self._sources[row], target, row])

    def _model(self, asked: int) -> tuple[TransferGP, NDArray[np.bool_]]:
        """The model, and (k, N) the entries it was conditioned on."""
        most = int(np.clip(np.sqrt(_WORK / max(asked, 1)), _LEAST, _MOST))
        if most not in self._models:
            row, target = self._observed(most)
            used = np.zeros(self._rows.shape, dtype=bool)
            used[row, target] = True
            pairs, y = self._pairs(row, target), self._rows[row, target]
            noise = self._noise(row, target)
            self._models[most] = TransferGP(self._places, self._luck[0], pairs, y, noise), used
        return self._models[most]

    @cached_property
    def _models(self) -> dict[int, tuple[TransferGP, NDArray[np.bool_]]]:
        return {}

    def _believed(self, row: Indices, target: Indices) -> tuple[Array, Array]:
        model, used = self._model(len(row))
        mean, std = model.returns_at(self._pairs(row, target))
        extra = self.measured[row, target] & ~used[row, target]
        if extra.any():  # as in `joint`, each by its own value alone
            noise = self._noise(row[extra], target[extra])
            variance = np.square(std[extra])
            gain = variance / np.maximum(variance + noise, np.finfo(float).tiny)
            mean[extra] += gain * (self._rows[row[extra], target[extra]] - mean[extra])
            std[extra] = np.sqrt(variance * (1.0 - gain))
        return mean, std
