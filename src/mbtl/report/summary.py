"""The summary of a study: every number that the terminal, the JSON and the pictures show.

Notation (shapes): k policies told, N contexts. V is performance: on fresh episodes once they were
played, else the running estimate (`mbtl.routing.Valuation`). What is said of one policy goes by the
same.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from mbtl.arrays import Array, Indices
from mbtl.objective import Bounds, value, worst_share_mean, worst_share_weights
from mbtl.report.reference import REFERENCE_NAMES
from mbtl.routing import Routing
from mbtl.study import Study, Training
from mbtl.study.closing_report import Baseline, fresh_value
from mbtl.study.records import FreshReturns, ToldRow

TENTH = 0.1
ENOUGH_GAIN = 0.01
"""Gain in V below which more policies are not worth their trouble."""
ENOUGH = 0.99
"""Share of the portfolio's gain over its best single policy that counts as all of it."""


@dataclass(frozen=True, kw_only=True)
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
        cost: what the trainings cost so far, where a cost is the budget; None: it is not.
        size: of the budget, in words.
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
        fresh_fewest: fewest of them that gave a return; None likewise.
        fresh_contexts: how many contexts were played, drawn by chance; None likewise.
        fresh_lost: how many more were to be played, and gave no episode that counts; None likewise.
        risk: share of the contexts, the worst of them, that V is the mean of.
        worst_tenth: mean performance of the tenth of the contexts that were played, by weight, that
            are believed to be served worst; on fresh episodes, which did not choose them, where
            there are any.
        worst_context: the one of them believed to be served worst of all.
        worst_context_value: the performance there, by the same episodes.
        best_single: place of the best single policy among those told.
        best_single_value: its own V.
        single_gain: V less that; both on fresh episodes where there are any.
        single_gain_margin: half its 95 % interval; None where unknown.
        policies_enough: places of the fewest policies that reach 99 % of the way from it to V.
        serving: (N,) place of the policy that serves each context.
        served: (N,) performance there, on fresh episodes where there are any, else as believed.
        baselines: what V is compared with, on the same fresh episodes.
        behind: contexts where a baseline did better than the policy that serves, by its mean over
            the fresh episodes, the worst first; and which one.
        score: what an episode is worth, for people: a name and its unit.
        metrics: mean over the contexts that were played, by who ("policies", or a baseline), then
            by measure.
        metric_units: of each measure.
    """

    problem: str
    strategy: str
    budget: int
    units: float
    steps: int | None
    bill: Mapping[str, float] | None
    cost: float | None
    size: str
    spent: str
    n_contexts: int
    finished: str | None
    bounds: tuple[float, float]
    automatic_bounds: bool
    episodes: tuple[int, int] | None = None
    evaluated: tuple[int, int] | None = None
    alike: tuple[tuple[int, ...], ...] = ()
    picks: tuple[Training, ...]
    value: float | None = None
    value_margin: float | None = None
    measured: float | None = None
    fresh_value: float | None = None
    fresh_margin: float | None = None
    fresh_episodes: int | None = None
    fresh_fewest: int | None = None
    fresh_contexts: int | None = None
    fresh_lost: int | None = None
    risk: float
    worst_tenth: float | None = None
    worst_context: int | None = None
    worst_context_value: float | None = None
    best_single: int | None = None
    best_single_value: float | None = None
    single_gain: float | None = None
    single_gain_margin: float | None = None
    policies_enough: tuple[int, ...] = ()
    served_by_others: int | None = None
    most_needed: str | None = None
    serving: tuple[int, ...] = ()
    served: tuple[float, ...] = ()
    baselines: tuple[Baseline, ...]
    behind: tuple[tuple[int, str], ...]
    score: tuple[str, str]
    metrics: Mapping[str, Mapping[str, float]]
    metric_units: Mapping[str, str]

    def to_json(self) -> dict[str, Any]:
        """JSON-able record."""
        picks = tuple({**asdict(pick), "status": pick.status} for pick in self.picks)
        return {**asdict(self), "picks": picks}

    @property
    def told(self) -> list[Training]:
        """Those whose rows are known."""
        return [pick for pick in self.picks if pick.place is not None]

    @property
    def over(self) -> str:
        """What V is the mean over."""
        share = "" if self.risk == 1.0 else f"worst {100 * self.risk:g}% of the "
        return f"the {share}contexts"

    def score_of(self, performance: float) -> float:
        """The score that a performance is."""
        low, high = self.bounds
        return low + performance * (high - low)

    def returned(self, performance: float) -> str:
        """What a performance is in the unit of the score, e.g. "mean delay 21.3 s/veh"."""
        name, unit = self.score
        said = f"mean {name} {self.score_of(performance):.4g}"
        return f"{said} {unit}" if unit else said

    @property
    def worth_it(self) -> str:
        """Whether training was worth it, beside the best baseline; empty where there is none."""
        if not self.baselines or self.fresh_value is None:
            return ""
        best = max(self.baselines, key=lambda one: one.value)
        margin = best.lead_margin
        bar = f" +- {margin:.4f}" if margin else ""
        scores = f"{self.returned(self.fresh_value)} instead of {self.score_of(best.value):.4g}"
        name = repr(REFERENCE_NAMES.get(best.name, best.name))
        name = f"{name} (V {best.value:.4f}), {scores}"
        if margin is None or abs(best.lead) <= margin:
            return f"Training adds nothing sure to {name}: {best.lead:+.4f}{bar}."
        if best.lead > 0.0:
            return f"Training is worth it: {best.lead:.4f}{bar} ahead of {name}."
        return f"Training is not worth it so far: {-best.lead:.4f}{bar} behind {name}."

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
        best = f"policy {(self.best_single or 0) + 1}"
        adds = (
            f"the others add {round(gain, 4) + 0.0:.4f}{bar} to the {self.best_single_value:.4f} "
            f"of {best}"
        )
        if gain + margin < ENOUGH_GAIN:
            return f"One policy is enough here: {adds}, less than {ENOUGH_GAIN:g}."
        if gain - margin >= ENOUGH_GAIN:
            few = ", ".join(str(place + 1) for place in self.policies_enough)
            return (
                f"One policy is not enough: {adds}. Others serve {self.served_by_others} of "
                f"{self.n_contexts} contexts; without them most is lost at {self.most_needed}. "
                f"For {ENOUGH:.0%} of that gain you need policies {few}."
            )
        if gain - margin > 0.0:
            return f"Several policies are better than one, if not by much: {adds}."
        return f"Whether one policy is enough cannot be said yet: {adds}."


def summarise_study(study: Study) -> StudySummary:
    """Compute the summary of a study as it stands."""
    trainings, state = study.trainings, study.state  # what is told later is not known here
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
        "cost": None if study.spec.cost_budget is None else state.cost,
        "size": study.spec.size,
        "spent": state.spent_words(),
        "n_contexts": space.n,
        "risk": study.spec.risk,
        "finished": study.stop_reason if study.is_finished else None,
        "bounds": best_and_worst,
        "automatic_bounds": study.spec.bounds is None,
        "picks": tuple(sorted(trainings, key=lambda one: (one.place is None, one.place or 0))),
        "baselines": () if fresh is None else fresh.baselines,
        "behind": _behind(state.fresh, state.bounds()),
        "score": _score_of(study),
        "metrics": _metrics(state.fresh, weights if fresh is None else fresh.share),
        "metric_units": {} if state.fresh is None else dict(state.fresh.units),
    }
    if not len(history):
        return StudySummary(**common)
    routing, known = study.routing, study.routing.noise_is_known
    now = routing.value
    if fresh is None:
        best_single, served, v = routing.best_single, routing.served, now.value
        over, share = routing.gain, weights * routing.measured
        gain, gain_margin = over.value, over.margin if known or over.error else None
    else:
        best_single, served, v = fresh.best_single, fresh.served, fresh.value
        gain, gain_margin, share = fresh.gain, fresh.gain_margin, fresh.share
    others = routing.believed.max(axis=0) - routing.believed[best_single]
    share = share if share.any() else weights
    worst = int(worst_first(routing, share)[0])
    tenth = worst_share_weights(routing.served, share / share.sum(), TENTH)
    evaluated = [int(np.isfinite(row).sum()) for row in history.rows]
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
        fresh_fewest=None if state.fresh is None else state.fresh.fewest,
        fresh_contexts=None if fresh is None else fresh.contexts,
        fresh_lost=None if state.fresh is None else len(state.fresh.lost),
        worst_tenth=float(tenth @ served),
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
        served=tuple(served.tolist()),
    )


def worst_first(routing: Routing, share: Array) -> Indices:
    """Contexts with a share, first those believed to be served worst: fresh luck chooses none."""
    order = np.argsort(routing.served, kind="stable")
    return np.asarray(order[share[order] > 0.0])


def _score_of(study: Study) -> tuple[str, str]:
    """Name and unit; a log may be a stranger's."""
    record = study.spec.settings.get("score")
    record = record if isinstance(record, Mapping) else {}
    return str(record.get("name", "return")), str(record.get("unit", ""))


def performance_beside(fresh: FreshReturns | None, bounds: Bounds) -> dict[str, Array]:
    """(N,) of each baseline on the fresh episodes, by name; NaN where none was played."""
    played = {} if fresh is None else fresh.baselines
    return {name: bounds.normalise(returns).mean(axis=1) for name, returns in played.items()}


def _behind(fresh: FreshReturns | None, bounds: Bounds) -> tuple[tuple[int, str], ...]:
    if fresh is None or not fresh.baselines:
        return ()
    beside = performance_beside(fresh, bounds)
    names, rows = list(beside), np.array([*beside.values()])
    lead = bounds.normalise(fresh.served).mean(axis=1) - np.fmax.reduce(rows)
    order = np.argsort(lead, kind="stable")  # those that were not played are last
    behind = (int(i) for i in order if lead[i] < 0.0)
    return tuple((i, names[int(np.nanargmax(rows[:, i]))]) for i in behind)


def _metrics(fresh: FreshReturns | None, share: Array) -> dict[str, dict[str, float]]:
    """Means over the contexts that were played and told a measure, by what each stands for."""
    found: dict[str, dict[str, float]] = {}
    for who, measures in ({} if fresh is None else fresh.metrics).items():
        for name, means in measures.items():
            there = np.isfinite(means)
            if share[there].sum() > 0.0:
                own = found.setdefault(who, {})
                own[name] = float(np.average(means[there], weights=share[there]))
    return found


def _alike(rows: Sequence[ToldRow]) -> tuple[tuple[int, ...], ...]:
    """Places of policies whose episodes are the same, to the last digit, on several contexts."""
    groups: dict[bytes, list[int]] = {}
    for i, row in enumerate(rows):
        if np.isfinite(row.returns).sum() > 1:
            groups.setdefault(np.ascontiguousarray(row.each).tobytes(), []).append(i)
    return tuple(tuple(group) for group in groups.values() if len(group) > 1)


def policies_enough(
    rows: Array, weights: Array, share: float = ENOUGH, *, risk: float = 1.0
) -> tuple[int, ...]:
    """Fewest rows, added greedily, whose V reaches `share` of the way from the best single to all.

    Greedy addition is within 1 - 1/e of the best set, so a smaller set may exist.
    """
    goal_from = float(worst_share_mean(rows, weights, risk).max())
    goal = goal_from + share * (value(rows.max(axis=0), weights, risk) - goal_from)
    best, chosen = np.full(rows.shape[1], -np.inf), list[int]()
    while len(chosen) < len(rows):
        values = worst_share_mean(np.maximum(rows, best), weights, risk)
        chosen.append(int(values.argmax()))
        best = np.maximum(best, rows[chosen[-1]])
        if values.max() >= goal - 1e-12:
            break
    return tuple(chosen)
