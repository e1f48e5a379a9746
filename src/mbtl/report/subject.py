"""What a page is about: a study, or a selector replayed on a transfer matrix; numbers only.

Notation (shapes): k policies told, N contexts, S matrix seeds.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbtl.arrays import Array
from mbtl.benchmark import (
    TransferMatrix,
    compare,
    reference,
)
from mbtl.benchmark.base import measured_curve
from mbtl.benchmark.oracle import NAMES
from mbtl.benchmark.replay import replay
from mbtl.contexts import ContextSpace
from mbtl.history import History
from mbtl.plot.matrices import shown_performance
from mbtl.report import beside
from mbtl.report.reference import reference_curves
from mbtl.report.summary import summarise_study
from mbtl.report.text import lines
from mbtl.routing import Routing
from mbtl.selectors import SelectionProblem, get_selector
from mbtl.study import Study


@dataclass(frozen=True)
class PickFacts:
    """One training, as the page shows it.

    Attributes:
        source: context index.
        reason: why the selector chose it.
        status: "told", "failed: ...", "open".
        promised: gain in V that the selector expected; None where it says none.
        seconds: wall time; None: unknown.
        cost: in the study's unit; None: unknown.
        traceback: of a failure.
    """

    source: int
    reason: str
    status: str = "told"
    promised: float | None = None
    seconds: float | None = None
    cost: float | None = None
    traceback: str = ""


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
        values_of: which episodes that is of.
        picks: of the k rows in their order, then those failed or open.
        baselines: name -> (S, K) V of other methods.
        levels: name -> V without selection.
        sentences: the summary for people.
        measured: (M, N) all policies there are; None: only the rows are known.
        sources: (M,) of those.
        provenance: how all this was made.
        finished: nothing will change any more.
    """

    kind: str
    name: str
    selector: str
    space: ContextSpace
    problem: SelectionProblem
    history: History
    routing: Routing | None
    values: Array
    values_of: str
    picks: tuple[PickFacts, ...]
    baselines: Mapping[str, Array] = field(default_factory=dict)
    levels: Mapping[str, float] = field(default_factory=dict)
    sentences: tuple[str, ...] = ()
    measured: Array | None = None
    sources: NDArray[np.intp] | None = None
    provenance: Mapping[str, Any] = field(default_factory=dict)
    finished: bool = True

    @property
    def progress(self) -> str:
        """How far it is, in words."""
        return f"{len(self.history)} told"


def of_study(study: Study) -> Subject:
    """A study as it stands."""
    summary, state, space = summarise_study(study), study.state, study.space
    history = study.history
    known = bool(len(history))
    curves = reference_curves(study) if known else None
    promised = {pick.number: pick.acquisition for pick in state.picks}
    costs = [row.cost for row in state.rows]
    picks = tuple(
        PickFacts(
            pick.source,
            pick.reason,
            pick.status,
            None if pick.number is None else promised[pick.number],
            pick.seconds,
            costs[i] if i < len(costs) else None,
            pick.traceback,
        )
        for i, pick in enumerate(summary.picks)
    )
    spec = study.spec
    made = {
        "problem": spec.problem,
        "selector": dict(spec.selector),
        "seed": spec.seed,
        "trial": spec.trial,
        "budget": spec.budget,
        "mbtl": state.version,
        "created (seconds since 1970)": state.created_at,
        "settings": dict(spec.settings),
        "policies": dict(state.equipment or {}),
    }
    return Subject(
        "study",
        spec.problem or study.name,
        summary.selector,
        space,
        study.problem,
        history,
        study.routing if known else None,
        study.curve,
        "an estimate while the study ran",
        picks,
        {} if curves is None else curves.baselines,
        {} if curves is None else curves.levels,
        (
            *lines(summary, space),
            *beside.sentences(study.folder),
            *([] if curves is None else [curves.said]),
        ),
        provenance=made,
        finished=study.is_finished,
    )


def of_matrix(
    matrix: TransferMatrix, selector: str = "auto", *, budget: int = 15, seed: int = 0
) -> Subject:
    """A selector replayed on a matrix seed, beside others and what the matrix allows."""
    problem = matrix.problem(min(budget, len(matrix.problem(1).sources)))
    rule = get_selector(selector)
    played = replay(rule, problem, lambda i: matrix.rows(seed, [i])[0], trial=seed)
    history = played.history
    picks = [PickFacts(p.source, p.reason, promised=p.acquisition) for p in played.proposals]
    known = [reference(matrix, s, problem.budget) for s in range(matrix.n_seeds)]
    baselines = {
        "Random": np.array([one.random for one in known]),
        "Sequential Oracle": np.array([one.oracle.curve for one in known]),
    }
    others = [n for n in ("greedy", "mbtl", "auto") if n != selector]
    others = [name for name in others if name != "greedy" or problem.is_line]
    runs = compare(others, [matrix], problem.budget, 1).results
    for name in others:
        baselines[name] = np.array([run.performance for run in runs if run.selector == name])
    values = measured_curve(matrix, seed, history.sources)
    level = known[seed].levels
    routing = Routing(matrix.space, history.sources, history.rows)
    served = routing.served
    worst = int(served.argmin())
    rows = {NAMES.get(n, n): v for n, v in known[seed].rows.items()}
    sentences = [
        f"{rule.name} reaches V = {values[-1]:.4f} with {len(values)} trainings on seed {seed}; "
        f"Random is expected to reach {known[seed].random[-1]:.4f}, the Sequential Oracle reaches "
        f"{known[seed].oracle.curve[-1]:.4f}.",
        f"One policy per context gives {level.independent:.4f}, all policies together "
        f"{level.oracle_transfer:.4f}, one policy of a random context {level.grand_mean:.4f}.",
        f"The worst-served context is {matrix.space.describe(matrix.space.context(worst))}, at "
        f"{served[worst]:.4f}.",
        *([f"Note: {matrix.caveat}."] if matrix.caveat else []),
    ]
    return Subject(
        "matrix",
        matrix.name,
        rule.name,
        matrix.space,
        problem,
        history,
        routing,
        values,
        "episodes that chose nothing" if matrix.measures_apart else "the episodes that chose",
        tuple(picks),
        baselines,
        {"Independent": level.independent, "Oracle Transfer": level.oracle_transfer, **rows},
        tuple(sentences),
        shown_performance(matrix, None),
        problem.sources,
        {"matrix": matrix.name, "seeds": matrix.records},
    )
