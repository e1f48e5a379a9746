import numpy as np
import pytest

from mbtl.contexts import Categorical, Integer, Linear, Log
from mbtl.contexts.axes import axis_from_json
from mbtl.errors import ContextMismatch, InvalidInput

AXES = [
    (Linear("length", 0.05, 5.0, unit="m"), [0.05, 2.525, 5.0], [0.0, 0.5, 1.0]),
    (Log("mass", 0.1, 10.0, unit="kg"), [0.1, 1.0, 10.0], [0.0, 0.5, 1.0]),
    (Integer("lanes", 1, 5), [1, 3, 5], [0.0, 0.5, 1.0]),
]


@pytest.mark.parametrize(("axis", "values", "unit"), AXES, ids=lambda a: getattr(a, "name", ""))
def test_numeric_axis_maps_to_the_unit_interval_and_back(axis, values, unit):
    assert axis.encode(values)[:, 0] == pytest.approx(unit)
    assert axis.decode(np.array(unit)[:, None]) == pytest.approx(values)


def test_categories_are_all_one_apart():
    axis = Categorical("weather", ("dry", "wet", "ice"))
    unit = axis.encode(["dry", "wet", "ice"])
    distances = np.sqrt(((unit[:, None] - unit) ** 2).sum(axis=2))
    assert distances == pytest.approx(1 - np.eye(3))
    assert axis.decode(unit) == ["dry", "wet", "ice"]


@pytest.mark.parametrize(
    "axis", [*(a for a, _, _ in AXES), Categorical("c", ("a", 1))], ids=lambda a: a.name
)
def test_axis_survives_json(axis):
    assert axis_from_json(axis.to_json()) == axis


@pytest.mark.parametrize(
    ("axis", "value", "rule"),
    [
        (Linear("length", 0.0, 1.0), 1.1, r"\[0, 1\].*1\.1"),
        (Linear("length", 0.0, 1.0), float("nan"), "nan"),
        (Linear("length", 0.0, 1.0), "long", "numbers"),
        (Integer("lanes", 1, 5), 2.5, "whole numbers"),
        (Categorical("c", ("a", "b")), "d", "one of"),
    ],
)
def test_a_value_off_the_axis_is_refused(axis, value, rule):
    with pytest.raises(ContextMismatch, match=rule):
        axis.encode([value])


@pytest.mark.parametrize(
    "make",
    [
        lambda: Linear("x", 1.0, 1.0),
        lambda: Linear("", 0.0, 1.0),
        lambda: Linear("x", 0.0, float("inf")),
        lambda: Log("x", 0.0, 1.0),
        lambda: Categorical("x", ("a",)),
        lambda: Categorical("x", ("a", "a")),
        lambda: Integer("x", 1, 3).spread(5),
        lambda: Categorical("x", ("a", "b")).spread(3),
    ],
)
def test_an_impossible_axis_is_refused(make):
    with pytest.raises(InvalidInput):
        make()


def test_log_axis_spreads_evenly_in_ratio():
    values = np.array(Log("x", 0.1, 10.0).spread(5))
    assert values[1:] / values[:-1] == pytest.approx(np.sqrt(10) * np.ones(4))
