"""Blocks: learning and evaluations take turns, and the best weights are kept."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
import pytest

from mbtl.engine.learners.blocks import (
    Schedule,
    beginning,
    in_blocks,
    keep_better,
)
from mbtl.engine.learners.networks import Weights
from mbtl.errors import TrainingFailed


class _State(NamedTuple):
    weights: Weights


class Counter:
    """A training whose only weight is the number of updates; an evaluation says how good it is."""

    def __init__(self, returns):
        self.returns, self.calls = returns, []

    def start(self):
        weights = Weights((), (), jnp.zeros((1, 1)))
        return beginning(_State(weights))

    def learn(self, training, count):
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


def test_the_best_is_that_of_the_best_evaluation_the_earliest_of_equals():
    one, told = Counter({4: 1.0, 8: 3.0, 12: 2.0, 16: 3.0, 40: 2.0}), []
    schedule = Schedule(total=40, every=4, unit=100)
    ended = in_blocks(schedule, one.start(), *one.both(), lambda block: told.append(block.steps))
    assert one.calls == [steps // 100 for steps in told] == list(range(4, 41, 4))
    assert number(ended.best) == 8.0
    assert number(ended.state.weights) == 40.0


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
