"""Where one more training is predicted to gain most, and how sure that is."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mbtl.contexts import Context, ContextSpace
from mbtl.history import History
from mbtl.selectors import Auto, Exhausted, Proposal, SelectionProblem
from mbtl.selectors.outlook import outlook
from mbtl.study import Study

ENOUGH = 0.005
"""Gain in V that counts as a gain."""
NOTHING = 5e-5
"""A gain that prints as 0."""
_INTERVAL = (0.1, 0.9)


@dataclass(frozen=True)
class NextTraining:
    """A training that is not done yet, by the model of `auto`, whatever the study's selector.

    Attributes:
        source: context index.
        context: where.
        gain: predicted mean gain in V, performance.
        low: with 80 % probability the gain is between this ...
        high: ... and this.
        chance: probability that V gains `ENOUGH` (0.005) or more.
        where: the context, for people.
    """

    source: int
    context: Context
    gain: float
    low: float
    high: float
    chance: float
    where: str

    def __str__(self) -> str:
        if self.gain <= NOTHING:
            return "One more training is predicted to add nothing to V."
        return (
            f"The most promising training is at {self.where}. It is predicted to add "
            f"{self.gain:.4f} to V; the model gives 80 % to a gain between {self.low:.4f} and "
            f"{self.high:.4f}, and {100 * self.chance:.0f} % to a gain of {ENOUGH:g} or more."
        )


def next_training(study: Study) -> NextTraining | None:
    """What one more training would bring to a study, as its report says it.

    Printed, it is that sentence. A spent budget does not matter.

    Args:
        study: with one row or more.

    Returns:
        The training; None if no context is left, or no model can be fitted.
    """
    study.refresh()
    return predicted(study.problem, study.history, study.space)


def predicted(
    problem: SelectionProblem, history: History, space: ContextSpace
) -> NextTraining | None:
    """`next_training` of what a selector knows."""
    coming = one_more(problem, history) if len(history) else None
    found = None if coming is None else outlook(problem, history, "auto")
    if coming is None or coming.acquisition is None or found is None or found.drawn is None:
        return None
    drawn = found.drawn(coming.source)
    low, high = np.quantile(drawn, _INTERVAL)
    context = space.context(coming.source)
    return NextTraining(
        coming.source,
        context,
        coming.acquisition,
        float(low),
        float(high),
        float(np.mean(drawn >= ENOUGH)),
        space.describe(context),
    )


def one_more(problem: SelectionProblem, history: History) -> Proposal | None:
    """What `auto` would train if there were budget for one more; None if no context is left."""
    try:
        asked = replace(problem, costs=None, cost_budget=None, least_gain=None)
        return Auto(cover=0).propose(asked, history, np.random.default_rng(0))
    except Exhausted:
        return None
