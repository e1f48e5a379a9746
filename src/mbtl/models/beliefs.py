"""Beliefs: what the rows of some policies say of their true mean returns, everywhere.

A row has entries that were measured exactly, entries measured with noise, and none at all where a
policy was not evaluated. What is believed of an entry is its measured value where that is exact,
the posterior mean of the transfer model (`mbtl.models.TransferGP`) elsewhere: noise is smoothed
away, gaps are predicted, and both come with a standard deviation.

Episodes of different contexts have nothing in common; those of one context are the same for every
policy, which share some of their luck. Entries of a row are weighed alike: where episodes were
lucky they scatter little, so that weights by the scatter of each would believe the lucky ones.
What is said of the errors is of the scatter of each.

Notation (shapes): k policies, N contexts, T targets asked about, n observations, F folds.
    rows    (k, N)  performance measured; NaN where it was not
    errors  (k, N)  their standard errors; None: unknown, taken as exact
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property

import numpy as np

from mbtl.arrays import Array, Indices, Mask
from mbtl.models.priors import PRIORS
from mbtl.models.transfer_gp import ENOUGH, TransferGP, likely_noise
from mbtl.models.transfer_kernel import Located, Pairs, Places, TransferPrior, transfer_places

_MOST, _LEAST = 1000, 200
"""Observations that the model is conditioned on: fewer where many entries are asked about."""
_SLACK = 2.0
"""Natural logarithms of likelihood by which noisier pairs must be ahead to be believed in."""
_WORK = 1e10
"""Arithmetic that one answer about all entries may cost."""


class Beliefs:
    """What k rows say of the true mean returns of their policies.

    Args:
        space: the N contexts.
        sources: (k,) contexts trained on, k >= 1.
        rows: (k, N) performance, NaN where not evaluated; something must be.
        errors: (k, N) standard errors of the rows; None: none known.
        own: share of their variances that each policy has for itself; all share the rest.
        prior: of the transfer model; the one chosen on all shipped matrices when missing.
    """

    def __init__(
        self,
        space: Located,
        sources: Sequence[int],
        rows: Array,
        errors: Array | None = None,
        own: float = 1.0,
        prior: TransferPrior | None = None,
    ) -> None:
        """Nothing is fitted before something is asked that the rows do not say themselves."""
        self._space, self._rows = space, rows
        self._sources = np.asarray(sources, dtype=np.intp)
        self._own_share, self._prior = own, prior or PRIORS["all"]
        self.measured: Mask = np.isfinite(rows)
        self._models: dict[int, tuple[TransferGP, tuple[Indices, Indices], Mask]] = {}
        self._true: Array | None = None  # variances
        if errors is not None and np.nan_to_num(errors).any():
            self._true = np.square(np.nan_to_num(errors))

    @property
    def exact(self) -> bool:
        """True where the rows are complete and no noise is known to be in them."""
        return self._true is None and bool(self.measured.all())

    def unsure(self, row: Indices, target: Indices) -> Mask:
        """Where something is to be believed, because nothing or not enough was measured."""
        noisy = False if self._true is None else self._true[row, target] > 0
        return np.asarray(~self.measured[row, target] | noisy)

    def on(self, targets: Indices) -> tuple[Array, Array]:
        """Mean and standard deviation of every policy on some targets; (k, T) each."""
        mean, std = self._rows[:, targets].copy(), np.zeros((len(self._rows), len(targets)))
        row, at = np.nonzero(self.unsure(*np.ix_(np.arange(len(mean)), targets)))
        if len(row):
            mean[row, at], std[row, at] = self._believed(row, targets[at])
        return mean, std

    def on_folds(self, targets: Indices, told: Callable[[Indices, Indices], Array]) -> Array:
        """(F, k, T) the means of `on`, had the rows been others, with the same noise.

        Args:
            targets: (T,).
            told: (m,) policies and contexts, measured, to (m, F) performance.
        """
        k = len(self._rows)
        row, at = (each.ravel() for each in np.indices((k, len(targets))))
        target, seen = targets[at], self.measured[row, targets[at]]
        found = told(row[seen], target[seen])
        mean = np.full((len(row), found.shape[1]), np.nan)
        mean[seen] = found
        unsure = np.flatnonzero(self.unsure(row, target))
        if len(unsure):
            row, target = row[unsure], target[unsure]
            model, observed, used = self._model(len(row))
            believed = model.means_at(self._pairs(row, target), told(*observed))
            extra = np.flatnonzero(self.measured[row, target] & ~used[row, target])
            if len(extra):
                std = model.returns_at(self._pairs(row[extra], target[extra]))[1]
                gain = self._gain(std, row[extra], target[extra])[:, None]
                believed[extra] += gain * (mean[unsure[extra]] - believed[extra])
            mean[unsure] = believed
        return np.moveaxis(mean.reshape(k, len(targets), -1), 2, 0)

    def error(self, row: Indices, target: Indices, weights: Array) -> float:
        """Standard deviation of a weighted sum of true returns, sum_i w_i J(row_i, target_i).

        Args:
            row: (m,) positions of policies.
            target: (m,) contexts.
            weights: (m,) of the sum; of any sign.
        """
        unsure = self.unsure(row, target)
        if not unsure.any():
            return 0.0
        weighed, covariance = weights[unsure], self.joint(row[unsure], target[unsure])[1]
        return float(np.sqrt(max(float(weighed @ covariance @ weighed), 0.0)))

    def joint(self, row: Indices, target: Indices) -> tuple[Array, Array]:
        """Mean (m,) and covariance (m, m) of true returns."""
        model, observed, used = self._model(len(row))
        excess = None
        if self._true is not None:
            excess = self._noise(self._true, *observed) - self._noise(self._even, *observed)
        mean, covariance = model.joint_at(self._pairs(row, target), excess)
        extra = np.flatnonzero(self.measured[row, target] & ~used[row, target])
        if len(extra):  # measured, but not among the data: its own value counts now
            assert self._true is not None
            at = row[extra], target[extra]
            total = covariance[np.ix_(extra, extra)] + np.diag(self._even[at])
            gain = np.linalg.solve(total, covariance[extra]).T
            mean = mean + gain @ (self._rows[at] - mean[extra])
            covariance = covariance - gain @ covariance[extra]
            covariance += (gain * (self._true[at] - self._even[at])) @ gain.T
        return mean, covariance

    # ---- inside ------------------------------------------------------------------------------

    @cached_property
    def _places(self) -> Places:
        return transfer_places(self._space)

    @cached_property
    def _even(self) -> Array:
        """(k, N) variances by which entries are weighed: those usual in the row."""
        assert self._true is not None
        there = self.measured & (self._true > 0)
        usual = np.where(there, self._true, 0.0).sum(axis=1, keepdims=True)
        return np.where(there, usual / np.maximum(there.sum(axis=1, keepdims=True), 1), 0.0)

    def _noise(self, variances: Array, row: Indices, target: Indices) -> Array:
        """(n, n) covariance of the noise of measured entries."""
        deviations = np.sqrt(variances[row, target])
        alike = np.where(row[:, None] == row, 1.0, 1.0 - self._own_share)
        alike *= target[:, None] == target
        return np.asarray(alike * np.outer(deviations, deviations))

    @cached_property
    def _likely_prior(self) -> TransferPrior:
        """With pairs that are noisy themselves, where only that explains how they scatter."""
        return likely_noise(
            self._places, self._prior, *self._data(*self._observed(ENOUGH)), shares=(1.0,),
            slack=_SLACK,
        )[0]  # fmt: skip

    def _observed(self, most: int) -> tuple[Indices, Indices]:
        """Rows and targets of at most so many measured entries, evenly thinned."""
        row, target = np.nonzero(self.measured)
        if len(row) > most:
            kept = np.linspace(0, len(row) - 1, most).round().astype(np.intp)
            row, target = row[kept], target[kept]
        return row, target

    def _pairs(self, row: Indices, target: Indices) -> Pairs:
        return np.column_stack([self._sources[row], target, row])

    def _data(self, row: Indices, target: Indices) -> tuple[Pairs, Array, Array | None]:
        """Measured entries as the model takes them: pairs, performance and noise."""
        noise = None if self._true is None else self._noise(self._even, row, target)
        return self._pairs(row, target), self._rows[row, target], noise

    def _model(self, asked: int) -> tuple[TransferGP, tuple[Indices, Indices], Mask]:
        """The model, the entries it was conditioned on, and (k, N) which these are."""
        most = int(np.clip(np.sqrt(_WORK / max(asked, 1)), _LEAST, _MOST))
        if most not in self._models:
            observed = self._observed(most)
            model = TransferGP(self._places, self._likely_prior, *self._data(*observed))
            used = np.zeros(self._rows.shape, dtype=bool)
            used[observed] = True
            self._models[most] = model, observed, used
        return self._models[most]

    def _gain(self, deviations: Array, row: Indices, target: Indices) -> Array:
        """How much of the way from what is believed of entries to what was measured there."""
        variance = np.square(deviations)
        noise = 0.0 if self._true is None else self._even[row, target]
        return np.asarray(variance / np.maximum(variance + noise, np.finfo(float).tiny))

    def _believed(self, row: Indices, target: Indices) -> tuple[Array, Array]:
        model, _, used = self._model(len(row))
        mean, std = model.returns_at(self._pairs(row, target))
        extra = self.measured[row, target] & ~used[row, target]
        if extra.any():  # as in `joint`, each by its own value alone
            gain = self._gain(std[extra], row[extra], target[extra])
            mean[extra] += gain * (self._rows[row[extra], target[extra]] - mean[extra])
            std[extra] *= np.sqrt(1.0 - gain)
        return mean, std
