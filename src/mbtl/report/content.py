"""A subject as the content of a page: arrays and texts, nothing that is drawn.

Notation (shapes): k policies, N contexts.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mbtl.arrays import Array
from mbtl.contexts import Categorical, ContextSpace, Log
from mbtl.history import History
from mbtl.plot.style import distinct, positions
from mbtl.report.subject import Subject
from mbtl.routing import Routing, last_route
from mbtl.selectors.outlook import outlook


def content(subject: Subject) -> dict[str, Any]:
    """Everything that the pictures of a subject show."""
    space, history = subject.space, subject.history
    told = subject.picks[: len(history)]
    found: dict[str, Any] = {
        "kind": subject.kind,
        "selector": subject.selector,
        "axes": axes_of(subject.space),
        "isGrid": space.shape is not None,
        "n": space.n,
        "sources": list(history.sources),
        "kinds": [kind_of(history, row) for row in range(len(history))],
        "trained": [pick.trained_on(space) for pick in told],
        "reasons": [pick.reason for pick in told],
        "curve": {"values": list(subject.values), "units": list(subject.units)},
        "baselines": {name: np.asarray(rows) for name, rows in subject.baselines.items()},
        "levels": dict(subject.levels),
        "fresh": subject.fresh,
        "beside": dict(subject.beside_served),
        "rows": history.rows,
        "columns": dict(subject.columns),
    }
    if subject.measured is not None and subject.sources is not None:
        found["matrix"] = {"values": subject.measured, "sources": np.asarray(subject.sources)}
    if (routing := subject.routing) is not None:
        found |= {"served": served_by(routing, subject.shown), "steps": _steps(subject)}
    return found


def kind_of(history: History, row: int) -> str:
    """Whether the policy of a row is of several contexts, a tuned copy, or a specialist."""
    made = history.made(row)
    if len(made.contexts) > 1:
        return "several"
    if made.start is None:
        return "specialist"
    return kind_of(history, made.start) if made.goes_on else "tuned"


def axes_of(space: ContextSpace) -> list[dict[str, Any]]:
    """Names, units and the place of every context on each axis."""
    out = []
    for axis in space.axes:
        choices = axis.choices if isinstance(axis, Categorical) else None
        out.append(
            {
                "name": axis.name,
                "unit": axis.unit,
                "label": axis.label,
                "log": isinstance(axis, Log),
                "choices": None if choices is None else list(map(str, choices)),
                "values": positions(axis, space.values(axis.name)),
            }
        )
    return out


def served_by(routing: Routing, performance: Array) -> dict[str, Any]:
    """Who serves each context, how well, and who would if not."""
    believed, route, steps = routing.believed, routing.route, routing.space.steps
    sources, every = routing.sources, np.arange(routing.space.n)
    second = np.full(len(every), -1)
    if len(sources) > 1:
        others = believed.copy()
        others[route, every] = -np.inf
        second = last_route(others, sources, steps)
    return {
        "policy": route,
        "colours": distinct(len(sources)),
        "performance": performance,
        "runnerUp": second,
        "runnerUpPerformance": np.where(second >= 0, believed[second, every], np.nan),
    }


def _steps(subject: Subject) -> dict[str, Any]:
    """What the model believed after each training, and who served; (k, N) each."""
    k, n = len(subject.history), subject.space.n
    means, stds, gains = (np.full((k, n), np.nan) for _ in range(3))
    model = subject.selector
    for j in range(1, k + 1):
        found = outlook(subject.problem, subject.history, subject.selector, after=j)
        if found is not None:
            means[j - 1], stds[j - 1], gains[j - 1] = found.mean, found.std, found.gain
            model = found.model
        alone = [subject.history.made(i) for i in range(j)]
        taken = [one.contexts[0] for one in alone if one.is_specialist]
        gains[j - 1, taken] = np.nan  # not proposed again
    served = np.fmax.accumulate(subject.history.rows, axis=0)
    return {"model": model, "mean": means, "std": stds, "gain": gains, "served": served}
