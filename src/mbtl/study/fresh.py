"""V for people: the routed policies on fresh evaluation seeds.

The rows that choose the routes are noisy, so their maximum is biased upwards. The episodes here
chose nothing.

Notation (shapes): k policies in training order, N contexts.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mbtl.arrays import Array
from mbtl.objective import worst_share_mean
from mbtl.seeds import Purpose, evaluation_seed
from mbtl.study.study import Study
from mbtl.trainer import Trainer, checked_returns

Indices = NDArray[np.intp]


def can_report(study: Study) -> bool:
    """True when there is something to report and every policy is at hand."""
    state = study.state
    at_hand = all(row.policy or i in study.policies for i, row in enumerate(state.rows))
    return bool(state.rows) and state.fresh_returns is None and at_hand


def report_fresh_returns(study: Study, trainer: Trainer) -> Array:
    """Evaluate on fresh seeds each policy where it served at some k; record and return (k, N)."""
    portfolio = study.portfolio(trainer)  # refreshes; what follows is of this moment
    history = study.history
    seed = evaluation_seed(study.spec.seed, study.spec.trial, Purpose.REPORT)
    fresh = np.full(history.rows.shape, np.nan)
    for i, targets in enumerate(served_targets(routes(study))):
        if targets.size:
            contexts = [study.space.context(int(t)) for t in targets]
            returns = trainer.evaluate(portfolio.policy(i), contexts, seed)
            fresh[i, targets] = checked_returns(returns, targets.size).mean(axis=1)
    study.record_fresh_returns(fresh)
    return fresh


def routes(study: Study) -> Indices:
    """(k, N) row index that serves each target after 1..k trainings, as the portfolio routes it."""
    rows = study.history.rows
    if np.isfinite(rows).all():
        return routes_by_k(rows)
    whole = study.portfolio()
    return np.array([whole.first(k).assignment for k in range(1, len(rows) + 1)])


def routes_by_k(rows: Array) -> Indices:
    """(k, N) row index that serves each target after 1..k trainings; the first of equals."""
    running = np.maximum.accumulate(rows, axis=0)
    improved = np.vstack([np.ones((1, rows.shape[1]), dtype=bool), running[1:] > running[:-1]])
    index = np.where(improved, np.arange(len(rows))[:, None], 0)
    return np.asarray(np.maximum.accumulate(index, axis=0))


def served_targets(routes: Indices) -> list[Indices]:
    """For each of k rows, the targets it serves after 1, 2, ... or k trainings."""
    return [np.flatnonzero((routes == i).any(axis=0)) for i in range(len(routes))]


def fresh_curve(study: Study, routed: Array | None = None) -> Array | None:
    """(k,) V after each training, routed by the selecting rows, measured on fresh episodes.

    Args:
        study: that was reported.
        routed: what `fresh_performance` gives, where it is at hand.
    """
    routed = fresh_performance(study) if routed is None else routed
    if routed is None:
        return None
    return worst_share_mean(routed, study.space.weights, study.spec.risk)


def fresh_performance(study: Study) -> Array | None:
    """(k, N) performance after each training where it would be used, on fresh episodes."""
    fresh = study.state.fresh_returns
    if fresh is None:
        return None
    performance = study.bounds.normalise(fresh)
    return np.take_along_axis(performance, routes(study), axis=0)
