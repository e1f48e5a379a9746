"""Routes: the best policy, of equals the nearest, after every training."""

import numpy as np

from mbtl.routing import last_route, rank, routed, routes

LINE = np.arange(5.0)[:, None]


def test_the_best_policy_serves_and_of_equals_the_nearest():
    rows = np.array([[1.0, 1, 1, 1, 1], [1.0, 1, 1, 1, 2], [0, 3, 0, 0, 0]])
    found = routes(rows, [1, 4, 0], LINE)
    assert found.tolist() == [[0, 0, 0, 0, 0], [0, 0, 0, 1, 1], [0, 2, 0, 1, 1]]
    assert last_route(rows, [1, 4, 0], LINE).tolist() == found[-1].tolist()


def test_a_route_depends_on_no_later_training():
    rng = np.random.default_rng(0)
    rows = rng.integers(0, 3, (6, 5)).astype(float)
    sources = [3, 0, 4, 4, 1, 2]
    whole = routes(rows, sources, LINE)
    for k in range(1, 7):
        assert np.array_equal(routes(rows[:k], sources[:k], LINE), whole[:k])


def test_ties_do_not_hang_on_the_order_of_trainings_but_for_trainings_on_one_source():
    rows = np.ones((3, 5))
    first, second = routes(rows, [0, 4, 2], LINE)[-1], routes(rows, [4, 2, 0], LINE)[-1]
    assert [[0, 4, 2][i] for i in first] == [[4, 2, 0][i] for i in second] == [0, 0, 2, 2, 4]
    assert routes(rows, [2, 2, 2], LINE)[-1].tolist() == [0] * 5


def test_what_is_unknown_loses_and_where_all_is_unknown_the_nearest_serves():
    rows = np.array([[np.nan, -5.0, np.nan], [np.nan, np.nan, -9.0]])
    assert routes(rows, [0, 2], LINE[:3])[-1].tolist() == [0, 0, 1]


def test_values_are_looked_up_along_the_routes_and_ranked_by_the_same_rule():
    values = np.array([[1.0, 2.0], [3.0, 4.0]])
    assert routed(values, np.array([[0, 0], [1, 0]])).tolist() == [[1, 2], [3, 2]]
    order = rank(np.array([1.0, 2.0, 2.0, np.nan]), np.array([0, 5.0, 1, 0]), np.arange(4))
    assert order.tolist() == [2, 1, 0, 3]
