"""History: the transfer rows observed so far, and nothing else. All that a selector may see.

Notation (shapes): k rows observed, N targets.
    sources  (k,)     context indices trained on, in the order they were told
    rows     (k, N)   performance of each policy on every target; NaN where it was not evaluated
    pending  proposed but not yet told (other workers are training them)
    failed   trainings that gave nothing; never proposed again
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mbtl.arrays import Array
from mbtl.errors import InvalidInput
from mbtl.objective import generalisation_performance


@dataclass(frozen=True)
class History:
    """Immutable record of a selection run; `with_row` gives the next one."""

    n_targets: int
    sources: tuple[int, ...] = ()
    rows: Array = field(default_factory=lambda: np.empty((0, 0)))
    pending: tuple[int, ...] = ()
    failed: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        if self.rows.size == 0 and not self.sources:
            object.__setattr__(self, "rows", np.empty((0, self.n_targets)))
        if self.rows.shape != (len(self.sources), self.n_targets):
            raise InvalidInput(
                f"rows must have shape (sources, targets) = {(len(self.sources), self.n_targets)}, "
                f"got {self.rows.shape}"
            )

    def __len__(self) -> int:
        return len(self.sources)

    def with_row(self, source: int, row: Array) -> History:
        """The history after one more training; `row` is (N,) performance."""
        rows = np.vstack([self.rows, np.asarray(row, dtype=np.float64)[None, :]])
        pending = tuple(p for p in self.pending if p != source)
        return replace(self, sources=(*self.sources, int(source)), rows=rows, pending=pending)

    def with_pending(self, source: int) -> History:
        """The history after `source` was proposed and before it is told."""
        return replace(self, pending=(*self.pending, int(source)))

    def with_failure(self, source: int) -> History:
        """The history after the training on `source` failed."""
        pending = tuple(p for p in self.pending if p != source)
        return replace(self, pending=pending, failed=(*self.failed, int(source)))

    @cached_property
    def best(self) -> Array:
        """(N,) generalisation performance so far; -inf before the first row."""
        return generalisation_performance(self.rows)

    @cached_property
    def training_performance(self) -> Array:
        """(k,) J(pi_i, x_i): each policy on its own source."""
        return self.rows[np.arange(len(self.sources)), np.asarray(self.sources, dtype=np.intp)]

    def open_mask(self, n_candidates: int) -> NDArray[np.bool_]:
        """(M,) True where a candidate is neither trained, pending nor failed."""
        mask = np.ones(n_candidates, dtype=bool)
        taken = [*self.sources, *self.pending, *self.failed]
        mask[taken] = False
        return mask
