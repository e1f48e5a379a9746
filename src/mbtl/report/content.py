"""A subject as the content of a page: arrays and texts, nothing that is drawn.

Notation (shapes): k policies, N contexts.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbtl.arrays import Array
from mbtl.contexts import Categorical, ContextSpace, Log
from mbtl.plot.style import distinct
from mbtl.report.subject import Subject
from mbtl.routing import rank
from mbtl.selectors.outlook import outlook


def content(subject: Subject) -> dict[str, Any]:
    """Everything that the page of a subject shows."""
    space, history = subject.space, subject.history
    found: dict[str, Any] = {
        "kind": subject.kind,
        "name": subject.name,
        "selector": subject.selector,
        "sentences": list(subject.sentences),
        "axes": axes_of(subject.space),
        "isGrid": space.shape is not None,
        "n": space.n,
        "sources": list(history.sources),
        "trained": [pick.trained_on(space) for pick in subject.picks[: len(history)]],
        "curve": {
            "values": list(subject.values),
            "units": list(subject.units),
            "of": subject.values_of,
        },
        "baselines": {name: np.asarray(rows) for name, rows in subject.baselines.items()},
        "levels": dict(subject.levels),
        "picks": _picks(subject),
        "provenance": dict(subject.provenance),
        "finished": subject.finished,
        "rows": history.rows,
    }
    if subject.measured is not None and subject.sources is not None:
        found["matrix"] = {"values": subject.measured, "sources": np.asarray(subject.sources)}
    if (routing := subject.routing) is not None:
        sources = np.asarray(routing.sources)
        served = served_by(routing.believed, sources, routing.route, space.steps)
        found |= {"served": served, "steps": _steps(subject)}
    return found


def axes_of(space: ContextSpace) -> list[dict[str, Any]]:
    """Names, units and the place of every context on each axis."""
    out = []
    for axis in space.axes:
        values = space.values(axis.name)
        names = list(axis.choices) if isinstance(axis, Categorical) else None
        places = [names.index(v) for v in values] if names else values
        out.append(
            {
                "name": axis.name,
                "unit": axis.unit,
                "label": axis.label,
                "log": isinstance(axis, Log),
                "choices": None if names is None else [str(name) for name in names],
                "values": np.asarray(places, dtype=np.float64),
            }
        )
    return out


def _picks(subject: Subject) -> list[dict[str, Any]]:
    """What each added, beside what was promised of it."""
    values = subject.values
    gains = np.diff(values, prepend=np.nan)
    out = []
    for i, pick in enumerate(subject.picks):
        told = i < len(values)
        out.append(
            {
                "source": pick.source,
                "context": pick.trained_on(subject.space),
                "reason": pick.reason,
                "status": pick.status,
                "value": float(values[i]) if told else None,
                "gained": float(gains[i]) if told else None,
                "promised": pick.promised if i else None,
                "seconds": pick.seconds,
                "cost": pick.cost,
                "traceback": pick.traceback,
            }
        )
    return out


def served_by(
    believed: Array, sources: NDArray[np.intp], route: NDArray[np.intp], steps: Array
) -> dict[str, Any]:
    """Who serves each context, how well, and who would if not.

    Args:
        believed: (k, N) performance.
        sources: (k,) context of each policy.
        route: (N,) position of the policy that serves.
        steps: (N, D) grid steps of the contexts.
    """
    every = np.arange(believed.shape[1])
    second = np.full(len(every), -1)
    if len(sources) > 1:
        for target in every.tolist():
            distance = np.linalg.norm(steps[sources] - steps[target], axis=1)
            order = rank(believed[:, target], distance, sources)
            second[target] = next(i for i in order if i != route[target])
    return {
        "policy": route,
        "colours": distinct(len(sources)),
        "performance": believed[route, every],
        "runnerUp": second,
        "runnerUpPerformance": np.where(second >= 0, believed[second, every], np.nan),
    }


def _steps(subject: Subject) -> dict[str, Any]:
    """What the model believed after each training, and who served; (k, N) each."""
    k, n, routing = len(subject.history), subject.space.n, subject.routing
    assert routing is not None
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
