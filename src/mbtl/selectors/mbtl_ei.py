"""MBTL with expected improvement, the paper's other acquisition (method, sections 2 and 5.8)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mbtl.acquisition import expected_gain
from mbtl.history import History
from mbtl.models import FittedGP
from mbtl.selectors.base import Proposal, SelectionProblem
from mbtl.selectors.mbtl import MBTL
from mbtl.selectors.model_based import choose, fit_posterior


@dataclass(frozen=True)
class MBTLEI(MBTL):
    """`MBTL` whose acquisition is E_x' [ m Phi(m/s) + s phi(m/s) ]; see `expected_gain`."""

    name: str = "mbtl-ei"

    def acquire(
        self,
        problem: SelectionProblem,
        history: History,
        mask: NDArray[np.bool_],
        gp: FittedGP,
        theta: float,
    ) -> Proposal:
        """The expected gain and its argmax."""
        mean, std = gp.predict(problem.steps)
        best = self.best(problem, history, gp, theta)
        gain = expected_gain(
            mean, std, problem.steps, problem.steps, best, problem.weights, theta=theta
        )
        return choose(gain, std, mask, "largest expected gain", gp.notes)


def predicted_gain(problem: SelectionProblem, history: History) -> Proposal | None:
    """The expected gain in V of the best next pick, by the model of `MBTLEI`; None if none is left.

    The gain is `Proposal.acquisition`, units of performance. It rests on a linear gap and a
    Gaussian training performance, so it is a guide, not a promise.
    """
    mask = history.open_mask(problem.n)
    if not mask.any() or not np.isfinite(history.training_performance).any():
        return None
    model = MBTLEI()
    gp = fit_posterior(problem, history, history.training_performance, model.gp)
    return model.acquire(problem, history, mask, gp, problem.theta)
