"""Warm starts: which training begins with whose weights, and who pays off."""

from dataclasses import replace

import line_of_nine
import numpy as np
import pytest
from line_of_nine import STEPS, N

from mbtl.actions import (
    Committee,
    Evaluate,
    Evaluation,
    FixedLength,
    Policy,
    Start,
    Stop,
    Warm,
)
from mbtl.actions.base import Trail, Training
from mbtl.actions.warm import gains_per_step, server_of

PROBLEM = replace(line_of_nine.PROBLEM, lengths_on_all=np.array([50, 100]))
RNG = np.random.default_rng(0)
WARM = Warm(selector=None, evaluation=Evaluation())


def after(trail, training, row, cost=0.0):
    """One more training with its row."""
    number = len(trail.trainings)
    made = trail.with_training(number, training, float(training.steps))
    policy = Policy(number, training.length)
    return made.with_evaluation(policy, np.arange(N), np.asarray(row, dtype=float), cost)


def followed(strategy, gains):
    """The trail of a strategy where each kind of training lifts all rows by so much more."""
    made, kinds = Trail(STEPS), []
    for _ in range(7):
        action = strategy.decide(PROBLEM, made, RNG)
        assert isinstance(action, Start)
        kinds.append(action.start is not None)
        best = float(made.filled.max()) if kinds[:-1] else 0.0
        steps = int(PROBLEM.lengths[action.length])
        lifted = np.full(N, best + gains[kinds[-1]])
        done = Training(action.source, action.length, steps, start=action.start)
        made = after(made, done, lifted)
    return made, kinds


def test_after_the_first_training_both_kinds_take_turns_then_the_better_one_goes_on():
    _, kinds = followed(WARM, {True: 0.01, False: 0.02})  # a quarter of the steps for half the gain
    assert kinds == [False, True, False, False, True, True, True]
    _, kinds = followed(WARM, {True: 0.01, False: 0.05})
    assert kinds == [False, True, False, False, True, False, False]


def test_without_turns_all_but_the_first_are_warm_and_lengths_differ():
    trail, kinds = followed(Warm(turns=0, selector=None, evaluation=Evaluation()), [0.1, 0.1])
    assert kinds == [False] + [True] * 6
    assert [t.length for t in trail.trainings[:2]] == [2, 0]
    two = replace(PROBLEM, lengths=np.array([200, 400]))  # no quarter: the shortest there is
    assert Warm(turns=0).decide(two, trail, RNG).length == 0


def test_a_start_is_the_policy_that_serves_the_context_and_of_equals_the_better_one():
    trail = after(Trail(STEPS), Training(4, 2, 400), np.linspace(0.0, 1.0, N))
    trail = after(trail, Training(0, 2, 400), np.linspace(1.0, 0.0, N))
    assert server_of(trail, 8) == Policy(0, 2)
    assert server_of(trail, 0) == Policy(1, 2)
    trail = after(trail, Training(2, 2, 400), np.ones(N))
    assert server_of(trail, 0) == Policy(2, 2)


def test_gains_are_those_of_v_per_step_of_training_and_evaluation():
    trail = after(Trail(STEPS), Training(4, 2, 400), np.full(N, 0.5))
    trail = after(trail, Training(0, 0, 100), np.full(N, 0.8), cost=50.0)
    trail = after(trail, Training(8, 0, 100), np.full(N, 0.7), cost=50.0)
    assert gains_per_step(PROBLEM, trail)[1:] == pytest.approx([0.3 / 150, 0.0])


def test_it_evaluates_first_and_ends_where_no_context_is_left():
    one = Trail(STEPS).with_training(0, Training(4, 2, 400), 400.0)
    assert isinstance(WARM.decide(PROBLEM, one, RNG), Evaluate)
    for source in range(N):
        one = after(one if source else Trail(STEPS), Training(source, 2, 400), np.ones(N))
    assert WARM.decide(PROBLEM, one, RNG) == Stop()


def test_specialists_of_a_committee_start_from_policies_of_the_whole_trail():
    both = Committee(Warm(turns=0, selector=None, evaluation=Evaluation()))
    assert both.starts_warm
    assert not Committee(FixedLength()).starts_warm
    every = tuple(range(N))
    trail = after(Trail(STEPS), Training(4, 0, 50, on=every, ended=True), np.ones(N))
    trail = after(trail, Training(4, 2, 400), np.full(N, 0.5))
    trail = after(trail, Training(4, 1, 100, on=every, ended=True), np.ones(N))
    costly = replace(PROBLEM, lengths_on_all=np.array([50, 100, 10_000]))
    action = both.decide(costly, trail, RNG)
    assert action == Start(0, 0, Policy(1, 2))
    again = after(trail, Training(0, 0, 100, start=action.start), np.full(N, 0.9))
    assert both.decide(costly, again, RNG).start == Policy(3, 0)
