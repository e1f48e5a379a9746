"""What strategies decide while others are at what they decided before."""

from dataclasses import replace

import numpy as np
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
    Wait,
)
from mbtl.zoo.actions.base import Trail, Training

RNG = np.random.default_rng(0)


def trail(*policies, under_way=()):
    """One training at the first mark per (source, level), evaluated everywhere."""
    made = Trail(STEPS)
    for i, (source, level) in enumerate(policies):
        made = made.with_training(i, Training(source, 0, 100), 100.0)
        row = level - 0.1 * np.abs(np.arange(N) - source)
        made = made.with_evaluation(Policy(i, 0), np.arange(N), row, 90.0)
    return replace(made, under_way=tuple(under_way))


def test_what_others_evaluate_or_go_on_with_is_left_to_them():
    one = trail((4, 0.5)).with_training(1, Training(0, 0, 100), 100.0)
    assert one.unevaluated == Policy(1, 0)
    assert replace(one, under_way=(Evaluate(Policy(1, 0), (0, 1)),)).unevaluated is None
    assert replace(one, under_way=(Extend(1, 2),)).unevaluated is None
    running = one.with_training(2, Training(8, -1, 50), 50.0)  # on its way, past no last mark
    assert running.busy == {2}
    assert running.unevaluated == Policy(1, 0)


def test_a_context_that_others_train_on_is_begun():
    fixed = FixedLength(evaluation=Evaluation(3))
    assert fixed.decide(PROBLEM, Trail(STEPS), RNG) == Start(4, 2)
    first = Trail(STEPS, under_way=(Start(4, 2),))
    second = fixed.decide(PROBLEM, first, RNG)
    assert second == Start(0, 2)
    third = fixed.decide(PROBLEM, replace(first, under_way=(Start(4, 2), second)), RNG)
    assert third == Start(8, 2)
    ruled = FixedLength("mbtl", evaluation=Evaluation(3)).decide(PROBLEM, first, RNG)
    assert ruled.source != 4


def test_the_pilot_is_waited_for():
    pilot = Pilot(evaluation=Evaluation(3))
    assert pilot.decide(PROBLEM, Trail(STEPS, under_way=(Start(4, 2),)), RNG) == Wait()
    done = Trail(STEPS).with_training(0, Training(4, 2, 400), 400.0)
    looked = replace(done, under_way=(Evaluate(Policy(0, 2), (0, 4, 8)),))
    assert pilot.decide(PROBLEM, looked, RNG) == Wait()


def test_one_of_two_goes_on_once_though_two_workers_ask():
    pilot = Pilot(enough=0.0, promote=2, evaluation=Evaluation())
    made = Trail(STEPS).with_training(0, Training(4, 2, 400), 400.0)
    for length in (2, 0, 1):
        row = 0.2 + 0.05 * length - 0.1 * np.abs(np.arange(N) - 4)
        made = made.with_evaluation(Policy(0, length), np.arange(N), row, 90.0)
    for number, source in ((1, 0), (2, 8)):
        made = made.with_training(number, Training(source, 1, 200), 200.0)
        row = 0.5 + 0.1 * number - 0.1 * np.abs(np.arange(N) - source)
        made = made.with_evaluation(Policy(number, 1), np.arange(N), row, 90.0)
    first = pilot.decide(PROBLEM, made, RNG)
    assert first == Extend(2, 2)
    again = pilot.decide(PROBLEM, replace(made, under_way=(first,)), RNG)
    assert isinstance(again, Start)


def test_halving_promotes_the_next_best_and_counts_those_without_a_row():
    asha = Halving("own", 1, None, evaluation=Evaluation())
    there = trail((0, 0.5), (4, 0.9), (8, 0.7), (2, 0.1))
    assert asha.decide(PROBLEM, there, RNG) == Extend(1, 1)
    busy = replace(there, under_way=(Extend(1, 1),))
    assert asha.decide(PROBLEM, busy, RNG) == Extend(2, 1)
    both = replace(there, under_way=(Extend(1, 1), Extend(2, 1)))
    running = both.with_training(4, Training(6, -1, 50), 50.0)
    assert isinstance(asha.decide(PROBLEM, running, RNG), Start)


def test_a_policy_is_evaluated_further_only_beside_those_before_it():
    """So of two that are evaluated at the same time only the later one looks closer."""
    rule = Evaluation(3, margin=0.0)
    made = trail()
    for number, source in ((0, 0), (1, 8)):
        made = made.with_training(number, Training(source, 2, 400), 400.0)
        row = np.array([0.9, 0.5, 0.1]) if number == 0 else np.array([0.1, 0.5, 0.9])
        made = made.with_evaluation(Policy(number, 2), np.array([0, 4, 8]), row, 30.0)
    assert rule.more(PROBLEM, made, Policy(0, 2)) is None
    further = rule.more(PROBLEM, made, Policy(1, 2))
    assert further == rule.next(PROBLEM, made)
    assert further.policy == Policy(1, 2)
    assert set(further.targets) <= {2, 6}
    busy = replace(made, under_way=(Evaluate(Policy(1, 2), (2,)),))
    assert rule.more(PROBLEM, busy, Policy(1, 2)) is None
