"""Greedy: split the widest gap.

Each step is optimal if the training performance is constant and the gap linear.
Source: cmdp-spec 8.1, "pseudo-greedy" of the released code; needs no returns.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from mbtl.history import History
from mbtl.selectors.base import Proposal, SelectionProblem, centre, nearest_open, open_candidates
from mbtl.selectors.contract import Traits


@dataclass(frozen=True)
class Greedy:
    """Gap splitting on one axis: the middle first, then the widest gap (the first of equals).

    An inner gap is split at its middle; a gap that touches an end of the line is split at one third
    from that end, because its far side serves nobody else.
    """

    name: str = "greedy"
    traits: ClassVar[Traits] = Traits(deterministic=True, one_axis=True)

    def propose(
        self, problem: SelectionProblem, history: History, rng: np.random.Generator
    ) -> Proposal:
        """Split the widest gap; raises `InvalidInput` when there is more than one axis."""
        line = problem.line
        mask = open_candidates(problem, history)
        taken = sorted(float(line[i]) for i in history.tried)
        if not taken:
            return Proposal(nearest_open(problem, centre(problem), mask), "middle of the range")
        low, high = float(line.min()), float(line.max())
        ends = np.array([low, *taken, high])
        widths = np.diff(ends)
        widest = int(np.flatnonzero(widths >= widths.max() - 1e-9)[0])
        a, b = ends[widest], ends[widest + 1]
        if widest == 0:
            target = (2 * a + b) / 3
        elif widest == len(widths) - 1:
            target = (a + 2 * b) / 3
        else:
            target = (a + b) / 2
        return Proposal(nearest_open(problem, np.array([target]), mask), "splits the widest gap")
