"""Strategies: what each decides, on trails made by hand."""

import numpy as np
import pytest
from line_of_nine import PROBLEM, STEPS, N

from mbtl.zoo.actions import (
    Evaluate,
    Evaluation,
    Extend,
    FixedLength,
    Halving,
    Pilot,
    Policy,
    Start,
    Stop,
)
from mbtl.zoo.actions.base import Trail, Training, filled_rows

RNG = np.random.default_rng(0)


def trail(*policies, lengths=None, ended=()):
    """One training per (source, level): a row that falls by 0.1 per step from its level."""
    made = Trail(STEPS)
    for i, (source, level) in enumerate(policies):
        length = 0 if lengths is None else lengths[i]
        made = made.with_training(i, Training(source, length, 100, i in ended), 100.0)
        row = level - 0.1 * np.abs(np.arange(N) - source)
        made = made.with_evaluation(Policy(i, length), np.arange(N), row, 90.0)
    return made


def test_a_row_seen_in_part_is_a_line_between_what_was_seen():
    rows = np.full((2, 5), np.nan)
    rows[0, [1, 3]] = [0.0, 1.0]
    rows[1] = 2.0
    filled = filled_rows(rows, np.arange(5.0)[:, None])
    assert filled[0].tolist() == [0.0, 0.0, 0.5, 1.0, 1.0]
    assert filled[1].tolist() == [2.0] * 5
    assert np.isnan(rows[0, 0])
    rng = np.random.default_rng(0)
    line = np.cumsum(rng.uniform(0.1, 1.0, 30))
    some = np.where(rng.uniform(size=(8, 30)) < 0.7, np.nan, rng.uniform(size=(8, 30)))
    for row, whole in zip(some, filled_rows(some, line[:, None]), strict=True):
        known = np.isfinite(row)
        assert np.allclose(whole, np.interp(line, line[known], row[known]))


def test_fixed_length_trains_evaluates_and_halves_the_largest_stretch():
    strategy = FixedLength(length=1, evaluation=Evaluation(3))
    assert strategy.decide(PROBLEM, Trail(STEPS), RNG) == Start(4, 1)
    begun = Trail(STEPS).with_training(0, Training(4, 1, 200), 200.0)
    assert strategy.decide(PROBLEM, begun, RNG) == Evaluate(Policy(0, 1), (0, 4, 8))
    assert strategy.decide(PROBLEM, trail((4, 0.5)), RNG) == Start(0, 1)
    assert strategy.decide(PROBLEM, trail((4, 0.5), (0, 0.5)), RNG) == Start(8, 1)


def test_fixed_length_asks_a_selector_and_stops_when_all_is_trained():
    strategy = FixedLength("mbtl")
    assert strategy.decide(PROBLEM, Trail(STEPS), RNG) == Start(4, 2)
    assert strategy.decide(PROBLEM, trail((4, 0.5)), RNG) == Start(0, 2)  # the worst context
    assert strategy.decide(PROBLEM, trail(*((s, 0.5) for s in range(N))), RNG) == Stop()


def test_halving_promotes_the_best_half_of_a_rung_the_highest_first():
    strategy = Halving("own", every=1)
    assert strategy.decide(PROBLEM, trail((4, 0.5), (0, 0.7)), RNG) == Extend(1, 1)
    there = trail((4, 0.5), (0, 0.7), (8, 0.6), (2, 0.4), lengths=(1, 1, 0, 0))
    assert strategy.decide(PROBLEM, there, RNG) == Extend(1, 2)
    assert Halving("own", every=1, first=-2).decide(PROBLEM, Trail(STEPS), RNG).length == 1
    done = trail((4, 0.5), (0, 0.7), lengths=(0, 1), ended=(1,))
    assert isinstance(strategy.decide(PROBLEM, done, RNG), Start)


def test_halving_by_gain_promotes_what_v_would_miss():
    policies = (4, 0.9), (3, 0.9), (0, 0.7), (5, 0.85)
    assert Halving("mean", every=2).decide(PROBLEM, trail(*policies), RNG) == Extend(0, 2)
    assert Halving("gain", every=2).decide(PROBLEM, trail(*policies), RNG) != Extend(0, 2)


@pytest.mark.parametrize("family", ["cartpole", "pendulum"])
def test_strategies_hold_out_the_family_they_are_judged_on(family):
    from mbtl.models.priors import prior_without

    held = FixedLength("auto").without(family)
    assert held.selector.prior == prior_without(family)
    assert FixedLength().without(family).selector is None


def test_as_many_targets_as_a_share_of_the_training_pays_for():
    plan = Evaluation(share=0.5)
    begun = Trail(STEPS).with_training(0, Training(4, 2, 120), 120.0)
    assert len(plan.next(PROBLEM, begun).targets) == 6  # 60 steps, 10 each
    short = Trail(STEPS).with_training(0, Training(4, 0, 1), 1.0)
    assert len(plan.next(PROBLEM, short).targets) == 5


def test_stretches_where_the_route_is_open_are_halved_until_it_is_clear():
    plan = Evaluation(3, margin=0.0)
    there = trail((4, 0.5)).with_training(1, Training(0, 0, 100), 100.0)
    assert plan.next(PROBLEM, there) == Evaluate(Policy(1, 0), (0, 4, 8))
    row = 0.6 - 0.1 * np.arange(N)  # better than the other up to context 2
    seen = there.with_evaluation(Policy(1, 0), np.array([0, 4, 8]), row[[0, 4, 8]], 30.0)
    assert plan.next(PROBLEM, seen) == Evaluate(Policy(1, 0), (2,))
    seen = seen.with_evaluation(Policy(1, 0), np.array([2]), row[[2]], 10.0)
    assert plan.next(PROBLEM, seen) == Evaluate(Policy(1, 0), (1, 3))
    seen = seen.with_evaluation(Policy(1, 0), np.array([1, 3]), row[[1, 3]], 20.0)
    assert plan.next(PROBLEM, seen) is None


def test_a_policy_that_is_nowhere_best_or_ties_everywhere_is_evaluated_no_further():
    plan = Evaluation(3, margin=0.0)
    for level in (0.2, 0.5):
        there = trail((4, 0.5)).with_training(1, Training(4, 1, 100), 100.0)
        row = level - 0.1 * np.abs(np.arange(N) - 4) - (0.0 if level < 0.5 else 1e-9)
        seen = there.with_evaluation(Policy(1, 1), np.array([0, 4, 8]), row[[0, 4, 8]], 30.0)
        assert plan.next(PROBLEM, seen) is None


def watched(*levels, ended=False):
    """A pilot on context 4 that went to its end, evaluated at these marks."""
    there = Trail(STEPS).with_training(0, Training(4, 2, 150 if ended else 400, ended), 400.0)
    for mark, level in levels:
        there = there.with_evaluation(Policy(0, mark), np.arange(N), np.full(N, level), 90.0)
    return there


def test_the_pilot_goes_to_its_end_and_is_evaluated_from_there_backwards():
    pilot = Pilot(enough=0.8, evaluation=Evaluation())
    everywhere = tuple(range(N))
    assert pilot.decide(PROBLEM, Trail(STEPS), RNG) == Start(4, 2)
    assert pilot.decide(PROBLEM, watched(), RNG) == Evaluate(Policy(0, 2), everywhere)
    assert pilot.decide(PROBLEM, watched((2, 0.9)), RNG) == Evaluate(Policy(0, 0), everywhere)
    there = watched((2, 0.9), (0, 0.1))
    assert pilot.decide(PROBLEM, there, RNG) == Evaluate(Policy(0, 1), everywhere)


def test_others_go_as_far_as_the_pilot_needed():
    pilot = Pilot(enough=0.8, evaluation=Evaluation())
    assert pilot.decide(PROBLEM, watched((2, 0.9), (0, 0.1), (1, 0.8)), RNG) == Start(0, 1)
    assert pilot.decide(PROBLEM, watched((2, 0.9), (0, 0.1), (1, 0.5)), RNG) == Start(0, 2)
    # ended between the first and the second mark: what came later is the same policy
    assert pilot.decide(PROBLEM, watched((2, 0.9), (0, 0.1), ended=True), RNG) == Start(0, 2)


def test_one_of_two_short_trainings_goes_on_the_one_that_v_would_miss_most():
    there = watched((2, 0.3), (0, 0.1), (1, 0.3))
    for i, (source, level) in enumerate(((0, 0.5), (8, 0.9)), start=1):
        there = there.with_training(i, Training(source, 1, 200), 200.0)
        row = level - 0.1 * np.abs(np.arange(N) - source)
        there = there.with_evaluation(Policy(i, 1), np.arange(N), row, 90.0)
    assert Pilot(promote=2, evaluation=Evaluation()).decide(PROBLEM, there, RNG) == Extend(2, 2)
    assert isinstance(Pilot(promote=0, evaluation=Evaluation()).decide(PROBLEM, there, RNG), Start)


def test_a_cohort_is_promoted_only_when_all_of_it_is_there():
    waiting = Halving("own", every=1, cohort=4)
    policies = (4, 0.5), (0, 0.7), (8, 0.6), (2, 0.4)
    assert isinstance(waiting.decide(PROBLEM, trail(*policies[:3]), RNG), Start)
    assert waiting.decide(PROBLEM, trail(*policies), RNG) == Extend(1, 1)
    there = trail(*policies).with_training(1, Training(0, 1, 200), 100.0)
    there = there.with_evaluation(Policy(1, 1), np.arange(N), np.full(N, 0.7), 90.0)
    assert waiting.decide(PROBLEM, there, RNG) == Extend(2, 1)  # the other of the best half
    another = trail(*policies, (6, 0.9), lengths=(2, 2, 2, 2, 0))
    assert isinstance(Halving("own", 1, cohort=2).decide(PROBLEM, another, RNG), Start)


def test_brackets_get_as_many_steps_each():
    strategy = Halving("own", every=1, brackets=2)
    assert strategy.decide(PROBLEM, Trail(STEPS), RNG).length == 0
    assert strategy.decide(PROBLEM, trail((4, 0.5)), RNG).length == 1
    there = trail((4, 0.5)).with_training(1, Training(0, 1, 200), 200.0)
    there = there.with_evaluation(Policy(1, 1), np.arange(N), np.full(N, 0.3), 90.0)
    assert strategy.decide(PROBLEM, there, RNG).length == 0


def test_rows_filled_one_after_the_other_are_those_filled_at_once():
    there = watched((2, 0.9))
    for target, value in ((1, 0.2), (7, 0.6), (4, 0.1)):
        there = there.with_evaluation(Policy(0, 0), np.array([target]), np.array([value]), 10.0)
    there = there.with_training(1, Training(0, 0, 100), 100.0)
    assert np.array_equal(there.filled, filled_rows(there.rows, STEPS))
