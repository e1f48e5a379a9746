"""The summary of a study: every number that the terminal, the JSON and the pictures show.

Notation (shapes): k policies told, N contexts. V is performance: on fresh episodes once they were
played, else the running estimate (`mbtl.routing.Valuation`). What is said of one policy goes by the
same.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np

from mbtl.arrays import Array
from mbtl.contexts import Context
from mbtl.objective import value, worst_share_mean
from mbtl.study import Study
from mbtl.study.fresh import fresh_value
from mbtl.study.records import ToldRow

TENTH = 0.1
ENOUGH_GAIN = 0.01
"""Gain in V below which more policies are not worth their trouble."""
ENOUGH = 0.99
"""Share of the portfolio's gain over its best single policy that counts as all of it."""


@dataclass(frozen=True)
class PickSummary:
    """One source of the study.

    Attributes:
        number: 0-based pick; None for a policy the user already had.
        source: context index.
        context: the context.
        reason: why the selector chose it.
        status: "told", "failed: ...", "open", or "open: ..." for a policy that could not be
            evaluated.
        value: the running estimate of V after this row; None unless told.
        seconds: wall time of training and evaluation; None when unknown.
        traceback: of a failure, where it came from; empty where that is not known.
    """

    number: int | None
    source: int
    context: Context
    reason: str
    status: str
    value: float | None
    seconds: float | None
    traceback: str = ""


@dataclass(frozen=True)
class StudySummary:
    """A study in numbers.

    Attributes:
        problem: id of the CMDP.
        selector: name of the selector.
        budget: trainings K.
        n_contexts: N.
        finished: why nothing more is asked; None while something is.
        bounds: (low, high) of the returns that performance 0 and 1 mean (high, low if minimised).
        automatic_bounds: the bounds are the range of the returns told so far.
        episodes: fewest and most episodes behind an entry; None before the first row.
        evaluated: fewest and most contexts on which a policy was evaluated; None likewise.
        alike: places of policies that returned the same in every episode, a group each.
        picks: the sources in order.
        value: V now, the running estimate; None before the first row.
        value_margin: half its 95 % interval: of noise, of what was predicted, of what was sampled;
            None where all rows are of one episode, which says nothing of chance.
        measured: share of the weight whose serving policy was evaluated right there.
        fresh_value: V on fresh episodes; None where not measured.
        fresh_margin: half its 95 % interval; None where unknown.
        fresh_episodes: how many fresh episodes a context was played; None where not measured.
        fresh_contexts: how many contexts were played, drawn by chance; None likewise.
        worst_tenth: mean performance of the tenth of the contexts, by weight, served worst;
            on fresh episodes where there are any, else as believed.
        worst_context: the one served worst of all, on the same episodes.
        worst_context_value: the performance there.
        best_single: source of the best single policy.
        best_single_value: its own V.
        single_gain: V less that; both on fresh episodes where there are any.
        single_gain_margin: half its 95 % interval; None where unknown.
        policies_enough: fewest policies that reach 99 % of the way from it to V.
        serving: (N,) source whose policy serves each context.
    """

    problem: str
    selector: str
    budget: int
    n_contexts: int
    finished: str | None
    bounds: tuple[float, float]
    automatic_bounds: bool
    episodes: tuple[int, int] | None
    evaluated: tuple[int, int] | None
    alike: tuple[tuple[int, ...], ...]
    picks: tuple[PickSummary, ...]
    value: float | None
    value_margin: float | None
    measured: float | None
    fresh_value: float | None
    fresh_margin: float | None
    fresh_episodes: int | None
    fresh_contexts: int | None
    worst_tenth: float | None
    worst_context: int | None
    worst_context_value: float | None
    best_single: int | None
    best_single_value: float | None
    single_gain: float | None
    single_gain_margin: float | None
    policies_enough: int | None
    serving: tuple[int, ...]

    def to_json(self) -> dict[str, Any]:
        """JSON-able record."""
        return asdict(self)

    @property
    def told(self) -> list[PickSummary]:
        """The sources whose rows are known."""
        return [pick for pick in self.picks if pick.status == "told"]

    @property
    def verdict(self) -> str:
        """Whether one policy or more would do, in a sentence; silent where chance decides."""
        if self.value is None or self.best_single_value is None or self.single_gain is None:
            return "No policy was trained yet."
        if len(self.told) == 1:
            return "There is one policy."
        gain, margin = self.single_gain, self.single_gain_margin
        if margin is None:
            return (
                "Whether one policy would do cannot be said from one episode per context; evaluate "
                "with more."
            )
        bar = f" +- {margin:.4f}" if margin else ""
        adds = f"the others add {gain:.4f}{bar} to the {self.best_single_value:.4f} of the best one"
        if gain + margin < ENOUGH_GAIN:
            return f"One policy would do: {adds}."
        if gain - margin >= ENOUGH_GAIN:
            return (
                f"One policy would not do: {adds}. You need {self.policies_enough} policies for "
                f"{ENOUGH:.0%} of that gain."
            )
        if gain - margin > 0.0:
            return f"Several policies are better than one, if not by much: {adds}."
        return f"Whether one policy would do cannot be said yet: {adds}."


def summarise_study(study: Study) -> StudySummary:
    """Compute the summary of a study as it stands."""
    state = study.refresh()
    history, weights, space = study.history, study.space.weights, study.space
    fresh = fresh_value(study.state)
    best_and_worst = tuple(float(r) for r in study.bounds.denormalise(np.array([0.0, 1.0])))
    common: dict[str, Any] = {
        "problem": study.spec.problem,
        "selector": str(study.spec.selector["name"]),
        "budget": study.spec.budget,
        "n_contexts": space.n,
        "finished": study.stop_reason if study.is_finished else None,
        "bounds": best_and_worst,
        "automatic_bounds": study.spec.bounds is None,
        "picks": _picks(study, study.curve),
    }
    if not len(history):
        empty: dict[str, Any] = {f.name: None for f in fields(StudySummary)}
        return StudySummary(**{**empty, "alike": (), "serving": (), **common})
    routing, known = study.routing, study.routing.noise_is_known
    now = routing.value
    if fresh is None:
        best_single, served, v = routing.best_single, routing.served, now.value
        over = routing.gain
        gain, gain_margin = over.value, over.margin if known or over.error else None
    else:
        best_single, served, v = fresh.best_single, fresh.served, fresh.value
        gain, gain_margin = fresh.gain, fresh.gain_margin
    worst, evaluated = int(served.argmin()), [int(np.isfinite(row).sum()) for row in history.rows]
    counts = [row.episodes for row in state.rows]
    return StudySummary(
        **common,
        episodes=(min(counts), max(counts)),
        evaluated=(min(evaluated), max(evaluated)),
        alike=_alike(state.rows),
        value=now.value,
        value_margin=now.margin if known or now.error else None,
        measured=now.measured,
        fresh_value=None if fresh is None else fresh.value,
        fresh_margin=None if fresh is None else fresh.margin,
        fresh_episodes=None if fresh is None else fresh.episodes,
        fresh_contexts=None if fresh is None else fresh.contexts,
        worst_tenth=float(worst_share_mean(served, weights, TENTH)),
        worst_context=worst,
        worst_context_value=float(served[worst]),
        best_single=history.sources[best_single],
        best_single_value=v - gain,
        single_gain=gain,
        single_gain_margin=gain_margin,
        policies_enough=policies_enough(routing.believed, weights, risk=study.spec.risk),
        serving=tuple(history.sources[i] for i in routing.route),
    )


def _alike(rows: Sequence[ToldRow]) -> tuple[tuple[int, ...], ...]:
    """Places of policies whose episodes are the same, to the last digit, on several contexts."""
    groups: dict[bytes, list[int]] = {}
    for i, row in enumerate(rows):
        if np.isfinite(row.returns).sum() > 1:
            groups.setdefault(np.ascontiguousarray(row.each).tobytes(), []).append(i)
    return tuple(tuple(group) for group in groups.values() if len(group) > 1)


def policies_enough(
    rows: Array, weights: Array, share: float = ENOUGH, *, risk: float = 1.0
) -> int:
    """Fewest rows, added greedily, whose V reaches `share` of the way from the best single to all.

    Greedy addition is within 1 - 1/e of the best set, so a smaller set may exist.
    """
    goal_from = float(worst_share_mean(rows, weights, risk).max())
    goal = goal_from + share * (value(rows.max(axis=0), weights, risk) - goal_from)
    best = np.full(rows.shape[1], -np.inf)
    for count in range(1, len(rows) + 1):
        values = worst_share_mean(np.maximum(rows, best), weights, risk)
        best = np.maximum(best, rows[int(values.argmax())])
        if values.max() >= goal - 1e-12:
            return count
    return len(rows)


def _picks(study: Study, curve: Array) -> tuple[PickSummary, ...]:
    state, space = study.state, study.space
    reasons = {pick.number: pick.reason for pick in state.picks}
    told = [
        PickSummary(
            row.pick,
            row.source,
            space.context(row.source),
            "told by the user" if row.pick is None else reasons[row.pick],
            "told",
            float(curve[i]),
            row.seconds,
        )
        for i, row in enumerate(state.rows)
    ]
    failed = [
        PickSummary(
            f.pick,
            f.source,
            space.context(f.source),
            reasons[f.pick],
            f"failed: {f.reason}",
            value=None,
            seconds=None,
            traceback=f.traceback,
        )
        for f in state.failures
    ]
    held = []
    for n, p in state.open_picks.items():
        cause = state.deferred.get(n)
        status, trace = (
            ("open", "") if cause is None else (f"open: {cause.reason}", cause.traceback)
        )
        context = space.context(p.source)
        held.append(PickSummary(n, p.source, context, p.reason, status, None, None, trace))
    return (*told, *sorted([*failed, *held], key=lambda pick: pick.number or 0))
