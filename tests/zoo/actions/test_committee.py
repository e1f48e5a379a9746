"""Committee: both sides at equal steps, and who gets what is left."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pytest

from mbtl.contexts import ContextSpace, Linear
from mbtl.selectors.base import SelectionProblem
from mbtl.zoo.actions import (
    Committee,
    Evaluate,
    Evaluation,
    Extend,
    FixedLength,
    Policy,
    Start,
    StartOn,
    StepProblem,
    Stop,
    Training,
)
from mbtl.zoo.actions.base import Trail, middle_of
from mbtl.zoo.actions.committee import Sides

N, HORIZON = 9, 10
SPACE = ContextSpace.grid({Linear("x", 0.0, 8.0): [float(i) for i in range(N)]})
MARKS = np.array([50, 100, 200, 400, 800, 1600, 3200, 6400])
PROBLEM = StepProblem(
    SelectionProblem.of(SPACE, budget=N), np.array([100]), 20_000.0, 1, HORIZON, MARKS
)
EVERYWHERE = tuple(range(N))
RULE = Committee(FixedLength(), evaluation=Evaluation())
RNG = np.random.default_rng(0)


@dataclass
class World:
    """Specialists fall by `slope` per step from 0.8 at home; one policy for all has `curve`.

    A training on all contexts costs a `share` of its mark.
    """

    curve: tuple[float, ...]
    slope: float = 0.1
    share: float = 1.0

    def act(self, trail, action):
        match action:
            case Start(source, length):
                return trail.with_training(len(trail.trainings), Training(source, 0, 100), 100.0)
            case StartOn(sources, length):
                steps = round(MARKS[length] * self.share)
                now = Training(middle_of(sources, trail.steps), length, steps, on=sources)
                return trail.with_training(len(trail.trainings), now, float(steps))
            case Evaluate(policy, targets):
                training = trail.trainings[policy.training]
                row = 0.8 - self.slope * np.abs(np.arange(N) - training.source)
                if training.on:
                    row = np.full(N, self.curve[policy.length]) + 0.01 * np.cos(np.arange(N))
                at = np.array(targets)
                return trail.with_evaluation(policy, at, row[at], 10.0 * len(at))
        raise AssertionError(action)


def played(world, rule=RULE, budget=20_000.0):
    """The trails after each action, until it stops."""
    trails = [Trail(PROBLEM.selection.steps)]
    while (action := rule.decide(PROBLEM, trails[-1], RNG)) != Stop():
        after = world.act(trails[-1], action)
        if after.spent > budget:
            break
        trails.append(after)
    return trails


def lengths_on_all(trail):
    return [t.length for t in trail.trainings if t.on]


def test_a_try_waits_until_the_specialists_have_cost_as_much_as_all_tries_then():
    trails = played(World((0.5,) * 8))  # nobody is ahead for long
    for before, after in pairwise(trails):
        if len(lengths_on_all(after)) > len(lengths_on_all(before)):
            ours = Sides.of(before).ours
            assert len(ours.trainings) == N or ours.spent >= sum(
                MARKS[: len(lengths_on_all(after))]
            )


def test_where_episodes_are_short_a_try_waits_for_what_the_last_one_says_it_costs():
    share, largest, begun = 0.1, 100 + 2 * 90, 0
    for before, after in pairwise(played(World((0.5,) * 8, share=share))):
        tries = len(lengths_on_all(after))
        sides = Sides.of(before)
        if len(lengths_on_all(before)) in (0, tries) or len(sides.ours.trainings) == N:
            continue
        then = sides.spent_on_all + share * MARKS[tries - 1]
        assert then <= sides.ours.spent <= then + largest
        begun += 1
    assert begun >= 3


@pytest.mark.parametrize("curve", [(0.1,) * 8, (0.95,) * 8, (0.1,) * 4 + (0.95,) * 4, (0.55,) * 8])
@pytest.mark.parametrize("slope", [0.02, 0.1, 0.3])
def test_what_either_side_has_costs_twice_its_own_steps_at_most(curve, slope):
    """Until one side is given up; but for the piece under way and evaluations."""
    largest = 100 + 2 * 90
    for trail in played(World(curve, slope)):
        sides = Sides.of(trail)
        if RULE.verdict(PROBLEM, trail) is not None or len(sides.ours.trainings) == N:
            break
        assert trail.spent <= 2 * sides.ours.spent + largest
        assert sides.ours.spent <= sides.spent_on_all + MARKS[len(sides.on_all)] + largest
        if sides.on_all and trail.trainings[-1].on:  # a try has just been done
            assert trail.spent <= 2 * sides.spent_on_all + largest


def test_one_policy_that_is_ahead_over_two_doublings_gets_what_is_left():
    trails = played(World((0.1, 0.95, 0.96, 0.97, 0.98, 0.98, 0.98, 0.98)))
    first = next(i for i, t in enumerate(trails) if RULE.verdict(PROBLEM, t))
    found = trails[first]
    assert lengths_on_all(found) == [0, 1, 2, 3]  # ahead at 1, 2 and 3
    assert "one policy for all is enough here" in RULE.verdict(PROBLEM, found)
    assert "over 2 doublings of its length" in RULE.verdict(PROBLEM, found)
    own = Sides.of(found).spent_on_all
    assert f"after {own:,.0f} steps each" in RULE.verdict(PROBLEM, found)
    assert found.spent <= 2 * own + 200
    assert Sides.of(trails[-1]).numbers == Sides.of(found).numbers  # no specialist more
    assert lengths_on_all(trails[-1]) == list(range(len(MARKS)))
    assert RULE.decide(PROBLEM, trails[-1], RNG) == Stop()


def test_specialists_that_are_ahead_get_what_is_left():
    trails = played(World((0.05, 0.05, 0.06, 0.07, 0.08, 0.09, 0.1, 0.1)))
    assert "specialists are ahead here" in RULE.verdict(PROBLEM, trails[-1])
    # the first try costs less than a specialist with its evaluation: nobody is beside it
    assert lengths_on_all(trails[-1]) == [0, 1, 2, 3]
    assert sum(not t.on for t in trails[-1].trainings) == N


def test_more_doublings_decide_later():
    def tries(doublings):
        rule = Committee(FixedLength(), doublings, Evaluation())
        trails = played(World((0.05,) * 8), rule)
        return lengths_on_all(next(t for t in trails if rule.verdict(PROBLEM, t)))

    assert [len(tries(d)) for d in (1, 2, 3)] == [3, 4, 5]


def test_a_lead_within_its_error_decides_nothing():
    class Wavy(World):
        def act(self, trail, action):
            if isinstance(action, Evaluate) and trail.trainings[action.policy.training].on:
                row = 0.72 + 0.4 * (-1.0) ** np.arange(N)  # its mean is a little ahead
                return trail.with_evaluation(action.policy, np.arange(N), row, 90.0)
            return super().act(trail, action)

    trails = played(Wavy((0.0,) * 8))
    assert all(RULE.verdict(PROBLEM, trail) is None for trail in trails)
    assert lengths_on_all(trails[-1]) == list(range(len(MARKS)))


def test_a_try_that_the_budget_cannot_pay_for_is_not_begun():
    poor = StepProblem(PROBLEM.selection, PROBLEM.lengths, 1_500.0, 1, HORIZON, MARKS)
    trail, world = Trail(PROBLEM.selection.steps), World((0.5,) * 8)
    while (action := RULE.decide(poor, trail, RNG)) != Stop():
        assert not isinstance(action, StartOn) or trail.spent + MARKS[action.length] <= 1_500
        trail = world.act(trail, action)
    assert lengths_on_all(trail) == [0, 1, 2]
    assert sum(not t.on for t in trail.trainings) == N


def test_specialists_see_nothing_of_the_other_side_and_act_as_if_alone():
    alone, trail = [], Trail(PROBLEM.selection.steps)
    world, plain = World((0.5,) * 8), FixedLength()
    while (action := plain.decide(PROBLEM, trail, RNG)) != Stop():
        alone.append(action)
        trail = world.act(trail, action)
    both = Sides.of(played(world)[-1]).ours
    assert both.trainings == trail.trainings
    assert both.policies == trail.policies
    assert np.array_equal(both.rows, trail.rows)


def test_actions_of_specialists_are_told_in_the_numbers_of_the_whole():
    trail = Trail(PROBLEM.selection.steps)
    trail = trail.with_training(0, Training(4, 0, 50, on=EVERYWHERE), 50.0)
    trail = trail.with_training(1, Training(3, 0, 100), 100.0)
    sides = Sides.of(trail)
    assert list(sides.on_all) == [0]
    assert sides.spent_on_all == 50.0
    assert sides.back(Extend(0, 1)) == Extend(1, 1)
    assert sides.back(Evaluate(Policy(0, 0), (2,))) == Evaluate(Policy(1, 0), (2,))
    assert sides.ours.spent == 100.0


def test_without_marks_for_all_there_are_specialists_only():
    bare = StepProblem(PROBLEM.selection, PROBLEM.lengths, 20_000.0, 1, HORIZON)
    trail, world = Trail(PROBLEM.selection.steps), World((0.9,) * 8)
    while (action := RULE.decide(bare, trail, RNG)) != Stop():
        trail = world.act(trail, action)
    assert len(trail.trainings) == N
    assert not any(t.on for t in trail.trainings)


def test_the_middle_of_a_set_is_one_of_it():
    assert middle_of((0, 1, 8), PROBLEM.selection.steps) == 1
    assert middle_of(EVERYWHERE, PROBLEM.selection.steps) == 4
