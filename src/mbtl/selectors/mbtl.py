"""MBTL as in the camera-ready paper: middle first, warm-up, then the optimistic gain.

Source: Cho et al., NeurIPS 2024; rules where the paper is silent: cmdp-spec 8.2.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar, Literal

import numpy as np

from mbtl.acquisition import expected_gain, optimistic_gain
from mbtl.arrays import Array, Indices, Mask
from mbtl.errors import InvalidInput
from mbtl.history import History
from mbtl.models import GPSettings, fit_gp
from mbtl.models.gp import Fitter
from mbtl.selectors.base import (
    Outlook,
    Proposal,
    SelectionProblem,
    first_pick,
    likely_candidates,
    open_candidates,
    served,
)
from mbtl.selectors.contract import Traits
from mbtl.selectors.model_based import (
    choose,
    fit_posterior,
    gain_by_pairs,
    observed_incumbent,
    predicted_rows,
)
from mbtl.selectors.worst_first import worst_context


def ucb_weight(k: int, n: int) -> float:
    """Exploration weight of the paper's experiments: beta_k = 2 log(N k^2).

    Args:
        k: number of the pick, from 1.
        n: number of contexts N.
    """
    return float(2.0 * np.log(n * float(k) ** 2))


@dataclass(frozen=True)
class MBTL:
    """Model-based transfer learning.

    k = 1: the middle. k = 2 .. 1 + warm_up: the worst-served context. Then
    argmax_x E_x' [ mu(x) + sqrt(beta_k) sigma(x) - theta |x - x'| - best(x') ]_+ with
    beta_k = 2 log(N k^2), or the expected gain.

    Of more than 4,000 contexts so many, spread over the space, are candidates and targets.

    Attributes:
        acquisition: "ucb", the paper's optimistic gain, or "ei", the expected gain.
        warm_up: number of worst-first picks after the first (paper: 3); they count towards K.
        gp: kernel bounds and noise (paper: noise std 0.001).
        fitter: fits the GP.
    """

    acquisition: Literal["ucb", "ei"] = "ucb"
    warm_up: int = 3
    gp: GPSettings = field(default_factory=GPSettings)
    fitter: Fitter = fit_gp
    name: str = "mbtl"
    traits: ClassVar[Traits] = Traits(deterministic=True)

    def __post_init__(self) -> None:
        if self.warm_up < 0:
            raise InvalidInput(f"warm_up must be >= 0, got {self.warm_up}")
        if self.acquisition not in ("ucb", "ei"):
            raise InvalidInput(f"acquisition must be 'ucb' or 'ei', got {self.acquisition!r}")

    def propose(
        self, problem: SelectionProblem, history: History, rng: np.random.Generator
    ) -> Proposal:
        """Middle, warm-up, then the argmax of the acquisition; ties to the lowest index."""
        mask = open_candidates(problem, history)
        early = start(problem, history, mask, self.warm_up)
        if early is not None:
            return early
        _, std, gain, asked, notes = self._judged(problem, history, mask)
        kind = "expected" if self.acquisition == "ei" else "optimistic"
        return choose(problem, history, gain, std, asked, f"largest {kind} gain", notes)

    def outlook(self, problem: SelectionProblem, history: History, candidates: Indices) -> Outlook:
        """The posterior and the acquisition, with the number of the next pick."""
        every = np.ones(problem.n, dtype=bool)
        mean, std, gain, *_ = self._judged(problem, history, every)
        return Outlook(self.name, mean, std, gain)

    def _judged(
        self, problem: SelectionProblem, history: History, mask: Mask
    ) -> tuple[Array, Array, Array, Mask, tuple[str, ...]]:
        """(N,) posterior mean and deviation, and acquisition with what `gain_by_pairs` says."""
        where, theta = problem.steps, problem.theta
        gp = fit_posterior(problem, history, self._observed(history), self.gp, self.fitter)
        mean, std = gp.predict(where)
        k = len(history) + len(history.pending) + 1
        upper = mean + np.sqrt(self._weight(k, problem.n)) * std

        def rows_of(sources: Array) -> Array:
            return predicted_rows(gp.predict(sources)[0], sources, where, theta)

        best = np.maximum(observed_incumbent(problem, history, rows_of), self._least)

        def gain_of(x: Indices, t: Indices, weights: Array) -> Array:
            rest = (where[x], where[t], best[t], weights)
            if self.acquisition == "ei":
                return expected_gain(mean[x], std[x], *rest, theta=theta)
            return optimistic_gain(upper[x], *rest, theta=theta)

        gain, asked, notes = gain_by_pairs(problem, mask, gain_of)
        return mean, std, gain, asked, (*gp.notes, *notes)

    # ---- what another form of the rule has otherwise --------------------------------------------

    _least: ClassVar[float] = -np.inf
    """Performance that a target counts as served with at least."""

    def _weight(self, k: int, n: int) -> float:
        return ucb_weight(k, n)

    def _observed(self, history: History) -> Array:
        """(k,) what the GP is fitted to."""
        return history.training_performance


@dataclass(frozen=True)
class MBTLEI(MBTL):
    """`MBTL` with expected improvement, E_x' [ m Phi(m/s) + s phi(m/s) ]; see `expected_gain`.

    Source: the paper's other acquisition (method, sections 2 and 5.8).
    """

    acquisition: Literal["ucb", "ei"] = "ei"
    name: str = "mbtl-ei"


def start(problem: SelectionProblem, history: History, mask: Mask, warm_up: int) -> Proposal | None:
    """The middle, then `warm_up` worst-first picks; None once the model should decide.

    Warm-up goes on while no training performance is known, since there is nothing to fit.
    """
    if not history.sources:
        return first_pick(problem, history, mask)
    known = history.training_performance[np.isfinite(history.training_performance)]
    if len(history.tried) < 1 + warm_up or not known.size:
        best = served(problem, history)
        if history.pending and known.size:  # others serve the contexts around them
            own = np.full(len(history.pending), known.mean())
            pending = problem.steps[list(history.pending)]
            rows = predicted_rows(own, pending, problem.steps, problem.theta)
            best = np.fmax(best, rows.max(axis=0))
        counted = mask & (problem.weights > 0)
        counted = counted if counted.any() else mask
        worst = worst_context(best, likely_candidates(problem, history, counted))
        return Proposal(worst, "warm-up: worst context so far")
    return None
