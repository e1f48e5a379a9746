import numpy as np
import pytest

from mbtl.contexts import Categorical, ContextSpace, Integer, Linear, Log
from mbtl.errors import InvalidInput
from mbtl.models.columns import Columns
from mbtl.models.transfer_kernel import Places


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
