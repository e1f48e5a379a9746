"""Random: a uniform choice among the open contexts (paper, section 5)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbtl.history import History
from mbtl.selectors.base import Proposal, SelectionProblem, open_candidates


@dataclass(frozen=True)
class Random:
    """Sources in uniformly random order, without replacement."""

    name: str = "random"

    def propose(
        self, problem: SelectionProblem, history: History, rng: np.random.Generator
    ) -> Proposal:
        """Draw one open context uniformly."""
        choices = np.flatnonzero(open_candidates(problem, history))
        return Proposal(int(rng.choice(choices)), "uniform choice")
