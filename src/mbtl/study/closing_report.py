"""V for people: the policies that serve, on fresh episodes, which chose nothing.

What a study says while it runs is an estimate from the episodes that choose (`mbtl.episodes`). At
its end the policies that serve are evaluated once more where they serve, and the best single policy
there, too, so that what the others add to it is measured episode by episode. On many contexts that
would cost more than the study: a sample of them then says by how much the estimate is wrong.

Notation (shapes): k policies in training order, N contexts, n of them played, E episodes.
"""

from __future__ import annotations

from collections.abc import Container
from dataclasses import dataclass

import numpy as np

from mbtl.arrays import Array, Indices, Mask
from mbtl.episodes import scatter_of_sum, student
from mbtl.routing import SURE
from mbtl.seeds import Purpose, derive_seed
from mbtl.study.problem import Beside
from mbtl.study.state import StudyState

CHEAP, SHARE = 200, 0.25
"""Evaluations that a report may cost where the study cost as many, and the share of the study's
that it may cost beyond; baselines are not counted. 100 contexts make V's interval less than half as
wide as the running estimate's, 50 do not (docs/results.md)."""


@dataclass(frozen=True)
class FreshValue:
    """V on fresh episodes.

    Attributes:
        value: V now, performance.
        margin: half its 95 % interval; None: unknown, from one episode each.
        episodes: fresh episodes of each context that was played.
        contexts: how many were.
        served: (N,) performance of the policies that serve; as believed where none was played.
        best_single: place of the best single policy, by the rows that routed.
        gain: V less its own V, on the same episodes.
        gain_margin: half the 95 % interval of that; None likewise.
        share: (N,) weight that each context stands for that was played; 0 where none was.
        baselines: what V is compared with.
    """

    value: float
    margin: float | None
    episodes: int
    contexts: int
    served: Array
    best_single: int
    gain: float
    gain_margin: float | None
    share: Array
    baselines: tuple[Baseline, ...] = ()


@dataclass(frozen=True)
class Baseline:
    """What goes without a policy of the study.

    Attributes:
        name: for people.
        value: its V.
        lead: V of the study less that, on the same episodes.
        lead_margin: half the 95 % interval of the lead; None: unknown, from one episode each.
    """

    name: str
    value: float
    lead: float
    lead_margin: float | None


@dataclass(frozen=True)
class ReportPlan:
    """What is evaluated for the closing report.

    Attributes:
        route: (N,) places of the policies that serve.
        best_single: place of the best single policy.
        contexts: (n,) where both are evaluated.
        baselines: how many are played there, too.
    """

    route: Indices
    best_single: int
    contexts: Indices
    baselines: int = 0

    def __str__(self) -> str:
        n = len(self.route)
        where = "all" if len(self.contexts) == n else f"{len(self.contexts)} of the"
        return f"{self.evaluations} evaluations of a policy on a context, on {where} {n} contexts"

    @property
    def evaluations(self) -> int:
        """Of one policy on one context each."""
        own = sum(self.targets(policy).size for policy in self.policies)
        return own + self.baselines * self.contexts.size

    @property
    def policies(self) -> list[int]:
        """Places of those that are needed."""
        return sorted({*self.route[self.contexts].tolist(), self.best_single})

    def targets(self, policy: int) -> Indices:
        """Contexts on which a policy is evaluated."""
        if policy == self.best_single:
            return self.contexts
        return np.asarray(self.contexts[self.route[self.contexts] == policy])


def plan_of(state: StudyState, *, whole: bool = False) -> ReportPlan:
    """What the closing report of a study evaluates now: who serves, and the best single policy.

    Args:
        state: of the study, with a row or more.
        whole: play all contexts, however many evaluations the study itself has made.
    """
    spec = state.spec
    routing, weights = state.routing(), spec.space.weights
    every = ReportPlan(routing.route, routing.best_single, np.flatnonzero(weights))
    played = sum(int(np.isfinite(row.returns).sum()) for row in state.rows)
    allowed = min(played, max(CHEAP, int(SHARE * played)))
    if whole or every.evaluations <= allowed:
        return every
    each = 1 if len(every.policies) == 1 else 2
    rng = np.random.default_rng(derive_seed(spec.seed, Purpose.REPORT, spec.trial))
    some = drawn(chances(weights, max(allowed // each, 2)), rng)
    return ReportPlan(every.route, every.best_single, some)


def plan_to_do(
    state: StudyState, in_memory: Container[int], beside: Beside, *, whole: bool
) -> ReportPlan | None:
    """The plan, if it is not done already and every policy that it needs is at hand.

    Nor of a V that is a mean over the worst contexts: by fresh episodes the unlucky ones would be.

    Args:
        state: of the study.
        in_memory: places of the policies that are there, though not saved.
        beside: what is to be measured, and played beside them; the plan does not count that yet.
        whole: as of `plan_of`.
    """
    if not state.rows or state.spec.risk < 1.0:
        return None
    fresh, plan = state.fresh, plan_of(state, whole=whole)
    known = fresh is not None and {*beside.baselines} <= {*fresh.baselines}
    if fresh is not None and known and {*beside.metrics} <= {*fresh.units}:
        seen = _played(fresh.served)
        seen[list(fresh.lost)] = True
        if not whole or seen[plan.contexts].all():
            return None
    there = all(state.rows[place].policy or place in in_memory for place in plan.policies)
    return plan if there else None


def value_of(state: StudyState) -> float:
    """V that people are told: on fresh episodes once they were played, else the running estimate.

    -inf before the first row.
    """
    fresh = fresh_value(state)
    if fresh is not None:
        return fresh.value
    return state.routing().value.value if state.rows else -np.inf


def fresh_value(state: StudyState) -> FreshValue | None:
    """V on fresh episodes, as they were played when the study was reported; None: not measured."""
    fresh, bounds, spec = state.fresh, state.bounds(), state.spec
    if fresh is None or spec.risk < 1.0:
        return None
    weights, best = spec.space.weights, fresh.best_single
    served, alone = (bounds.normalise(r) for r in (fresh.served, fresh.alone))
    (each, lead), routing = np.zeros((2, len(weights))), state.routing()
    there, both = _played(served), _played(served - alone)
    if not both.all():  # where all were played, what a model believes of them adds nothing
        each, lead = routing.served.copy(), routing.served - routing.believed[best]
    lost = np.zeros(len(weights), dtype=bool)
    lost[list(fresh.lost)] = True
    count, drawn = int(there.sum()), int((there | lost).sum())
    chance = chances(weights, drawn)
    share = np.divide(weights, chance, out=np.zeros(len(weights)), where=chance > 0.0)

    def doubt(some: Mask, against: int | None = None) -> float:
        """Of what is believed there: no sample of the others, as those that break lie together."""
        at = np.flatnonzero(some)
        return routing.error(routing.route[at], at, share[at], against) if at.size else 0.0

    unplayed = doubt(lost)
    value, margin = estimated(each, served, weights, drawn, unplayed)
    gain_doubt = doubt((there | lost) & ~both, best)
    gain, gain_margin = estimated(lead, served - alone, weights, drawn, gain_doubt)
    each[there] = served[there].mean(axis=1)
    others = list[Baseline]()
    for name, returns in fresh.baselines.items():
        difference = served - bounds.normalise(returns)
        known = difference[there].mean(axis=1)
        usual = np.full(len(weights), known.mean())  # nothing is believed of it
        unknown = np.hypot(unplayed, share[lost].sum() * known.std())
        ahead, bar = estimated(usual, difference, weights, drawn, float(unknown))
        others.append(Baseline(name, value - ahead, ahead, bar))
    seen, episodes = np.where(there, share, 0.0), served.shape[1]
    return FreshValue(
        value, margin, episodes, count, each, best, gain, gain_margin, seen, tuple(others)
    )


# ---- a sample of the contexts --------------------------------------------------------------------


def chances(weights: Array, count: int) -> Array:
    """(N,) how probable each context is to be among `count` that are drawn: as its weight, up to 1.

    Those without weight are not drawn, and where there are no more others, all of these are.
    """
    if count >= np.count_nonzero(weights):
        return (weights > 0.0).astype(float)
    sure = np.zeros(len(weights), dtype=bool)
    while True:
        rest = np.where(sure, 0.0, weights)
        found = np.where(sure, 1.0, (count - sure.sum()) * rest / rest.sum())
        if not (found > 1.0).any():
            return np.asarray(found)
        sure |= found > 1.0


def drawn(chance: Array, rng: np.random.Generator) -> Indices:
    """(n,) contexts, each with its probability: evenly spaced marks along them in random order."""
    order = rng.permutation(len(chance))
    ends = np.cumsum(chance[order])
    marks = rng.random() + np.arange(round(ends[-1]))
    return np.sort(order[np.searchsorted(ends[:-1], marks, side="right")])


def estimated(
    believed: Array, played: Array, weights: Array, count: int | None = None, doubt: float = 0.0
) -> tuple[float, float | None]:
    """A mean over all contexts from a sample of them, and half its 95 % interval.

    The mean of what is believed, and by how much it is wrong in the sample: right whatever is
    believed, and the surer the better that is. The variance has the spread of those errors between
    contexts, the less the more of them were played (a whole one has none), and the luck of the
    episodes.

    Args:
        believed: (N,) by a model that has not seen these episodes.
        played: (N, E) single episodes; NaN where a context was not drawn.
        weights: (N,) sum 1. Contexts were drawn by `chances`.
        count: of those that were drawn; None: all of them were played.
        doubt: standard error of the mean for what is believed of those that were not.

    Returns:
        The mean and the margin; None where one episode of all contexts, or one context that was
        drawn by chance, says nothing of chance.
    """
    there = _played(played)
    chance = chances(weights, int(there.sum()) if count is None else count)[there]
    share = np.divide(weights[there], chance, out=np.zeros(len(chance)), where=chance > 0.0)
    parts = share[:, None] * (played[there] - believed[there, None])
    value = float(weights @ believed + parts.mean(axis=1).sum())
    among, several = chance < 1.0, parts.shape[1] > 1
    if among.sum() == 1 or not (several or among.any()):
        return value, None
    variance, noise, freedom = 0.0, 0.0, np.inf
    if several:
        noise, freedom = scatter_of_sum(np.sqrt(chance)[:, None] * parts)
    if among.any():
        # of one episode the luck is not known apart: the whole spread counts, which is too much
        left = 1.0 - chance[among] if several else np.ones(among.sum())
        each = parts[among].mean(axis=1)
        off = np.square(each - np.average(each, weights=left))
        variance = float(left @ off) * among.sum() / (among.sum() - 1.0)
    total, margin = variance + noise, 0.0
    if total > 0.0:
        spread = max(int(among.sum()) - 1, 1)
        together = total**2 / (variance**2 / spread + noise**2 / freedom)
        margin = student(together) * float(np.sqrt(total))
    return value, float(np.hypot(margin, SURE * doubt))


def _played(returns: Array) -> Mask:
    """(N,) which contexts were."""
    return np.asarray(np.isfinite(returns).all(axis=1))
