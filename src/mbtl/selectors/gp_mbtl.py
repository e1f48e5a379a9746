"""GP-MBTL: a Gaussian process of the training performance and a learned, directional gap.

Source: SD-MBTL (AAAI 2026), its own form of MBTL for several axes.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from mbtl.arrays import Array, Mask
from mbtl.history import History
from mbtl.models import GPSettings
from mbtl.models.constant_mean_gp import fit_constant_mean
from mbtl.models.directional_gap import fit_directional_gap
from mbtl.models.gp import Fitter
from mbtl.selectors.base import Proposal, SelectionProblem, open_candidates
from mbtl.selectors.contract import Traits
from mbtl.selectors.m_mbtl import middle
from mbtl.selectors.mbtl import start
from mbtl.selectors.model_based import choose, fit_posterior, gain_by_pairs, observed_incumbent

_SETTINGS = GPSettings(noise_std=1e-2, amplitude_bounds=(1e-9, 1e3))


@dataclass(frozen=True)
class GPMBTL:
    """MBTL with what it needs learned: the middle, then worst-first, then the optimistic gain.

    k = 1: the middle. k = 2, 3: the worst-served context. Then, over the open contexts,
    argmax_x sum_t w_t [ mu(x) + sqrt(log k) sigma(x) + gap(x, t) - best(t) ]_+ with sigma that of
    an observation, noise included, and the slopes of the gap from all entries of the rows seen.

    Kept as published, because harmless: the slopes have no sign imposed and also take up linear
    trends of source quality and target difficulty. Three things differ. The GP is fitted to the
    maximum of its likelihood at every pick; published are at most 500 steps of Adam from the last
    pick's values, which depends on how the study went. A pending pick is believed at the row that
    GP and gap predict. Where no gain is predicted anywhere the most uncertain context is taken, not
    the first.

    Of more than 4,000 contexts so many, spread over the space, are candidates and targets.

    Attributes:
        warm_up: number of worst-first picks after the first (published: 2); they count towards K.
        gp: bounds; `noise_std` is the least noise (published: variance 1e-4).
        fitter: fits the GP.
    """

    warm_up: int = 2
    gp: GPSettings = field(default=_SETTINGS)
    fitter: Fitter = fit_constant_mean
    name: str = "gp-mbtl"
    traits: ClassVar[Traits] = Traits(deterministic=True)

    def propose(
        self, problem: SelectionProblem, history: History, rng: np.random.Generator
    ) -> Proposal:
        """Middle, warm-up, then the argmax of the gain; ties to the lowest index."""
        mask = open_candidates(problem, history)
        if not history.tried:
            return middle(problem, mask)
        early = start(problem, history, mask, self.warm_up)
        return self.acquire(problem, history, mask) if early is None else early

    def acquire(self, problem: SelectionProblem, history: History, mask: Mask) -> Proposal:
        """The pick by GP and gap; one training performance must be known."""
        steps = problem.steps
        gp = fit_posterior(problem, history, history.training_performance, self.gp, self.fitter)
        gap = fit_directional_gap(steps[list(history.sources)], steps, history.rows)
        mean, std = gp.predict(steps)
        k = len(history) + len(history.pending) + 1
        upper = mean + np.sqrt(np.log(k) * (np.square(std) + gp.noise_variance))

        def rows_of(sources: Array) -> Array:
            return gp.predict(sources)[0][:, None] + gap.between(sources, steps)

        best = observed_incumbent(problem, history, rows_of)
        gain, asked, notes = gain_by_pairs(
            problem,
            mask,
            lambda x, t, weights: gap.gain(upper[x], steps[x], steps[t], best[t], weights),
        )
        notes = (*gp.notes, *notes)
        return choose(problem, history, gain, std, asked, "largest optimistic gain", notes)
