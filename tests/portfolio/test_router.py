import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mbtl.contexts import Categorical, ContextSpace, Linear, Log
from mbtl.errors import ContextMismatch
from mbtl.models.beliefs import Beliefs
from mbtl.portfolio.router import forecast
from mbtl.routing import last_route

LINE = ContextSpace.grid({Linear("x", 0.0, 4.0): 5})
nan = np.nan


def best(space, sources, rows, context, theta=0.1):
    beliefs = Beliefs(space, sources, np.asarray(rows, dtype=float))
    seen = forecast(space, sources, beliefs, theta, context)
    return seen.ranking(sources), seen


def test_listed_context_goes_to_the_best_measured_return():
    ranking, seen = best(LINE, [0, 4], [[1, 0.9, 0.2, 0.1, 0], [0, 0.1, 0.5, 0.9, 1]], {"x": 2.0})
    assert (ranking, seen.basis, seen.target) == ([1, 0], ("observed", "observed"), 2)


def test_tie_goes_to_the_nearer_source_then_to_the_lower_index():
    rows = np.ones((3, 5))
    assert best(LINE, [0, 4, 1], rows, {"x": 3.0})[0] == [1, 2, 0]
    assert best(LINE, [4, 2, 0], rows, {"x": 1.0})[0] == [2, 1, 0]  # 0 and 2 are one step away


def test_differences_below_rounding_are_ties():
    rows = np.array([[0.3, 1, 1, 1, 1], [0.1 + 0.2, 1, 1, 1, 1]])
    assert best(LINE, [0, 4], rows, {"x": 0.0})[0] == [0, 1]


def test_a_policy_that_was_not_evaluated_here_is_predicted_not_borrowed_from_next_door():
    falls = 1.0 - 0.2 * np.arange(5.0)
    rows = np.array([falls, falls[::-1]])
    rows[0, 2:4] = nan  # between 0.8 and 0.2
    _, seen = best(LINE, [0, 4], rows, {"x": 3.0})
    assert seen.basis == ("predicted", "observed")
    assert 0.2 < seen.performance[0] < 0.6
    assert seen.judged_on.tolist() == [[3], [3]]
    assert [part.tolist() for part in seen.parts(1)] == [[1], [3], [1.0]]


def test_between_grid_points_returns_are_interpolated_linearly():
    _, seen = best(LINE, [0], [[0, 1, 3, 0, 0]], {"x": 1.25})
    assert seen.performance == pytest.approx([1.5])
    assert seen.basis == ("interpolated",)


def test_log_axis_interpolates_in_grid_steps():
    space = ContextSpace.grid({Log("x", 1.0, 100.0): 3})  # 1, 10, 100
    _, seen = best(space, [0], [[0, 1, 2]], {"x": 10**0.5})
    assert seen.performance == pytest.approx([0.5])


def test_beyond_the_outermost_grid_value_its_return_holds():
    space = ContextSpace.grid({Linear("x", 0.0, 10.0): [1.0, 2.0, 3.0]})
    _, seen = best(space, [0], [[5, 4, 3]], {"x": 9.0})
    assert seen.performance == pytest.approx([3.0])


def test_two_axes_are_bilinear():
    space = ContextSpace.grid({Linear("x", 0, 1): 2, Linear("y", 0, 1): 2})
    _, seen = best(space, [0], [[0, 10, 100, 110]], {"x": 0.25, "y": 0.5})
    assert seen.performance == pytest.approx([0.25 * 100 + 0.5 * 10])


def test_categorical_level_is_never_mixed():
    space = ContextSpace.grid({Categorical("c", ("a", "b")): ["b", "a"], Linear("y", 0, 1): 2})
    rows = [[0, 1, 100, 200]]
    assert best(space, [0], rows, {"c": "b", "y": 0.5})[1].performance == pytest.approx([0.5])
    assert best(space, [0], rows, {"c": "a", "y": 0.5})[1].performance == pytest.approx([150.0])


def test_unlisted_categorical_level_falls_to_the_gap_model():
    space = ContextSpace.grid({Categorical("c", ("a", "b", "z")): ["a", "b"], Linear("y", 0, 1): 2})
    _, seen = best(space, [0], [[5, 4, 3, 2]], {"c": "z", "y": 0.0}, theta=0.25)
    assert seen.basis == ("gap model",)
    assert seen.performance == pytest.approx([5 - 0.25])  # two levels are one step apart


def test_point_list_on_one_axis_is_linear_between_its_points():
    space = ContextSpace.points([Linear("x", 0, 8)], [{"x": 8.0}, {"x": 0.0}, {"x": 1.0}])
    _, seen = best(space, [0], [[70, 0, 10]], {"x": 0.5})
    assert seen.performance == pytest.approx([5.0])


def test_point_list_weights_by_inverse_squared_distance():
    axes = [Linear("x", 0, 1), Linear("y", 0, 1)]
    contexts = [{"x": x, "y": y} for x, y in [(0, 0), (0.3, 0), (0, 1), (1, 1), (1, 0)]]
    space = ContextSpace.points(axes, contexts)
    _, seen = best(space, [0], [[1, 0, 0, 0, 0]], {"x": 0.1, "y": 0.0})
    weights = 1 / np.array([0.1, 0.2, np.hypot(0.1, 1), 0.9]) ** 2
    assert seen.performance == pytest.approx([weights[0] / weights.sum()])


def test_outside_the_axes_is_an_error():
    with pytest.raises(ContextMismatch, match=r"takes values in \[0, 4\]"):
        best(LINE, [0], np.ones((1, 5)), {"x": 5.0})


@settings(max_examples=20)
@given(st.data())
def test_the_map_of_all_contexts_agrees_with_routing_one_by_one(data):
    space = ContextSpace.grid({Linear("x", 0, 1): 4, Linear("y", 0, 1): 3})
    k = data.draw(st.integers(1, 5))
    sources = data.draw(st.lists(st.integers(0, 11), min_size=k, max_size=k))
    entry = st.sampled_from([0.0, 0.5, 1.0])
    rows = np.array(
        data.draw(st.lists(st.lists(entry, min_size=12, max_size=12), min_size=k, max_size=k))
    )
    chosen = last_route(rows, sources, space.steps)
    for target in range(12):
        assert chosen[target] == best(space, sources, rows, space.context(target))[0][0]
