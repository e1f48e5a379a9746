"""What a page is about: a study, or what the laboratory makes of a matrix; numbers only.

Notation (shapes): k policies told, N contexts, S matrix seeds.
"""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any

import numpy as np

from mbtl.arrays import Array, Indices
from mbtl.contexts import ContextSpace
from mbtl.history import History
from mbtl.report.reference import REFERENCE_NAMES, reference_curves
from mbtl.report.summary import StudySummary, performance_beside, summarise_study
from mbtl.report.text import beside_table, conclusions, fresh_episodes, paid, scale
from mbtl.routing import Routing
from mbtl.selectors import SelectionProblem
from mbtl.study import Study, Training
from mbtl.study.ask import spent

_MORE = 5
"""Units that a finished study is offered."""


@dataclass(frozen=True)
class Subject:
    """Everything that a page shows, before it is drawn.

    Attributes:
        kind: "study" or "matrix".
        name: what the page calls it.
        selector: whose picks these are.
        space: the N contexts.
        problem: what the selector knew.
        history: the k rows, performance, on the episodes that chose.
        routing: of them; None before the first row.
        values: (k,) V after each training.
        units: (k,) of training by then.
        values_of: which episodes that is of.
        picks: of the k rows in their order, then those failed or open.
        baselines: name -> (S, K) V of other methods.
        levels: name -> V without selection.
        sentences: the summary for people.
        measured: (M, N) all policies there are; None: only the rows are known.
        sources: (M,) of those.
        provenance: how all this was made.
        finished: nothing will change any more.
        headline: what comes first: V, the same as a return, and how it is known.
        beside: the policies and what needs no training, as cells, the heads first.
        served: (N,) performance of the serving policies, as the sentences have it.
        beside_served: name -> (N,) performance of what needs no training, on fresh episodes.
        fresh: V on fresh episodes, and half its 95 % interval; None where not measured.
        all_fresh: whether they were played on all contexts.
        next_steps: what to do now and its command, in that order.
        columns: what the table of contexts shows beside performance, (N,) by head; the score first.
    """

    kind: str
    name: str
    selector: str
    space: ContextSpace
    problem: SelectionProblem
    history: History
    routing: Routing | None
    values: Array
    units: Array
    values_of: str
    picks: tuple[Training, ...]
    baselines: Mapping[str, Array] = field(default_factory=dict)
    levels: Mapping[str, float] = field(default_factory=dict)
    sentences: tuple[str, ...] = ()
    measured: Array | None = None
    sources: Indices | None = None
    provenance: Mapping[str, Any] = field(default_factory=dict)
    finished: bool = True
    headline: tuple[str, ...] = ()
    beside: Sequence[Sequence[str]] = ()
    served: Array | None = None
    beside_served: Mapping[str, Array] = field(default_factory=dict)
    fresh: tuple[float, float | None] | None = None
    all_fresh: bool = False
    next_steps: tuple[tuple[str, str], ...] = ()
    columns: Mapping[str, Array] = field(default_factory=dict)

    @property
    def shown(self) -> Array:
        """(N,) performance of the serving policies: as the sentences have it, else as believed."""
        assert self.routing is not None
        return self.routing.served if self.served is None else self.served


def of_study(study: Study) -> Subject:
    """A study as it stands."""
    summary, state, space = summarise_study(study), study.state, study.space
    history = study.history
    known = bool(len(history))
    curves = reference_curves(study) if known else None
    spec = study.spec
    made = {
        "problem": spec.problem,
        "selector": dict(spec.selector),
        "seed": spec.seed,
        "trial": spec.trial,
        "budget": spec.budget if spec.in_units else spec.size,
        "mbtl": state.version,
        "created": datetime.fromtimestamp(state.created_at, UTC).isoformat(" ", "minutes"),
        "settings": dict(spec.settings),
        "policies": dict(state.equipment or {}),
    }
    return Subject(
        "study",
        spec.problem or study.name,
        summary.strategy,
        space,
        study.problem,
        history,
        study.routing if known else None,
        study.curve,
        state.units(),
        "the episodes that chose, as it was estimated after each training",
        summary.picks,
        {} if curves is None else curves.baselines,
        {
            **({} if curves is None else curves.levels),
            **{REFERENCE_NAMES.get(one.name, one.name): one.value for one in summary.baselines},
        },
        (
            *conclusions(summary, space),
            *([] if curves is None else [curves.said]),
            *scale(summary),
            *paid(summary),
        ),
        provenance=made,
        finished=study.is_finished,
        headline=_headline(summary),
        beside=beside_table(summary),
        served=np.array(summary.served) if known else None,
        beside_served={
            REFERENCE_NAMES.get(who, who): row
            for who, row in performance_beside(state.fresh, state.bounds()).items()
        },
        fresh=None if summary.fresh_value is None else (summary.fresh_value, summary.fresh_margin),
        all_fresh=summary.fresh_contexts == space.n,
        next_steps=_next_steps(study, summary),
        columns=_columns(study, summary),
    )


def _columns(study: Study, summary: StudySummary) -> dict[str, Array]:
    """Score, metrics and baselines of each context on fresh episodes."""
    fresh, (name, unit) = study.state.fresh, summary.score
    if fresh is None:
        return {}
    score = f"{name} [{unit}]" if unit else name
    own = fresh.metrics.get("policies", {})
    return {
        score: fresh.served.mean(axis=1),
        **{f"{n} [{fresh.units[n]}]" if fresh.units[n] else n: means for n, means in own.items()},
        **{
            f"{REFERENCE_NAMES.get(who, who)}: {score}": returns.mean(axis=1)
            for who, returns in fresh.baselines.items()
        },
    }


def _headline(summary: StudySummary) -> tuple[str, ...]:
    """V with its interval, the mean return that it is, and what it is measured on."""
    fresh = summary.fresh_value is not None
    v = summary.fresh_value if fresh else summary.value
    if v is None:
        return ()
    margin = summary.fresh_margin if fresh else summary.value_margin
    bar = f" +- {margin:.3f}" if margin and margin >= 5e-4 else ""
    how = "estimated from the episodes that chose"
    if fresh:
        how = f"measured on {fresh_episodes(summary)}"
    how += "; +- is half a 95 % interval" if bar else ""
    return f"V = {v:.3f}{bar}", f"{summary.returned(v)} over {summary.over}", how


def _next_steps(study: Study, summary: StudySummary) -> tuple[tuple[str, str], ...]:
    """For a study with a folder: go on, use the policies, look closer."""
    folder = study.folder
    if folder is None or not summary.told:
        return ()
    portfolio, steps = folder / "portfolio", list[tuple[str, str]]()
    if (portfolio / "portfolio.json").is_file():
        custom = (study.state.equipment or {}).get("policy_format") == "custom"
        own = ", load=your_load" if custom else ""
        context = study.space.context(study.space.n // 2)
        call = f"mbtl.load_portfolio({str(portfolio)!r}{own}).policy_for({context!r})"
        steps.append(("Serve a context", call))
    if not study.is_finished:
        steps.insert(0, ("Go on, if nothing is running", "repeat the command that began it"))
    elif summary.steps is None and summary.finished == spent(study.state):
        total = summary.budget + _MORE
        if not study.problem.abilities:  # then each context can be trained on once
            total = min(total, len(study.problem.sources))
        if total > summary.budget:
            more = f"Train {total - summary.budget} more units, {total} in all"
            steps.append((f"{more}: the command that began it, with", f"--budget {total}"))
    steps.append(("See every pick, and what failed", f"mbtl study show {shlex.quote(str(folder))}"))
    return tuple(steps)
