"""The summary of a study: every number that the terminal, the JSON and the pictures show.

Notation (shapes): k policies told, N contexts. V is performance: on fresh episodes once they were
played, else the running estimate (`mbtl.routing.Valuation`). What is said of one policy goes by the
same.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np

from mbtl.arrays import Array
from mbtl.contexts import Context, ContextSpace
from mbtl.objective import value, worst_share_mean
from mbtl.study import Study
from mbtl.study.closing_report import fresh_value
from mbtl.study.records import PickRecord, ToldRow

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
        source: context index; of several, the one in their middle.
        context: that context.
        reason: why the strategy chose it.
        status: "told", "evaluated" for a policy that was evaluated further, "failed: ...", "open",
            or "open: ..." for a policy that could not be evaluated.
        value: the running estimate of V after this row; None unless told.
        seconds: wall time of training and evaluation; None when unknown.
        sources: indices of all contexts trained on.
        length: units of the training in all.
        how: from what and how long, e.g. "1 to 2 units", "tuned from training 1"; empty for a
            whole training from scratch.
        traceback: of a failure, where it came from; empty where that is not known.
    """

    number: int | None
    source: int
    context: Context
    reason: str
    status: str
    value: float | None
    seconds: float | None
    sources: tuple[int, ...] = ()
    length: float = 1.0
    how: str = ""
    traceback: str = ""

    def trained_on(self, space: ContextSpace, between: str = ", ") -> str:
        """What it is, for people, with `between` between its parts; as `StudyState.said`."""
        where = space.describe_set(self.sources, between)
        return f"{where}{between}{self.how}" if self.how else where


@dataclass(frozen=True)
class StudySummary:
    """A study in numbers.

    Attributes:
        problem: id of the CMDP.
        strategy: its name.
        budget: trainings K, in units.
        units: of them that were asked for.
        steps: environment steps that the study may spend; None: they are not counted.
        bill: environment steps spent, by what on, and expected of what is under way (`Bill`); None
            likewise.
        spent: how much of the budget is asked for, in words.
        n_contexts: N.
        finished: why nothing more is asked; None while something is.
        bounds: (low, high) of the returns that performance 0 and 1 mean (high, low if minimised).
        automatic_bounds: the bounds are the range of the returns told so far.
        episodes: fewest and most episodes behind an entry; None before the first row.
        evaluated: fewest and most contexts on which a policy was evaluated; None likewise.
        alike: places of policies that returned the same in every episode, a group each.
        picks: those told in their order, then the others.
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
        best_single: place of the best single policy among those told.
        best_single_value: its own V.
        single_gain: V less that; both on fresh episodes where there are any.
        single_gain_margin: half its 95 % interval; None where unknown.
        policies_enough: fewest policies that reach 99 % of the way from it to V.
        serving: (N,) place of the policy that serves each context.
    """

    problem: str
    strategy: str
    budget: int
    units: float
    steps: int | None
    bill: Mapping[str, float] | None
    spent: str
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
    served_by_others: int | None
    most_needed: str | None
    serving: tuple[int, ...]

    def to_json(self) -> dict[str, Any]:
        """JSON-able record."""
        return asdict(self)

    @property
    def told(self) -> list[PickSummary]:
        """Those whose rows are known."""
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
                "Whether one policy is enough cannot be said from one episode per context; "
                "evaluate with more."
            )
        bar = f" +- {margin:.4f}" if margin else ""
        adds = f"the others add {round(gain, 4) + 0.0:.4f}{bar} to the {self.best_single_value:.4f} of the best one"
        if gain + margin < ENOUGH_GAIN:
            return f"One policy is enough here: {adds}."
        if gain - margin >= ENOUGH_GAIN:
            return (
                f"One policy is not enough: {adds}. Others serve {self.served_by_others} of "
                f"{self.n_contexts} contexts, and are missed most at {self.most_needed}. You need "
                f"{self.policies_enough} policies for {ENOUGH:.0%} of that gain."
            )
        if gain - margin > 0.0:
            return f"Several policies are better than one, if not by much: {adds}."
        return f"Whether one policy is enough cannot be said yet: {adds}."


def summarise_study(study: Study) -> StudySummary:
    """Compute the summary of a study as it stands."""
    state = study.refresh()
    history, weights, space = study.history, study.space.weights, study.space
    fresh = fresh_value(study.state)
    best_and_worst = tuple(float(r) for r in study.bounds.denormalise(np.array([0.0, 1.0])))
    common: dict[str, Any] = {
        "problem": study.spec.problem,
        "strategy": str(study.spec.selector["name"]),
        "budget": study.spec.budget,
        "units": state.paid,
        "steps": study.spec.steps,
        "bill": None if study.spec.steps is None else asdict(state.bill()),
        "spent": state.spent_words(),
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
    others = routing.believed.max(axis=0) - routing.believed[best_single]
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
        best_single=int(best_single),
        best_single_value=v - gain,
        single_gain=gain,
        single_gain_margin=gain_margin,
        policies_enough=policies_enough(routing.believed, weights, risk=study.spec.risk),
        served_by_others=int((routing.route != best_single).sum()),
        most_needed=space.describe(space.context(int(others.argmax()))),
        serving=tuple(routing.route.tolist()),
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

    def line(one: PickRecord | ToldRow, status: str, **more: Any) -> PickSummary:
        number = one.pick if isinstance(one, ToldRow) else one.number
        return PickSummary(
            number,
            one.source,
            space.context(one.source),
            "told by the user" if number is None else state.picks[number].reason,
            status,
            more.get("value"),
            more.get("seconds"),
            one.sources,
            one.length,
            state.how(one),
            more.get("traceback", ""),
        )

    told = [
        line(row, "told", value=float(curve[i]), seconds=row.seconds)
        for i, row in enumerate(state.rows)
    ]
    failed = {failure.pick: failure for failure in state.failures}
    answered = {row.pick for row in state.rows} | set(state.open_picks)
    others = []
    for pick in state.picks:
        if pick.number in state.open_picks:
            cause = state.deferred.get(pick.number)
            status, trace = "open", ""
            if cause is not None:
                status, trace = f"open: {cause.reason}", cause.traceback
            others.append(line(pick, status, traceback=trace))
        elif pick.number in failed:
            cause = failed[pick.number]
            others.append(line(pick, f"failed: {cause.reason}", traceback=cause.traceback))
        elif pick.number not in answered:
            others.append(line(pick, "evaluated"))
    return (*told, *others)
