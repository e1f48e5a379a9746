"""What the model-based selectors share: the posterior, the incumbent, and the final choice."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from mbtl.acquisition import argmax_open
from mbtl.arrays import Array, Indices, Mask
from mbtl.errors import MbtlError
from mbtl.history import History
from mbtl.models import FittedGP, GPSettings
from mbtl.models.gp import Fitter, squared_distances
from mbtl.selectors.base import Proposal, SelectionProblem, served, spread, success_chance

GainOf = Callable[[Indices, Indices, Array], Array]
MOST = 4000
"""Contexts that are candidates, and targets, where every pair of them takes time."""
_NOTHING = 1e-12  # cmdp-spec 8.2: an acquisition below this everywhere says nothing


def fit_posterior(
    problem: SelectionProblem,
    history: History,
    targets: Array,
    settings: GPSettings,
    fitter: Fitter,
) -> FittedGP:
    """GP of the training performance on grid steps, pending picks believed at their mean.

    Args:
        problem: gives the grid steps.
        history: which sources were trained, and which are pending.
        targets: (k,) values to fit, one per trained source; NaN (not evaluated there) is left out.
        settings: kernel bounds and noise.
        fitter: fits the GP.
    """
    seen = np.isfinite(targets)
    sources = np.asarray(history.sources, dtype=np.intp)[seen]
    try:
        gp = fitter(problem.steps[sources], targets[seen], settings)
        if gp.jitter:
            note = f"the kernel matrix was singular; added jitter {gp.jitter:g}"
            gp = replace(gp, notes=(*gp.notes, note))
    except (np.linalg.LinAlgError, MbtlError) as error:
        gp = _fallback(problem.steps[sources], targets[seen], settings, str(error))
    if history.pending:
        gp = gp.with_believed(problem.steps[list(history.pending)])
    return gp


def _fallback(points: Array, y: Array, settings: GPSettings, reason: str) -> FittedGP:
    """A GP without a fit: amplitude mean(y^2), length the median distance; noted in the study."""
    squared = squared_distances(points, points)
    apart = squared[squared > 0]
    length = float(np.sqrt(np.median(apart))) if apart.size else 1.0
    amplitude = float(np.mean(np.square(y))) or 1.0
    note = f"GP fit failed ({reason}); used amplitude {amplitude:.3g} and length {length:.3g}"
    noise = max(settings.noise_std**2, 1e-6 * amplitude)
    return FittedGP(points, y, amplitude, length, noise, (note,))


def observed_incumbent(
    problem: SelectionProblem, history: History, rows_of: Callable[[Array], Array]
) -> Array:
    """(N,) best performance per target in the observed rows, and believed of pending picks.

    Of policies not evaluated there, what the transfer model believes; 0 where nothing is known.

    Args:
        problem: gives the grid steps.
        history: what was observed, and what is pending.
        rows_of: (k, D) grid steps of sources to the (k, N) rows that are believed of them.
    """
    best = served(problem, history)
    best = np.where(np.isfinite(best), best, 0.0)
    if not history.pending:
        return best
    believed = rows_of(problem.steps[list(history.pending)])
    return np.asarray(np.fmax(best, believed.max(axis=0)))


def predicted_rows(
    training_performance: Array, sources: Array, steps: Array, theta: float
) -> Array:
    """(k, N) rows that the linear gap predicts, J(pi_i, x_i) - theta |x_i - x'|.

    Args:
        training_performance: (k,) J(pi_i, x_i).
        sources: (k, D) grid steps of x_i.
        steps: (N, D) grid steps of the targets x'.
        theta: slope of the gap, performance per grid step (paper, Assumption 1).
    """
    distance = np.sqrt(squared_distances(sources, steps))
    return np.asarray(training_performance[:, None] - theta * distance)


def gain_by_pairs(
    problem: SelectionProblem, mask: Mask, gain_of: GainOf
) -> tuple[Array, Mask, tuple[str, ...]]:
    """A gain that takes time for every pair of a candidate and a target.

    Of more than `MOST` contexts so many open ones are candidates and so many targets, spread over
    the space; a note says so.

    Args:
        problem: gives the contexts and their weights.
        mask: (N,) of the open ones.
        gain_of: (M,) gain of candidates on targets with weights, sum 1.

    Returns:
        (N,) gain, NaN where it was not asked; (N,) mask of the open ones where it was; notes.
    """
    n = problem.n
    if n <= MOST:
        every = np.arange(n)
        return gain_of(every, every, problem.weights), mask, ()
    candidates = spread(problem, np.flatnonzero(mask), MOST)
    targets = spread(problem, np.flatnonzero(problem.weights > 0), MOST)
    weights = problem.weights[targets]
    gain, asked = np.full(n, np.nan), np.zeros(n, dtype=bool)
    gain[candidates] = gain_of(candidates, targets, weights / weights.sum())
    asked[candidates] = True
    note = f"{len(candidates):,} candidates and {len(targets):,} targets stood for {n:,} contexts"
    return gain, asked, (note,)


def choose(
    problem: SelectionProblem,
    history: History,
    acquisition: Array,
    std: Array,
    mask: Mask,
    reason: str,
    notes: tuple[str, ...],
) -> Proposal:
    """The largest acquisition; where it is zero everywhere, the largest posterior deviation.

    Both count as much as a training there is likely to give a policy.
    """
    success = success_chance(problem, history)
    source = argmax_open(acquisition * success, mask)
    if acquisition[source] <= _NOTHING:
        source = argmax_open(std * success, mask)
        return Proposal(source, "no predicted gain anywhere: most uncertain context", 0.0, notes)
    return Proposal(source, reason, float(acquisition[source]), notes)
