"""Blocks: evaluations and marks take turns, and marks change nothing but what is kept."""

from fractions import Fraction
from typing import NamedTuple

import numpy as np
import pytest

pytest.importorskip("jax", reason="the jax extra is not installed")

import jax
import jax.numpy as jnp

from mbtl.engine.checkpoints import Checkpoint
from mbtl.engine.learners.blocks import (
    Schedule,
    beginning,
    from_arrays,
    in_blocks,
    keep_better,
    to_arrays,
    weights_of,
)
from mbtl.engine.learners.networks import Weights
from mbtl.errors import InvalidInput, TrainingFailed


class _State(NamedTuple):
    weights: Weights


MARKS = [Fraction(1, 8), Fraction(1, 4), Fraction(1, 2)]


class Counter:
    """A training whose only weight is the number of updates; an evaluation says how good it is."""

    def __init__(self, returns):
        self.returns, self.calls = returns, []

    def start(self, marks=0):
        weights = Weights((), (), jnp.zeros((1, 1)))
        return beginning(_State(weights), marks)

    def learn(self, training, count):
        assert training.along is None  # compiled programs never see it
        now = int(training.updates) + count
        self.calls.append(now)
        weights = Weights((), (), jnp.full((1, 1), float(now) if now < 90 else np.nan))
        return training._replace(state=_State(weights), updates=jnp.int32(now))

    def judge(self, training):
        found = float(self.returns.get(int(training.updates), 0.0))
        return keep_better(training, jnp.array([found]))

    def both(self):
        return self.learn, self.judge


def number(weights):
    return float(weights.log_std[0, 0])


def test_marks_between_evaluations_keep_weights_and_are_not_judged():
    returns = {4: 1.0, 5: 9.0, 8: 3.0, 10: 9.0, 12: 2.0, 40: 2.0}  # 5 and 10 are marks only
    with_marks, without = Counter(returns), Counter(returns)
    schedule = Schedule(total=40, every=4, unit=100, marks=tuple(MARKS))
    told = []
    marked = in_blocks(
        schedule, with_marks.start(3), *with_marks.both(), lambda block: told.append(block.steps)
    )
    plain = in_blocks(schedule._replace(marks=()), without.start(), *without.both())

    assert with_marks.calls == [4, 5, 8, 10, 12, 16, 20, 24, 28, 32, 36, 40]
    assert without.calls == told_updates(told) == list(range(4, 41, 4))
    assert number(marked.best) == number(plain.best) == 8.0
    assert number(marked.state.weights) == 40.0

    def kept(name):
        return number(weights_of(marked, Checkpoint.named(name), MARKS))

    assert [kept(f"last@{share}") for share in MARKS] == [5.0, 10.0, 20.0]
    assert [kept(f"best@{share}") for share in MARKS] == [4.0, 8.0, 8.0]
    assert (kept("best"), kept("final"), kept("last@1")) == (8.0, 40.0, 40.0)


def told_updates(told):
    return [steps // 100 for steps in told]


def test_before_the_first_evaluation_the_best_is_the_latest():
    one = Counter({})
    training = in_blocks(
        Schedule(40, 20, 1, (Fraction(1, 8), Fraction(1, 2))), one.start(2), *one.both()
    )
    early = weights_of(training, Checkpoint.named("best@1/8"), [Fraction(1, 8), Fraction(1, 2)])
    assert number(early) == 5.0


def test_weights_at_an_early_end_stand_for_all_marks_to_come():
    one = Counter({8: 1.0})
    training = in_blocks(
        Schedule(40, 4, 1, tuple(MARKS)),
        one.start(3),
        *one.both(),
        nothing_to_gain=lambda training: float(training.best_return[0]) >= 1.0,
    )
    assert one.calls == [4, 5, 8]
    for share, expected in zip(MARKS, (5.0, 8.0, 8.0), strict=True):
        assert number(weights_of(training, Checkpoint("last", share), MARKS)) == expected


def test_a_training_goes_on_from_its_arrays_with_its_marks():
    whole, first, second = Counter({8: 2.0, 16: 3.0}), Counter({8: 2.0}), Counter({16: 3.0})
    schedule = Schedule(40, 4, 1, tuple(MARKS))
    expected = in_blocks(schedule, whole.start(3), *whole.both())

    class Stopped(Exception):
        pass

    saved = {}

    def stop(block):
        saved.update(to_arrays(block.training))
        if block.steps == 12:
            raise Stopped

    with pytest.raises(Stopped):
        in_blocks(schedule, first.start(3), *first.both(), stop)
    resumed = in_blocks(schedule, from_arrays(second.start(3), saved), *second.both())
    for a, b in zip(jax.tree.leaves(expected), jax.tree.leaves(resumed), strict=True):
        assert np.array_equal(a, b)


def test_whoever_goes_on_from_the_end_is_told_once():
    one, told = Counter({}), []
    ended = in_blocks(Schedule(4, 4, 10), one.start(), *one.both())
    in_blocks(Schedule(4, 4, 10), ended, *one.both(), lambda block: told.append(block.steps))
    assert told == [40]
    assert one.calls == [4]


def test_lost_weights_are_an_error_that_says_when():
    one = Counter({})
    with pytest.raises(TrainingFailed, match="NaN or infinity by step 1000 in policies 0"):
        in_blocks(Schedule(200, 100, 10), one.start(), *one.both())


@pytest.mark.parametrize("mark", [Fraction(0), Fraction(3, 2)])
def test_a_mark_is_a_share(mark):
    with pytest.raises(InvalidInput, match="marks are shares of a training"):
        Schedule.of(1000, 10, marks=[mark])
