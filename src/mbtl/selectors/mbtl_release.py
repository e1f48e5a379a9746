"""MBTL as in the released code, which is not the camera-ready paper (cmdp-spec 8.2)."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from mbtl.arrays import Array
from mbtl.history import History
from mbtl.models import GPSettings, fit_gp
from mbtl.models.gp import Fitter
from mbtl.selectors.base import Proposal, SelectionProblem, open_candidates
from mbtl.selectors.contract import Traits
from mbtl.selectors.mbtl import start
from mbtl.selectors.model_based import (
    choose,
    fit_posterior,
    linear_rows,
    observed_incumbent,
    optimistic_gains,
)


@dataclass(frozen=True)
class MBTLRelease:
    """The released rules: no warm-up, lambda = sqrt(log(n + 1)), GP noise std 0.1, incumbent >= 0.

    The GP is fitted to the best score on each source right after it was trained, so to the larger
    of its own and an earlier transferred one. Ties: the release leaves them to an unstable sort;
    here the lowest index.
    """

    gp: GPSettings = field(default_factory=lambda: GPSettings(noise_std=0.1))
    fitter: Fitter = fit_gp
    name: str = "mbtl-release"
    traits: ClassVar[Traits] = Traits(deterministic=True)

    def propose(
        self, problem: SelectionProblem, history: History, rng: np.random.Generator
    ) -> Proposal:
        """Middle, then the argmax of the optimistic gain with the release's constants."""
        mask = open_candidates(problem, history)
        early = start(problem, history, mask, 0)
        if early is not None:
            return early
        gp = fit_posterior(problem, history, running_own_best(history), self.gp, self.fitter)
        mean, std = gp.predict(problem.steps)
        n = len(history) + len(history.pending)
        upper = mean + np.sqrt(np.log(n + 1.0)) * std
        best = np.maximum(observed_incumbent(problem, history, linear_rows(problem, gp)), 0.0)
        gain, asked, notes = optimistic_gains(problem, mask, upper, best, problem.theta)
        notes = (*gp.notes, *notes)
        return choose(problem, history, gain, std, asked, "largest optimistic gain", notes)


def running_own_best(history: History) -> Array:
    """(k,) y_l = max over m <= l of J(pi_m, x_l): the best score on source l right after it."""
    columns = history.rows[:, np.asarray(history.sources, dtype=np.intp)]
    return np.asarray(np.diagonal(np.fmax.accumulate(columns, axis=0)).copy())
