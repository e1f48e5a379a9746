"""Replay: the study a selector would run if the rows of a known matrix were its trainings."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import NamedTuple

from mbtl.arrays import Array
from mbtl.errors import InvalidInput
from mbtl.history import History
from mbtl.processes import threads_for
from mbtl.seeds import selection_rng
from mbtl.selectors.base import Proposal, SelectionProblem
from mbtl.selectors.contract import Selector


class Replay(NamedTuple):
    """What was trained and why, and how long the selector thought.

    Attributes:
        history: after K = `problem.budget` trainings.
        proposals: of these, in order.
        select_seconds: wall time of all proposals.
    """

    history: History
    proposals: tuple[Proposal, ...]
    select_seconds: float


def replay(
    selector: Selector,
    problem: SelectionProblem,
    row_of: Callable[[int], Array],
    *,
    seed: int = 0,
    trial: int = 0,
) -> Replay:
    """Propose, look up the row, tell; K times.

    Args:
        selector: that proposes.
        problem: with the budget K.
        row_of: source -> (N,) performance of its policy.
        seed: root seed of the selector's generators.
        trial: their trial.

    Raises:
        InvalidInput: it proposes a context more often than the problem allows, or one that is none.
    """
    history, proposals, seconds = History(n_targets=problem.n), [], 0.0
    for pick in range(problem.budget):
        rng = selection_rng(seed, trial, pick)
        start = time.perf_counter()
        with threads_for(problem.n):
            proposal = selector.propose(problem, history, rng)
        seconds += time.perf_counter() - start
        source = proposal.source
        _check(selector, problem, history, source)
        proposals.append(proposal)
        history = history.with_row(source, row_of(source))
    return Replay(history, tuple(proposals), seconds)


def _check(selector: Selector, problem: SelectionProblem, history: History, source: int) -> None:
    again = source in history.sources
    if again or source not in problem.sources:
        some = "" if problem.trainable is None else " and trainable"
        raise InvalidInput(
            f"a selector proposes contexts from 0 to {problem.n - 1} that are not yet trained"
            f"{some}, got "
            f"{source}{' again' if again else ''} from {selector.name!r} at pick "
            f"{len(history) + 1}; leave out those in history.sources"
        )
