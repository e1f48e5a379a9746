from decimal import Decimal
from fractions import Fraction

import numpy as np
import pytest

from mbtl.contexts import Categorical, Integer, Linear, Log, axis_from_json
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
    assert axis_from_json(axis.to_json()) == axis
    ends = [axis.low * (1 - 1e-13), axis.high * (1 + 1e-13)]  # rounding there is forgiven
    assert axis.encode(ends)[:, 0] == pytest.approx([0.0, 1.0], abs=1e-12)


def test_categories_are_all_one_apart():
    axis = Categorical("weather", ("dry", "wet", "ice"))
    unit = axis.encode(["dry", "wet", "ice"])
    distances = np.sqrt(((unit[:, None] - unit) ** 2).sum(axis=2))
    assert distances == pytest.approx(1 - np.eye(3))
    assert axis.decode(unit) == ["dry", "wet", "ice"]
    assert axis_from_json(axis.to_json()) == axis


@pytest.mark.parametrize(
    ("axis", "value", "rule"),
    [
        (Linear("length", 0.0, 1.0), 1.1, r"\[0, 1\].*1\.1"),
        (Linear("length", 0.0, 1.0), float("nan"), "nan"),
        (Linear("length", 0.0, 1.0), "long", "numbers"),
        (Integer("lanes", 1, 5), 2.5, "whole numbers"),
        (Linear("length", 0.0, 1.0), "0.5", "finite numbers, got '0.5'"),
        (Linear("length", 0.0, 1.0), None, "finite numbers, got None"),
        (Linear("length", 0.0, 1.0), float("-inf"), "finite numbers, got -inf"),
        (Linear("length", 0.0, 1.0), 1j, "finite numbers"),
        (Linear("length", 0.0, 1.0), [0.5], "finite numbers"),
        (Linear("length", 0.0, 1.0), 10**400, "finite numbers"),
        (Log("rate", 1e-6, 1e3), 9e-7, r"\[1e-06, 1000\].*9e-07"),
        (Log("rate", 1e-6, 1e3), 0.0, r"got 0\.0"),
        (Log("rate", 1e-6, 1e3), -1e-7, r"got -1e-07"),
        (Log("rate", 1e-6, 1e3), 1000.001, r"got 1000\.001"),
        (Integer("id", 0, 10**10), 10**10 + 5, r"10000000005"),
        (Integer("lanes", 1, 5), float("nan"), "numbers, got nan"),
        (Categorical("c", ("a", "b")), "d", "one of"),
        (Categorical("c", ("a", "b")), ["a"], "one of"),
        (Categorical("c", ("a", 1)), np.array([1, 1]), "one of"),
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
        lambda: Linear("x", -1e308, 1e308),
        lambda: Linear("x", "0", 1),
        lambda: Linear("x", 0, 1, unit=3),
        lambda: Log("x", 1e-300, 1e300),
        lambda: Categorical("x", "ab"),
        lambda: Categorical("x", (1.0, float("nan"))),
        lambda: Categorical("x", ("a", ["b"])),
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


def test_values_are_kept_as_pythons_own_and_whole_ones_as_whole():
    values = [np.float64(2.0), 3, np.int32(4), np.array(5), Fraction(1), Decimal(2)]
    for axis, kind in ((Linear("x", 0, 9), float), (Integer("n", 0, 9), int)):
        own = axis.own(values)
        assert own == [2, 3, 4, 5, 1, 2]
        assert {type(value) for value in own} <= {kind, int}
    assert type(Integer("n", 0, 9).own([3.0])[0]) is int
    level = Categorical("c", (np.int64(1), "a")).own([np.float64(1.0), np.str_("a")])
    assert [type(value) for value in level] == [int, str]


def test_log_axis_spreads_evenly_in_ratio():
    values = np.array(Log("x", 0.1, 10.0).spread(5))
    assert values[1:] / values[:-1] == pytest.approx(np.sqrt(10) * np.ones(4))
