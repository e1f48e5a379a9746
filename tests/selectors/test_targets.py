"""Targets: spread over the space, by weight, every level among them, the source too."""

import numpy as np
import pytest

from mbtl.contexts import Categorical, ContextSpace, Linear
from mbtl.selectors.base import SelectionProblem
from mbtl.selectors.targets import spread_targets


def problem(axes, weights=None):
    return SelectionProblem.of(ContextSpace.grid(axes, weights=weights), budget=1)


def farthest(of, targets):
    """Distance of the worst covered context to its nearest target, unit coordinates."""
    apart = np.linalg.norm(of.unit[:, None] - of.unit[list(targets)], axis=2)
    return apart.min(axis=1).max()


def test_targets_on_two_axes_fill_the_square_instead_of_its_diagonal():
    square = problem({Linear("a", 0, 1): 10, Linear("b", 0, 1): 10})
    chosen = spread_targets(square, 0, 10)
    assert len(set(chosen)) == 10
    assert 0 in chosen
    assert farthest(square, chosen) < 0.45  # the diagonal leaves 0.71 at the corners


def test_no_level_of_a_categorical_axis_is_left_out():
    for names, count in ((("dry", "wet", "ice"), 6), (("a", "b", "c", "d", "e"), 5)):
        roads = problem({Linear("a", 0, 1): 8, Categorical("road", names): len(names)})
        levels = ContextSpace.grid({Linear("a", 0, 1): 8, Categorical("road", names): len(names)})
        for source in range(roads.n):
            chosen = spread_targets(roads, source, count)
            assert source in chosen
            assert {levels.values("road")[t] for t in chosen} == set(names)


LINE, SQUARE = {Linear("a", 0, 1): 40}, {Linear("a", 0, 1): 8, Linear("b", 0, 1): 5}


@pytest.mark.parametrize("axes", [LINE, SQUARE])
def test_what_has_no_weight_is_no_target_and_what_has_more_gets_more(axes):
    weights = np.where(np.arange(40) < 10, 0.0, np.where(np.arange(40) < 20, 8.0, 1.0))
    chosen = np.array(spread_targets(problem(axes, weights), 15, 8))
    assert (chosen >= 10).all()
    assert np.count_nonzero(chosen < 20) >= 4


def test_the_source_takes_the_place_of_the_nearest_target():
    line = problem({Linear("a", 0, 1): 61})
    assert spread_targets(line, 31, 7) == (0, 10, 20, 31, 40, 50, 60)
    assert spread_targets(line, 60, 1) == (60,)
    assert spread_targets(line, 3, 61) == tuple(range(61))


def test_few_contexts_with_weight_are_all_targets_and_nothing_else_but_the_source():
    weights = np.zeros(20)
    weights[[3, 4, 17]] = 1.0
    few = problem({Linear("a", 0, 1): 20}, weights)
    assert spread_targets(few, 9, 5) == (3, 4, 9, 17)
    assert spread_targets(few, 4, 5) == (3, 4, 17)
