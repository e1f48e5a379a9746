"""V for people: the policies that serve, on fresh episodes, which chose nothing.

What a study says while it runs is an estimate from the episodes that choose (`mbtl.episodes`). At
its end the policies that serve are evaluated once more where they serve, and the best single policy
everywhere, so that what the others add to it is measured episode by episode.

Notation (shapes): k policies in training order, N contexts, E episodes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mbtl.arrays import Array
from mbtl.episodes import scatter_of_sum, student
from mbtl.objective import worst_share_weights
from mbtl.seeds import Purpose
from mbtl.study.state import StudyState
from mbtl.trainer import Trainer, checked_returns, completed

if TYPE_CHECKING:
    from mbtl.study.study import Study
    from mbtl.study.view import StudyView

Indices = NDArray[np.intp]


@dataclass(frozen=True)
class FreshValue:
    """V on fresh episodes.

    Attributes:
        value: V now, performance.
        margin: half its 95 % interval; None: unknown, from one episode each.
        episodes: fresh episodes of each context.
        served: (N,) performance of the policies that serve.
        best_single: place of the best single policy, by the rows that routed.
        gain: V less its own V, on the same episodes.
        gain_margin: half the 95 % interval of that; None likewise.
    """

    value: float
    margin: float | None
    episodes: int
    served: Array
    best_single: int
    gain: float
    gain_margin: float | None


@dataclass(frozen=True)
class ReportPlan:
    """What is evaluated for the closing report.

    Attributes:
        route: (N,) places of the policies that serve.
        best_single: place of the best single policy.
    """

    route: Indices
    best_single: int

    @property
    def evaluations(self) -> int:
        """Of one policy on one context each."""
        return len(self.route) + int((self.route != self.best_single).sum())

    def targets(self, policy: int) -> Indices:
        """Contexts on which a policy is evaluated."""
        everywhere = policy == self.best_single
        return np.flatnonzero(np.full(len(self.route), everywhere) | (self.route == policy))


def plan_of(study: StudyView) -> ReportPlan:
    """What the closing report of a study evaluates now: who serves, and the best single policy."""
    routing = study.state.routing()
    return ReportPlan(routing.route, routing.best_single)


def can_report(study: Study) -> bool:
    """True when there is something to report and every policy that it needs is at hand."""
    state = study.state
    if not state.rows or state.fresh is not None:
        return False
    plan = plan_of(study)
    needed = {*plan.route.tolist(), plan.best_single}
    return all(state.rows[i].policy or i in study.policies for i in needed)


def report_fresh_returns(study: Study, trainer: Trainer) -> None:
    """Evaluate what the plan says on fresh seeds, and record it."""
    portfolio = study.portfolio(trainer)  # refreshes; what follows is of this moment
    plan, rows = plan_of(study), len(study.state.rows)
    found: dict[int, Array] = {}
    for i in np.unique(np.append(plan.route, plan.best_single)).tolist():
        targets = plan.targets(i)
        contexts = [study.space.context(int(t)) for t in targets]
        seeds = study.evaluation_seeds(targets, Purpose.REPORT)
        returns = trainer.evaluate(portfolio.policy(i), contexts, seeds)
        named = study.space.named(targets)
        found[i] = completed(checked_returns(returns, targets.size, named))
    episodes = min(returns.shape[1] for returns in found.values())
    served, alone = np.empty((2, study.space.n, episodes))
    for i, returns in found.items():
        targets, mine = plan.targets(i), plan.route == i
        served[mine] = returns[mine[targets], :episodes]
        if i == plan.best_single:
            alone[:] = returns[:, :episodes]
    study.record_fresh_returns(served, alone, best_single=plan.best_single, rows=rows)


def value_of(state: StudyState) -> float:
    """V that people are told: on fresh episodes once they were played, else the running estimate.

    -inf before the first row.
    """
    fresh = fresh_value(state)
    return state.value() if fresh is None else fresh.value


def fresh_value(state: StudyState) -> FreshValue | None:
    """V on fresh episodes, as they were played when the study was reported; None: not measured."""
    fresh, bounds, spec = state.fresh, state.bounds(), state.spec
    if fresh is None:
        return None
    assert spec is not None
    weights, risk = spec.space.weights, spec.risk
    served, alone = (bounds.normalise(r) for r in (fresh.served, fresh.alone))
    means = bounds.normalise(fresh.served.mean(axis=1))
    ours = worst_share_weights(means, weights, risk)
    single = bounds.normalise(fresh.alone.mean(axis=1))
    its = worst_share_weights(single, weights, risk)
    value, gain = float(ours @ means), float(ours @ means - its @ single)
    margin = gain_margin = None
    if served.shape[1] > 1:
        margin = _margin(ours[:, None] * served)
        gain_margin = _margin(ours[:, None] * served - its[:, None] * alone)
    return FreshValue(value, margin, served.shape[1], means, fresh.best_single, gain, gain_margin)


def _margin(parts: Array) -> float:
    """Half the 95 % interval of a sum over contexts, of (N, E) episodes of its parts."""
    variance, freedom = scatter_of_sum(parts)
    return student(freedom) * float(np.sqrt(variance))
