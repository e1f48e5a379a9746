"""Equidistant: midpoints of K equal cells, from the top down (cmdp-spec 8.1, "coarse-to-fine")."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from mbtl.history import History
from mbtl.selectors.base import Proposal, SelectionProblem, nearest_open, open_candidates
from mbtl.selectors.contract import Traits


@dataclass(frozen=True)
class Equidistant:
    """The K cell midpoints of a fixed budget K, on one axis; K must be known beforehand."""

    name: str = "equidistant"
    traits: ClassVar[Traits] = Traits(deterministic=True, one_axis=True)

    def propose(
        self, problem: SelectionProblem, history: History, rng: np.random.Generator
    ) -> Proposal:
        """Next midpoint; raises `InvalidInput` when there is more than one axis."""
        line = problem.line
        mask = open_candidates(problem, history)
        k, budget = len(history.tried), problem.budget
        low, high = float(line.min()), float(line.max())
        target = low + (high - low) * (1 - 1 / (2 * budget) - (k % budget) / budget)
        return Proposal(
            nearest_open(problem, np.array([target]), mask), f"cell midpoint of {budget}"
        )
