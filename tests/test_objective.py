import numpy as np
import pytest

from flat import created
from mbtl import ContextSpace, Linear, TransferMatrix
from mbtl.errors import InvalidInput
from mbtl.objective import (
    Bounds,
    direction_named,
    generalisation_gap,
    generalisation_performance,
    k_star,
    marginal_gain,
    regret,
    value,
    value_curve,
)
from mbtl.problems import CMDP

J = np.array([[0.9, 0.5, 0.1], [0.4, 0.8, 0.4], [0.0, 0.6, 1.0]])


def test_value_is_the_mean_of_column_maxima():
    assert value(generalisation_performance(J[:2])) == pytest.approx((0.9 + 0.8 + 0.4) / 3)
    assert value(J.max(axis=0), np.array([0.5, 0.25, 0.25])) == pytest.approx(0.45 + 0.2 + 0.25)


def test_curve_ends_at_the_value_and_never_falls():
    curve = value_curve(J)
    assert curve == pytest.approx([0.5, 0.7, 0.9])
    assert (np.diff(curve) >= 0).all()


def test_nothing_trained_serves_nobody():
    assert generalisation_performance(np.empty((0, 3))).tolist() == [-np.inf] * 3


def test_targets_a_policy_was_not_evaluated_on_are_ignored():
    rows = np.array([[0.2, np.nan, np.nan], [0.1, 0.5, np.nan]])
    assert generalisation_performance(rows).tolist() == [0.2, 0.5, -np.inf]


def test_marginal_gain_counts_only_improved_targets():
    assert marginal_gain(J, J[0]) == pytest.approx([0.0, (0.3 + 0.3) / 3, (0.1 + 0.9) / 3])


def test_gap_is_zero_on_the_source():
    gap = generalisation_gap(J)
    assert np.diagonal(gap).tolist() == [0.0] * 3
    assert gap[0, 2] == pytest.approx(0.8)


def test_regret_is_against_the_best_pick_of_the_same_history():
    # best first pick: row 0 mean .5, row 1 .5333, row 2 .5333; picking row 0 regrets .0333
    assert regret(J, [0, 2]) == pytest.approx([0.1 / 3, 0.0])


def test_k_star_is_the_first_to_reach_the_level():
    assert k_star([0.5, 0.7, 0.9], 0.7) == 2
    assert k_star([0.5, 0.7, 0.9], 0.95) is None


@pytest.mark.parametrize(
    ("direction", "expected"), [("maximize", [0, 0.5, 1.2]), ("minimize", [1, 0.5, -0.2])]
)
def test_bounds_normalise_without_clipping_and_back(direction, expected):
    bounds = Bounds(-100.0, 0.0, direction)
    returns = np.array([-100.0, -50.0, 20.0])
    assert bounds.normalise(returns) == pytest.approx(expected)
    assert bounds.denormalise(bounds.normalise(returns)) == pytest.approx(returns)


@pytest.mark.parametrize(("direction", "worse"), [("maximize", -130.0), ("minimize", 130.0)])
def test_a_floor_counts_in_performance_and_bounds_are_a_pair(direction, worse):
    low, high = (-100.0, 0.0) if direction == "maximize" else (0.0, 100.0)
    bounds = Bounds(low, high, direction, floor=np.sign(worse) * 100.0)
    assert bounds.normalise([worse, worse / 2.6]) == pytest.approx([0.0, 0.5])
    assert tuple(bounds) == (bounds[0], bounds[1]) == (low, high)
    assert np.asarray(bounds).tolist() == [low, high]
    assert "count as" in str(bounds)


def test_automatic_bounds_hold_the_finite_returns_and_impossible_ones_are_refused():
    bounds = Bounds.of([3.0, np.nan, -1.0])
    assert (bounds.low, bounds.high) == (-1.0, 3.0)
    assert Bounds.of([2.0, 2.0]).high == 3.0
    for given in ((1, 1), (0, np.nan), (0, 1, "up")):
        with pytest.raises(InvalidInput):
            Bounds(*given)
    with pytest.raises(InvalidInput):
        Bounds.of([])


@pytest.mark.parametrize("short", ["max", "min"])
def test_a_direction_has_a_short_name_everywhere(short):
    long = {"max": "maximize", "min": "minimize"}[short]
    assert direction_named(short) == direction_named(long) == long
    assert Bounds(0, 1, short) == Bounds(0, 1, long)
    for name in (short, long):
        assert TransferMatrix.of(np.eye(2)[None], direction=name).bounds.direction == long
        space = ContextSpace.grid({Linear("x", 0, 1): 2})
        assert created(space, budget=1, direction=name).spec.direction == long
        assert CMDP("own", space, None, bounds=(0, 1), direction=name).direction == long
    with pytest.raises(InvalidInput, match="'maximize' or 'minimize'"):
        direction_named("up")
