"""V for people: the routed policies on fresh evaluation seeds.

The rows that choose the routes are noisy, so their maximum is biased upwards. The episodes here
chose nothing.

Notation (shapes): k policies in training order, N contexts, E episodes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mbtl.arrays import Array
from mbtl.objective import worst_share_mean, worst_share_weights
from mbtl.routing import routed
from mbtl.seeds import Purpose
from mbtl.trainer import Trainer, checked_returns

if TYPE_CHECKING:
    from mbtl.study.study import Study

Indices = NDArray[np.intp]


@dataclass(frozen=True)
class FreshValue:
    """V after each training on fresh episodes.

    Attributes:
        values: (k,) V, performance.
        errors: (k,) their standard errors, of the episodes; None: unknown, from one episode each.
        episodes: episodes behind each context; None: unknown.
        served: (k, N) performance of the policies that serve after each training.
    """

    values: Array
    errors: Array | None
    episodes: int | None
    served: Array

    def margins(self, confidence: float = 0.95) -> Array | None:
        """(k,) half the widths of the intervals, by Student's t; None where unknown."""
        if self.errors is None or self.episodes is None or self.episodes < 2:
            return None
        from scipy.special import stdtrit  # kept out of `import mbtl`

        return np.asarray(stdtrit(self.episodes - 1, 0.5 + confidence / 2.0) * self.errors)

    def margin(self, confidence: float = 0.95) -> float | None:
        """The last of `margins`."""
        margins = self.margins(confidence)
        return None if margins is None else float(margins[-1])


def can_report(study: Study) -> bool:
    """True when there is something to report and every policy is at hand."""
    state = study.state
    at_hand = all(row.policy or i in study.policies for i, row in enumerate(state.rows))
    return bool(state.rows) and state.fresh is None and at_hand


def report_fresh_returns(study: Study, trainer: Trainer) -> None:
    """Evaluate on fresh seeds each policy where it served at some k, and record it."""
    portfolio = study.portfolio(trainer)  # refreshes; what follows is of this moment
    routes = study.state.routing().routes
    found: list[tuple[Indices, Array]] = []
    for i, targets in enumerate(served_targets(routes)):
        returns = np.empty((0, 1))
        if targets.size:
            contexts = [study.space.context(int(t)) for t in targets]
            seeds = study.evaluation_seeds(targets, Purpose.REPORT)
            told = trainer.evaluate(portfolio.policy(i), contexts, seeds)
            returns = checked_returns(told, targets.size, study.space.named(targets))
        found.append((targets, returns))
    counts = {returns.shape[1] for targets, returns in found if targets.size}
    means = np.full(routes.shape, np.nan)
    for i, (targets, returns) in enumerate(found):
        means[i, targets] = returns.mean(axis=1)
    episodes = counts.pop() if len(counts) == 1 else None
    errors = None if episodes in (None, 1) else _value_errors(study, routes, means, found)
    study.record_fresh_returns(means, value_errors=errors, episodes=episodes)


def _value_errors(
    study: Study, routes: Indices, means: Array, found: list[tuple[Indices, Array]]
) -> Array:
    """(k,) standard error of V after each training, raw units.

    V is computed episode by episode: where all contexts share the episodes, their luck is common,
    and a mean over contexts does not make it smaller.
    """
    sign = 1.0 if study.bounds.direction == "maximize" else -1.0
    episodes = next(returns.shape[1] for targets, returns in found if targets.size)
    each = np.full((*means.shape, episodes), np.nan, dtype=np.float32)
    for i, (targets, returns) in enumerate(found):
        each[i, targets] = returns
    every = np.arange(means.shape[1])
    errors = []
    for route in routes:
        counted = worst_share_weights(
            sign * means[route, every], study.space.weights, study.spec.risk
        )
        by_episode = counted @ each[route, every].astype(np.float64)
        errors.append(by_episode.std(ddof=1) / np.sqrt(episodes))
    return np.array(errors)


def served_targets(routes: Indices) -> list[Indices]:
    """For each of k rows, the targets it serves after 1, 2, ... or k trainings."""
    return [np.flatnonzero((routes == i).any(axis=0)) for i in range(len(routes))]


def fresh_value(study: Study) -> FreshValue | None:
    """V after each training on fresh episodes, routed by the rows; None: not measured."""
    fresh = study.state.fresh
    if fresh is None:
        return None
    bounds = study.bounds
    served = routed(bounds.normalise(fresh.returns), study.state.routing().routes)
    errors = fresh.value_errors
    return FreshValue(
        worst_share_mean(served, study.space.weights, study.spec.risk),
        None if errors is None else errors / (bounds.high - bounds.low),
        fresh.episodes,
        served,
    )
