"""Worst-first: train where the trained policies do worst (cmdp-spec 8.1; defined there, unused)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from mbtl.acquisition import TIE
from mbtl.arrays import Array, Mask
from mbtl.history import History
from mbtl.selectors.base import Proposal, SelectionProblem, first_pick, open_candidates, served
from mbtl.selectors.contract import Traits


@dataclass(frozen=True)
class WorstFirst:
    """The middle first, then always the open context with the lowest generalisation performance."""

    name: str = "worst-first"
    traits: ClassVar[Traits] = Traits(deterministic=True)

    def propose(
        self, problem: SelectionProblem, history: History, rng: np.random.Generator
    ) -> Proposal:
        """Argmin of the best performance so far among open contexts; lowest index on a tie."""
        mask = open_candidates(problem, history)
        if not history.sources:
            return first_pick(problem, history, mask)
        return Proposal(worst_context(served(problem, history), mask), "worst context so far")


def worst_context(best: Array, mask: Mask) -> int:
    """Open context with the lowest generalisation performance; the lowest index on a tie."""
    open_best = np.where(mask, best, np.inf)
    return int(np.flatnonzero(open_best <= open_best.min() + TIE)[0])
