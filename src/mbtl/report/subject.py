"""What a page is about: a study, or what the laboratory makes of a matrix; numbers only.

Notation (shapes): k policies told, N contexts, S matrix seeds.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbtl.arrays import Array
from mbtl.contexts import ContextSpace
from mbtl.history import History
from mbtl.report import beside
from mbtl.report.reference import reference_curves
from mbtl.report.summary import summarise_study
from mbtl.report.text import lines
from mbtl.routing import Routing
from mbtl.selectors import SelectionProblem
from mbtl.study import Study, Training


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
    sources: NDArray[np.intp] | None = None
    provenance: Mapping[str, Any] = field(default_factory=dict)
    finished: bool = True


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
        "budget": spec.budget if spec.steps is None else f"{spec.steps} environment steps",
        "mbtl": state.version,
        "created (seconds since 1970)": state.created_at,
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
        "an estimate while the study ran",
        summary.picks,
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
