"""What the work under way is going to cost, so that several workers do not spend the same steps.

A recipe that counts episodes has marks in steps, too: those of so many of the longest episodes.
How many steps a training really had is known when it was played, and that is charged.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtl.actions import Evaluate, StartOn
from mbtl.actions.evaluation import LEAST, target_price
from mbtl.study.steps.spec import StepSpec
from mbtl.study.steps.state import StepState, UnderWay
from mbtl.trainer import Trainer

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
    like = _like(state, held)
    share = 1.0 if like is None else share_of(state, like)
    return max(state.marks_of(held)[next_mark(state, held)] * share - done, 0.0) + after


def _like(state: StepState, held: UnderWay) -> int | None:
    """The training whose episodes last as those of this piece: itself, or one on the same set."""
    if held.training is not None or not isinstance(held.work, StartOn):
        return held.training
    same = [j for j, course in enumerate(state.trainings) if course.on == held.work.sources]
    return max(same, default=None)


def share_of(state: StepState, training: int) -> float:
    """Steps that a training has had by its last mark, as a share of what that can be at most.

    Below 1 where episodes are counted and were shorter than the longest.
    """
    course, reached = state.trainings[training], state.reached(training)
    if reached < 0 or course.ended:
        return 1.0
    return min(course.steps / state.lengths_of(training)[reached], 1.0)


def whole_length(trainer: Trainer, horizon: int) -> int | None:
    """Environment steps of a whole training, at most; None: it does not say, or has one length."""
    if "length" not in trainer.takes or trainer.whole is None:
        return None
    if trainer.counts == "steps":
        return trainer.whole
    unit = int(getattr(trainer, "update_length", 1))
    return -(-trainer.whole // unit) * unit * horizon


def in_units(mark: int, trainer: Trainer, spec: StepSpec, *, on_many: bool = False) -> float:
    """A mark in units of whole trainings; one on many contexts may be longer than a whole one."""
    if trainer.whole is None:
        return mark / spec.lengths[-1]
    if trainer.counts == "steps":
        return mark / trainer.whole
    episodes = -(-mark // spec.horizon)
    return (episodes if on_many else min(episodes, trainer.whole)) / trainer.whole


def next_mark(state: StepState, held: UnderWay) -> int:
    """Where a training under way pauses next."""
    if isinstance(held.work, StartOn):
        return held.work.length  # its first mark: the learning rate falls to zero there
    return (-1 if held.training is None else state.reached(held.training)) + 1
