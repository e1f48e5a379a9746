"""Strategies: what each decides, on trails made by hand."""

import numpy as np
import pytest

from mbtl.actions import Evaluate, Extend, FixedLength, Halving, Policy, Start, StepProblem, Stop
from mbtl.actions.base import Trail, Training, filled_rows
from mbtl.contexts import ContextSpace, Linear
from mbtl.selectors.base import SelectionProblem

N = 9
SPACE = ContextSpace.grid({Linear("x", 0.0, 8.0): [float(i) for i in range(N)]})
PROBLEM = StepProblem(
    SelectionProblem.of(SPACE, budget=N), np.array([100, 200, 400]), 1e6, episodes=1, horizon=10
)
RNG = np.random.default_rng(0)


def trail(*policies, lengths=None, ended=()):
    """One training per (source, level): a row that falls by 0.1 per step from its level."""
    made = Trail(N)
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


def test_fixed_length_trains_evaluates_and_halves_the_largest_stretch():
    strategy = FixedLength(length=1, targets=3)
    assert strategy.decide(PROBLEM, Trail(N), RNG) == Start(4, 1)
    begun = Trail(N).with_training(0, Training(4, 1, 200), 200.0)
    assert strategy.decide(PROBLEM, begun, RNG) == Evaluate(Policy(0, 1), (0, 4, 8))
    assert strategy.decide(PROBLEM, trail((4, 0.5)), RNG) == Start(0, 1)
    assert strategy.decide(PROBLEM, trail((4, 0.5), (0, 0.5)), RNG) == Start(8, 1)


def test_fixed_length_asks_a_selector_and_stops_when_all_is_trained():
    strategy = FixedLength("mbtl")
    assert strategy.decide(PROBLEM, Trail(N), RNG) == Start(4, 2)
    assert strategy.decide(PROBLEM, trail((4, 0.5)), RNG) == Start(0, 2)  # the worst context
    assert strategy.decide(PROBLEM, trail(*((s, 0.5) for s in range(N))), RNG) == Stop()


def test_halving_promotes_the_best_half_of_a_rung_the_highest_first():
    strategy = Halving("own", every=1)
    assert strategy.decide(PROBLEM, trail((4, 0.5), (0, 0.7)), RNG) == Extend(1, 1)
    there = trail((4, 0.5), (0, 0.7), (8, 0.6), (2, 0.4), lengths=(1, 1, 0, 0))
    assert strategy.decide(PROBLEM, there, RNG) == Extend(1, 2)
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
