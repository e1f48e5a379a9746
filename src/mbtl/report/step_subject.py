"""What a page shows of a study that is paid in steps; numbers only.

Notation (shapes): N contexts, m policies that serve.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from mbtl.report.content import axes_of, served_by
from mbtl.report.step_text import PAID_FOR, found_lines
from mbtl.study.steps.pieces import Piece, pieces
from mbtl.study.steps.prices import share_of
from mbtl.study.steps.study import StepStudy
from mbtl.study.steps.summary import StepSummary, counted

KIND = "study in steps"
"""What tells its page from others."""


@dataclass(frozen=True)
class StepSubject:
    """A study that is paid in steps, as it stands.

    Attributes:
        study: for reading only.
        summary: its numbers.
        pieces: what was paid for, in order.
        name: what the page calls it.
    """

    study: StepStudy
    summary: StepSummary
    pieces: tuple[Piece, ...]
    name: str

    @property
    def finished(self) -> bool:
        """Nothing will change any more."""
        return self.summary.finished is not None

    @property
    def progress(self) -> str:
        """How far it is, in words."""
        return f"{counted(self.summary.spent)} of {counted(self.summary.budget)} steps"


def of_step_study(study: StepStudy) -> StepSubject:
    """A study as it stands."""
    summary = study.summary()
    return StepSubject(study, summary, pieces(study), study.spec.problem or study.name)


def step_content(subject: StepSubject) -> dict[str, Any]:
    """Everything that its page shows: arrays and texts, nothing that is drawn."""
    study, summary, spec = subject.study, subject.summary, subject.study.spec
    found: dict[str, Any] = {
        "kind": KIND,
        "name": subject.name,
        "selector": summary.strategy,
        "progress": subject.progress,
        "sentences": found_lines(summary),
        "axes": axes_of(study.space),
        "isGrid": study.space.shape is not None,
        "n": study.space.n,
        "sources": [],
        "finished": subject.finished,
        "budget": summary.budget,
        "bill": _bill(subject),
        "trainings": [
            {
                **asdict(one),
                "seconds": course.seconds,
                "whole": study.state.lengths_of(j)[-1] * share_of(study.state, j),
            }
            for j, (one, course) in enumerate(
                zip(summary.trainings, study.state.trainings, strict=True)
            )
        ],
        "pieces": [asdict(piece) for piece in subject.pieces],
        "fresh": {"value": summary.fresh_value, "margin": summary.fresh_margin},
        "provenance": {
            "problem": spec.problem,
            "strategy": dict(spec.strategy),
            "seed": spec.seed,
            "trial": spec.trial,
            "lengths (environment steps)": list(spec.lengths),
            "episodes of an evaluation on a target": spec.episodes,
            "mbtl": study.state.version,
            "created (seconds since 1970)": study.state.created_at,
            "settings": dict(spec.settings),
        },
    }
    return found | (_serving(study) if study.state.policies else {})


def _bill(subject: StepSubject) -> list[dict[str, Any]]:
    """What the steps were paid for, and the time of it; checks are made within trainings."""
    seconds = dict.fromkeys(PAID_FOR, 0.0)
    for piece in subject.pieces:
        seconds[piece.kind] += piece.seconds
    return [
        {"what": PAID_FOR[name], "steps": steps, "seconds": seconds[name]}
        for name, steps in subject.summary.prices.items()
        if steps
    ]


def _serving(study: StepStudy) -> dict[str, Any]:
    """The policies that serve somewhere, in the order of their trainings, and where."""
    routing, state, space = study.portfolio().routing, study.state, study.space
    used = np.unique(routing.route)
    used = used[np.argsort([state.policies[i].training for i in used], kind="stable")]
    names = []
    for i in used.tolist():
        policy = state.policies[i]
        _, mark = state.trainings[policy.training].at(policy.length)
        names.append(f"training {policy.training + 1} at {counted(mark.steps)} steps")
    sources = np.asarray(routing.sources)[used]
    place = np.full(len(state.policies), -1)
    place[used] = np.arange(len(used))
    rows = study.bounds.normalise(np.array([state.returns[i] for i in used.tolist()]))
    return {
        "sources": sources.tolist(),
        "policies": names,
        "picks": [{"context": name} for name in names],
        "rows": rows,
        "served": served_by(routing.believed[used], sources, place[routing.route], space.steps),
    }
