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
from mbtl.selectors.base import Exhausted, Proposal, SelectionProblem
from mbtl.selectors.contract import Selector, check_proposal


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
        InvalidInput: it proposes what breaks its contract, or nothing before all is spent.
    """
    history, proposals, seconds = History(n_targets=problem.n), [], 0.0
    for pick in range(problem.budget):
        rng = selection_rng(seed, trial, pick)
        start = time.perf_counter()
        try:
            with threads_for(problem.n):
                proposal = selector.propose(problem, history, rng)
        except Exhausted as error:
            raise InvalidInput(
                f"a comparison takes {problem.budget} picks of each selector, got none at pick "
                f"{pick + 1} from {selector.name!r}: {error}"
            ) from error
        seconds += time.perf_counter() - start
        source = checked_source(selector, problem, history, proposal)
        proposals.append(proposal)
        history = history.with_row(source, row_of(source))
    return Replay(history, tuple(proposals), seconds)


def checked_source(
    selector: Selector, problem: SelectionProblem, history: History, proposal: Proposal
) -> int:
    """What is proposed, where one may train there.

    Raises:
        InvalidInput: one may not, or the proposal breaks its contract.
    """
    check_proposal(selector, proposal, history, any_training=False)
    source = int(proposal.source)
    if source not in problem.sources:
        raise InvalidInput(
            f"a selector proposes contexts that one may train on, got {source} from "
            f"{selector.name!r}; leave out those where problem.trainable is False "
            "(mbtl.selectors.open_candidates)"
        )
    return source
