"""History: the transfer rows observed so far, and nothing else. All that a strategy may see.

Notation (shapes): k rows observed, N targets.
    sources  (k,)     context indices trained on, in the order they were told
    rows     (k, N)   performance of each policy on every target; NaN where it was not evaluated
    errors   (k, N)   standard errors of the rows (`standard_errors`); None: unknown
    pending  proposed but not yet told (other workers are training them)
    failed   trainings that gave nothing; never proposed again
    spent    cost of all of these, where the problem has costs

A *specialist* is trained on one context, from scratch, for one unit: all that the paper knows. Of
other trainings the history says what they were; `specialists` leaves them out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from mbtl.arrays import Array, Mask, unwritable
from mbtl.errors import InvalidInput
from mbtl.objective import generalisation_performance

__all__ = ["History", "Training", "standard_errors"]


@dataclass(frozen=True)
class Training:
    """What a policy is made by.

    Attributes:
        contexts: indices of those trained on.
        start: place of the row whose policy it begins with; None: from scratch; -1: of a row that
            was taken back.
        length: units of it in all, those before `start` too where it goes on from there.
        goes_on: with the policy of `start`, on the same contexts: no copy, the same training.
    """

    contexts: tuple[int, ...]
    start: int | None = None
    length: float = 1.0
    goes_on: bool = False

    @property
    def is_specialist(self) -> bool:
        """On one context, from scratch, a whole one."""
        return len(self.contexts) == 1 and self.start is None and self.length == 1.0


@dataclass(frozen=True)
class History:
    """Immutable record of a selection run; `with_row` gives the next one.

    Attributes:
        n_targets: N.
        sources: of a policy trained on several contexts, the one in their middle.
        rows: see above, as for what follows.
        pending: sources of specialists.
        failed: likewise.
        errors: of the rows.
        spent: of the cost budget.
        trainings: (k,) how the policies were made; none: all are specialists.
        under_way: trainings of other kinds that others are at.
        given_up: likewise, that gave nothing.
        paid: units of the budget that are spent or set aside; what is left pays for trainings.
        others: (N,) the best performance of policies that are not among the rows; None: there are
            none.
    """

    n_targets: int
    sources: tuple[int, ...] = ()
    rows: Array = field(default_factory=lambda: np.empty((0, 0)))
    pending: tuple[int, ...] = ()
    failed: tuple[int, ...] = ()
    errors: Array | None = None
    spent: float = 0.0
    trainings: tuple[Training, ...] = ()
    under_way: tuple[Training, ...] = ()
    given_up: tuple[Training, ...] = ()
    paid: float = 0.0
    others: Array | None = None

    def __post_init__(self) -> None:
        if self.rows.size == 0 and not self.sources:
            object.__setattr__(self, "rows", np.empty((0, self.n_targets)))
        if self.rows.shape != (len(self.sources), self.n_targets):
            raise InvalidInput(
                f"rows must have shape (sources, targets) = {(len(self.sources), self.n_targets)}, "
                f"got {self.rows.shape}"
            )
        if self.errors is not None and self.errors.shape != self.rows.shape:
            raise InvalidInput(
                f"errors must have the shape of the rows {self.rows.shape}, got {self.errors.shape}"
            )
        for name in ("rows", "errors", "others"):
            object.__setattr__(self, name, unwritable(getattr(self, name)))

    def __len__(self) -> int:
        return len(self.sources)

    def made(self, row: int) -> Training:
        """How the policy of a row was made."""
        return self.trainings[row] if self.trainings else Training((self.sources[row],))

    @property
    def asked(self) -> tuple[Training, ...]:
        """All trainings that were asked for, or told: done, under way or failed."""
        alone = (Training((source,)) for source in (*self.pending, *self.failed))
        done = (self.made(row) for row in range(len(self)))
        return (*done, *self.under_way, *self.given_up, *alone)

    def specialists(self) -> History:
        """The same without all other trainings: what a selector may see.

        Of those it knows the best performance alone, which a specialist must exceed to be of use.
        """
        kept = [i for i, one in enumerate(self.trainings) if one.is_specialist]
        if len(kept) == len(self.trainings):
            return self
        left_out = np.delete(self.rows, kept, axis=0)
        return replace(
            self,
            sources=tuple(self.sources[i] for i in kept),
            rows=self.rows[kept],
            errors=None if self.errors is None else self.errors[kept],
            trainings=(),
            under_way=(),
            given_up=(),
            others=self.at_least(generalisation_performance(left_out)),
        )

    def at_least(self, best: Array | float) -> Array:
        """(N,) or (..., N) `best`, or that of the other policies where it is higher."""
        return np.asarray(best if self.others is None else np.maximum(best, self.others))

    def with_row(self, source: int, row: Array) -> History:
        """The history after one more training; `row` is (N,) performance, taken as exact."""
        rows = np.vstack([self.rows, np.asarray(row, dtype=np.float64)[None, :]])
        pending = tuple(p for p in self.pending if p != source)
        exact = np.zeros(self.n_targets)
        errors = None if self.errors is None else np.vstack([self.errors, exact])
        return replace(
            self, sources=(*self.sources, int(source)), rows=rows, pending=pending, errors=errors
        )

    def with_pending(self, source: int) -> History:
        """The history after `source` was proposed and before it is told."""
        return replace(self, pending=(*self.pending, int(source)))

    def with_failure(self, source: int) -> History:
        """The history after the training on `source` failed."""
        pending = tuple(p for p in self.pending if p != source)
        return replace(self, pending=pending, failed=(*self.failed, int(source)))

    @property
    def tried(self) -> tuple[int, ...]:
        """All contexts that a specialist was asked for on: trained, pending or failed."""
        made = [one.contexts[0] for one in self.trainings if one.is_specialist]
        return (*(made if self.trainings else self.sources), *self.pending, *self.failed)

    @cached_property
    def best(self) -> Array:
        """(N,) generalisation performance so far; -inf before the first row."""
        return unwritable(self.at_least(generalisation_performance(self.rows)))

    @cached_property
    def training_performance(self) -> Array:
        """(k,) J(pi_i, x_i): each policy on its own source."""
        here = np.asarray(self.sources, dtype=np.intp)
        return unwritable(self.rows[np.arange(len(here)), here])

    def open_mask(self, n_candidates: int) -> Mask:
        """(M,) True where a specialist is neither trained nor pending, and never failed."""
        mask = np.ones(n_candidates, dtype=bool)
        mask[[*self.tried]] = False
        return mask


USUAL = 10.0
"""Degrees of freedom that the usual scatter of a row and of a target is worth."""


def standard_errors(deviations: Array, episodes: Sequence[int]) -> Array | None:
    """Standard errors of rows from the scatter of their episodes.

    A variance of few episodes is itself mostly chance, and an entry whose episodes happened to
    agree would pass for exact. Each therefore counts as much as its degrees of freedom say, and
    what is usual in its row and on its target counts as ten more (moderated variances, Smyth 2004).
    An entry of one episode has the usual scatter.

    Args:
        deviations: (k, N) of single episodes, with n - 1; NaN where unknown.
        episodes: (k,) behind each row.

    Returns:
        (k, N); None where no scatter was seen: nothing is known then, or there is no noise.
    """
    seen = np.isfinite(deviations)
    variances = np.where(seen, np.square(deviations), 0.0)
    overall = float(variances[seen].mean()) if seen.any() else 0.0
    if overall == 0.0:
        return None

    def usual(axis: int) -> Array:
        total, count = variances.sum(axis=axis, keepdims=True), seen.sum(axis=axis, keepdims=True)
        return np.asarray((total + USUAL * overall) / (count + USUAL))

    count = np.asarray(episodes, dtype=np.float64)[:, None]
    own = np.where(seen, count - 1.0, 0.0)
    pooled = usual(1) * (usual(0) / overall)
    return np.asarray(np.sqrt((own * variances + USUAL * pooled) / (own + USUAL) / count))
