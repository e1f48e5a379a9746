import time

import numpy as np
import pytest

from mbtl.contexts import Categorical, ContextSpace, Integer, Linear, Log
from mbtl.errors import InvalidInput
from mbtl.models.relevance import Columns, fit_relevance, stretched
from mbtl.models.transfer_gp import TransferGP
from mbtl.models.transfer_kernel import Places, TransferPrior, covariance, grid_pairs

PRIOR = TransferPrior()


def cube(n, d, seed=0):
    unit = np.random.default_rng(seed).uniform(size=(n, d))
    return unit, Columns.of((), d).places(unit, 6.0 * unit)


def observed(unit, k, matter, n_targets=30, scale=0.15):
    """k whole rows that fall along the axes `matter` alone."""
    pairs = grid_pairs(np.arange(k), np.arange(n_targets))
    gap = (unit[pairs[:, 1]] - unit[pairs[:, 0]])[:, matter]
    return pairs, 0.9 / (1.0 + np.square(np.square(gap / scale).sum(axis=1)))


# ---- columns -------------------------------------------------------------------------------------


def test_linear_axes_lie_as_they_always_did():
    space = ContextSpace.grid({Linear("a", 0, 1): 4, Integer("b", 1, 5): 5})
    columns = Columns.of(space.axes, 2)
    places, plain = columns.places(space.unit, space.steps), Places.of(space.unit, space.steps)
    assert columns.axis.tolist() == [0, 1]
    assert np.array_equal(places.x, plain.x)
    assert np.array_equal(places.z, plain.z)
    nameless = Columns.of((), 2).places(space.unit, space.steps)
    assert np.array_equal(nameless.z, plain.z)


def test_logarithmic_and_categorical_axes_have_no_second_scale():
    axes = [Log("a", 0.01, 1.0), Categorical("b", ("p", "q", "r"))]
    space = ContextSpace.sample(axes, 30, seed=0)
    columns = Columns.of(space.axes, 4)
    places = columns.places(space.unit, space.steps)
    assert columns.axis.tolist() == [0, 1, 1, 1]
    assert not columns.ratios.any()
    assert np.array_equal(places.z, places.x)


def test_an_axis_counts_once_however_many_columns_it_has():
    axes = [Linear("a", 0.0, 1.0), Categorical("b", ("p", "q", "r", "s"))]
    contexts = [{"a": 0.0, "b": "p"}, {"a": 1.0, "b": "p"}, {"a": 0.0, "b": "s"}]
    space = ContextSpace.points(axes, contexts)
    x = Columns.of(space.axes, 5).places(space.unit, space.steps).x
    root_mean_square = np.sqrt(np.square(x - x[0]).mean(axis=1))
    assert root_mean_square == pytest.approx([0.0, np.sqrt(0.5), np.sqrt(0.5)])


def test_axes_that_do_not_fit_the_coordinates_are_refused():
    with pytest.raises(InvalidInput, match=r"as many columns as the coordinates \(3\), got 1"):
        Columns.of([Linear("a", 0, 1)], 3)


# ---- relevance -----------------------------------------------------------------------------------


def test_an_axis_of_weight_zero_is_as_if_it_were_not_there():
    _, places = cube(12, 3)
    alone = Places(places.x[:, :1], places.z[:, :1])
    pairs = grid_pairs(np.array([0, 5]), np.arange(12))
    ignored = stretched(places, np.sqrt([3.0, 0.0, 0.0]))
    assert covariance(ignored, PRIOR, pairs, pairs) == pytest.approx(
        covariance(alone, PRIOR, pairs, pairs), abs=1e-6
    )


@pytest.mark.parametrize("matter", [[0], [2], [0, 2]])
def test_rows_tell_which_axes_matter(matter):
    unit, places = cube(60, 4)
    found = fit_relevance(places, np.arange(4), PRIOR, *observed(unit, 6, matter))
    rest = [axis for axis in range(4) if axis not in matter]
    assert found[matter].min() > 2.0 * found[rest].max()
    assert np.square(found).mean() == pytest.approx(1.0)


def test_one_row_says_less_than_many_of_them():
    unit, places = cube(60, 3)
    ratios = []
    for k in (1, 8):
        found = fit_relevance(places, np.arange(3), PRIOR, *observed(unit, k, [1]))
        ratios.append(found[1] / found[[0, 2]].max())
    assert 1.0 < ratios[0] < ratios[1]


def test_weights_stay_near_one_where_all_axes_matter_alike():
    unit, places = cube(60, 3)
    pairs, y = observed(unit, 8, [0, 1, 2], scale=0.5)
    found = fit_relevance(places, np.arange(3), PRIOR, pairs, y)
    assert found.max() < 2.0 * found.min()


def test_no_axis_is_forgotten_altogether():
    unit, places = cube(60, 3)
    found = fit_relevance(places, np.arange(3), PRIOR, *observed(unit, 12, [0]))
    assert found.min() > 0.2


def test_columns_of_one_axis_share_its_weight():
    axes = [Categorical("a", ("p", "q", "r")), Linear("b", 0.0, 1.0)]
    space = ContextSpace.sample(axes, 60, seed=0)
    columns = Columns.of(space.axes, 4)
    places = columns.places(space.unit, space.steps)
    pairs = grid_pairs(np.arange(6), np.arange(30))
    level = space.unit[:, :3].argmax(axis=1)
    y = np.where(level[pairs[:, 0]] == level[pairs[:, 1]], 0.9, 0.2)
    found = fit_relevance(places, columns.axis, PRIOR, pairs, y)
    assert found.shape == (2,)
    assert found[0] > 2.0 * found[1]


def test_relevance_predicts_rows_of_untried_sources_better():
    unit, places = cube(80, 4)
    pairs, y = observed(unit, 6, [1], scale=0.2)
    truth = observed(unit, 40, [1], scale=0.2)[1].reshape(40, 30)[10:]
    error = []
    for weights in (np.ones(4), fit_relevance(places, np.arange(4), PRIOR, pairs, y)):
        model = TransferGP(stretched(places, weights), PRIOR, pairs, y)
        error.append(np.abs(model.predict(np.arange(10, 40), np.arange(30))[0] - truth).mean())
    assert error[1] < 0.7 * error[0]


@pytest.mark.parametrize(("d", "n"), [(1, 30), (3, 1)])
def test_nothing_to_tell_means_equal(d, n):
    _, places = cube(40, d)
    pairs = grid_pairs(np.array([0]), np.arange(n))
    found = fit_relevance(places, np.arange(d), PRIOR, pairs, np.linspace(0.0, 1.0, n))
    assert found.tolist() == [1.0] * d


def test_rows_without_differences_mean_equal():
    _, places = cube(40, 3)
    pairs = grid_pairs(np.array([0, 1]), np.arange(40))
    found = fit_relevance(places, np.arange(3), PRIOR, pairs, np.full(len(pairs), 0.5))
    assert np.isfinite(found).all()
    assert found == pytest.approx(np.ones(3), abs=0.7)


def test_same_rows_same_weights_and_a_million_contexts_cost_no_more():
    unit, places = cube(60, 3)
    data = observed(unit, 20, [0])
    once = fit_relevance(places, np.arange(3), PRIOR, *data)
    wide = np.vstack([unit, np.random.default_rng(1).uniform(size=(1_000_000, 3))])
    many = Places(wide, wide)
    begin = time.process_time()
    fit_relevance(many, np.arange(3), PRIOR, *data)
    assert time.process_time() - begin < 2.0  # a tenth of it on a quiet machine
    again = fit_relevance(places, np.arange(3), PRIOR, *data)
    assert np.array_equal(once, again)
