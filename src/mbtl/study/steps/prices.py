"""What the work under way is going to cost, so that several workers do not spend the same steps."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtl.actions import Evaluate, StartOn
from mbtl.actions.evaluation import LEAST, target_price
from mbtl.study.steps.state import StepState, UnderWay

if TYPE_CHECKING:
    from mbtl.study.steps.study import StepStudy


def price_of(study: StepStudy, held: UnderWay) -> float:
    """Steps that the piece of an action which is just under way costs.

    A training goes from mark to mark, and records each. So the piece is known from the log alone:
    the way to the next mark, and an evaluation on a few targets afterwards.
    """
    state, work = study.state, held.work
    price = target_price(study.spec.problem_without(()), study.trail)
    if isinstance(work, Evaluate):
        return price * len(work.targets)
    done = 0 if held.training is None else state.trainings[held.training].steps
    after = min(LEAST, study.space.n) * price
    return max(state.marks_of(held)[next_mark(state, held)] - done, 0) + after


def next_mark(state: StepState, held: UnderWay) -> int:
    """Where a training under way pauses next."""
    if isinstance(held.work, StartOn):
        return held.work.length  # its first mark: the learning rate falls to zero there
    return (-1 if held.training is None else state.reached(held.training)) + 1
