"""MBTL with expected improvement, the paper's other acquisition (method, sections 2 and 5.8)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from mbtl.history import History
from mbtl.selectors.base import Proposal, SelectionProblem
from mbtl.selectors.mbtl import MBTL
from mbtl.selectors.model_based import fit_posterior

_MOST = 20_000


@dataclass(frozen=True)
class MBTLEI(MBTL):
    """`MBTL` whose acquisition is E_x' [ m Phi(m/s) + s phi(m/s) ]; see `expected_gain`."""

    acquisition: Literal["ucb", "ei"] = "ei"
    name: str = "mbtl-ei"


def predicted_gain(problem: SelectionProblem, history: History) -> Proposal | None:
    """The expected gain in V of the best next pick, by the model of `MBTLEI`.

    None if no context is left, or there are more than 20,000 (it sums over all pairs).

    The gain is `Proposal.acquisition`, units of performance. It rests on a linear gap and a
    Gaussian training performance, so it is a guide, not a promise.
    """
    mask = history.open_mask(problem.n)
    if problem.n > _MOST or not mask.any() or not np.isfinite(history.training_performance).any():
        return None
    model = MBTLEI()
    gp = fit_posterior(problem, history, history.training_performance, model.gp)
    return model.acquire(problem, history, mask, gp, problem.theta)
