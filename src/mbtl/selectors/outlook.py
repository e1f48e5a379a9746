"""Looking at a model: what it believed after so many trainings, for pictures and reports."""

from __future__ import annotations

import numpy as np

from mbtl.errors import InvalidInput
from mbtl.history import History
from mbtl.selectors.base import Outlook, SelectionProblem, spread
from mbtl.selectors.contract import Selector
from mbtl.selectors.registry import get_selector, selector_names
from mbtl.selectors.specialists import Specialists

MOST = 200
"""Contexts of which the gain is asked where there are more, spread over all of them."""


def outlook(
    problem: SelectionProblem,
    history: History,
    selector: Selector | str = "specialists",
    *,
    after: int | None = None,
) -> Outlook | None:
    """What the model of a selector believed after so many trainings.

    A selector without a model of its own (Random, Greedy, one whose name is not known here) gets
    that of `specialists`. It has one if it has a method `outlook(problem, history, candidates)`.

    Args:
        problem: the contexts.
        history: the rows; those of specialists count, as no model knows other trainings.
        selector: whose model.
        after: number of trainings; None: all. Picks under way do not count.

    Returns:
        The outlook; None where nothing can be fitted.

    Raises:
        InvalidInput: `after` is not from 0 to the number of rows.
    """
    k = len(history) if after is None else after
    if not 0 <= k <= len(history):
        raise InvalidInput(f"after must be from 0 to the {len(history)} rows there are, got {k}")
    if not np.isfinite(history.rows[:k]).any():
        return None
    errors = None if history.errors is None else history.errors[:k]
    then = History(
        history.n_targets,
        history.sources[:k],
        history.rows[:k],
        errors=errors,
        trainings=history.trainings[:k],
    ).specialists()
    if not np.isfinite(then.rows).any():
        return None
    candidates = spread(problem, problem.sources, MOST)
    for model in (_known(selector), Specialists()):
        if model is None or not hasattr(model, "outlook"):
            continue
        try:
            found: Outlook = model.outlook(problem, then, candidates)
            return found
        except (InvalidInput, np.linalg.LinAlgError):  # nothing to fit so far
            continue
    return None


def _known(selector: Selector | str) -> Selector | None:
    """Names are of ours only: a study that somebody sent must not import a file to be looked at."""
    if isinstance(selector, str) and selector not in selector_names():
        return None
    return get_selector(selector)
