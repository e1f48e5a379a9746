import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mbtl.contexts import Categorical, ContextSpace, Linear, Log
from mbtl.errors import ContextMismatch
from mbtl.models.beliefs import Beliefs
from mbtl.portfolio.router import forecast
from mbtl.routing import last_route, rank

LINE = ContextSpace.grid({Linear("x", 0.0, 4.0): 5})


def best(space, sources, rows, context):
    beliefs = Beliefs(space, sources, np.asarray(rows, dtype=float))
    seen = forecast(space, sources, beliefs, context)
    return rank(seen.performance, seen.distance, np.asarray(sources)).tolist(), seen


def test_listed_context_goes_to_the_best_measured_return():
    ranking, seen = best(LINE, [0, 4], [[1, 0.9, 0.2, 0.1, 0], [0, 0.1, 0.5, 0.9, 1]], {"x": 2.0})
    assert (ranking, seen.basis, seen.target) == ([1, 0], ("observed", "observed"), 2)


def test_tie_goes_to_the_nearer_source_then_to_the_lower_index():
    rows = np.ones((3, 5))
    assert best(LINE, [0, 4, 1], rows, {"x": 3.0})[0] == [1, 2, 0]
    assert best(LINE, [4, 2, 0], rows, {"x": 1.0})[0] == [2, 1, 0]  # 0 and 2 are one step away
    below_rounding = np.array([[0.3, 1, 1, 1, 1], [0.1 + 0.2, 1, 1, 1, 1]])
    assert best(LINE, [0, 4], below_rounding, {"x": 0.0})[0] == [0, 1]


def test_a_policy_that_was_not_evaluated_here_is_predicted_not_borrowed_from_next_door():
    falls = 1.0 - 0.2 * np.arange(5.0)
    rows = np.array([falls, falls[::-1]])
    rows[0, 2:4] = np.nan  # between 0.8 and 0.2
    _, seen = best(LINE, [0, 4], rows, {"x": 3.0})
    assert seen.basis == ("predicted", "observed")
    assert 0.2 < seen.performance[0] < 0.6
    assert (seen.judged_on.tolist(), seen.weights.tolist()) == ([3], [1.0])


KINDS = {Categorical("c", ("a", "b", "z")): ["b", "a"], Linear("y", 0, 1): 2}
APART = ContextSpace.points(
    [Linear("x", 0, 1), Linear("y", 0, 1)],
    [{"x": x, "y": y} for x, y in [(0, 0), (0.3, 0), (0, 1), (1, 1), (1, 0)]],
)
INVERSE = 1 / np.array([0.1, 0.2, np.hypot(0.1, 1), 0.9]) ** 2


@pytest.mark.parametrize(
    ("space", "row", "context", "expected"),
    [
        (LINE, [0, 1, 3, 0, 0], {"x": 1.25}, 1.5),
        (ContextSpace.grid({Log("x", 1.0, 100.0): 3}), [0, 1, 2], {"x": 10**0.5}, 0.5),
        # beyond the outermost grid value, its return
        (ContextSpace.grid({Linear("x", 0.0, 10.0): [1.0, 2.0, 3.0]}), [5, 4, 3], {"x": 9.0}, 3.0),
        (
            ContextSpace.grid({Linear("x", 0, 1): 2, Linear("y", 0, 1): 2}),
            [0, 10, 100, 110], {"x": 0.25, "y": 0.5}, 0.25 * 100 + 0.5 * 10,
        ),
        # levels are never mixed; one that no context has is judged by the nearest of all
        (ContextSpace.grid(KINDS), [0, 1, 100, 200], {"c": "a", "y": 0.5}, 150.0),
        (ContextSpace.grid(KINDS), [0, 1, 100, 201], {"c": "z", "y": 0.5}, 302 / 4),
        (
            ContextSpace.points([Linear("x", 0, 8)], [{"x": 8.0}, {"x": 0.0}, {"x": 1.0}]),
            [70, 0, 10], {"x": 0.5}, 5.0,
        ),
        (APART, [1, 0, 0, 0, 0], {"x": 0.1, "y": 0.0}, INVERSE[0] / INVERSE.sum()),
    ],
)  # fmt: skip
def test_between_listed_contexts_returns_are_interpolated(space, row, context, expected):
    _, seen = best(space, [0], [row], context)
    assert (seen.basis, seen.target) == (("interpolated",), None)
    assert seen.performance == pytest.approx([expected])
    assert seen.weights.sum() == pytest.approx(1.0)


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
