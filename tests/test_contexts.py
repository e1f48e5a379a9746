"""Axes and spaces: coordinates and back, what is refused, and that indices stay."""

import json
from decimal import Decimal
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from damage import damaged, refusals
from mbtl.contexts import Categorical, ContextSpace, Integer, Linear, Log, axis_from_json
from mbtl.errors import ContextMismatch, InvalidInput, UnknownName
from mbtl.files import MALFORMED

AXES = [
    (Linear("length", 0.05, 5.0, unit="m"), [0.05, 2.525, 5.0], [0.0, 0.5, 1.0]),
    (Log("mass", 0.1, 10.0, unit="kg"), [0.1, 1.0, 10.0], [0.0, 0.5, 1.0]),
    (Integer("lanes", 1, 5), [1, 3, 5], [0.0, 0.5, 1.0]),
]


@pytest.mark.parametrize(("axis", "values", "unit"), AXES, ids=lambda a: getattr(a, "name", ""))
def test_numeric_axis_maps_to_the_unit_interval(axis, values, unit):
    assert axis.encode(values)[:, 0] == pytest.approx(unit)
    assert axis_from_json(axis.to_json()) == axis
    ends = [axis.low * (1 - 1e-13), axis.high * (1 + 1e-13)]  # rounding there is forgiven
    assert axis.encode(ends)[:, 0] == pytest.approx([0.0, 1.0], abs=1e-12)


def test_categories_are_all_one_apart():
    axis = Categorical("weather", ("dry", "wet", "ice"))
    unit = axis.encode(["dry", "wet", "ice"])
    distances = np.sqrt(((unit[:, None] - unit) ** 2).sum(axis=2))
    assert distances == pytest.approx(1 - np.eye(3))
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


# ---- spaces ---

LENGTH = Linear("length", 0.05, 5.0, unit="m")
MIXED = {
    Log("mass", 0.1, 10.0): 5,
    Categorical("road", ("dry", "wet", "ice")): 3,
    Integer("n", 1, 4): 4,
}
POINTS = ContextSpace.points(
    [LENGTH, Categorical("c", ("a", "b"))],
    [{"length": 1.0, "c": "a"}, {"length": 0.1, "c": "b"}, {"length": 1.0, "c": "b"}],
)


def test_grid_of_one_axis_has_steps_0_to_n_minus_1():
    space = ContextSpace.grid({LENGTH: 100})
    assert space.steps[:, 0] == pytest.approx(np.arange(100))
    assert space.context(9) == {"length": pytest.approx(0.5)}
    assert space.index({"length": 0.5}) == 9


def test_last_axis_of_a_grid_runs_fastest_and_steps_follow_its_values():
    space = ContextSpace.grid({Linear("a", 0, 1): 2, Linear("b", 0, 1): 3})
    assert space.values("b")[:3] == [0.0, 0.5, 1.0]
    assert space.values("a")[:3] == [0.0, 0.0, 0.0]
    uneven = ContextSpace.grid({Linear("x", 0, 10): [0.0, 1.0, 10.0]}, weights=[1, 3, 0])
    assert uneven.weights == pytest.approx([0.25, 0.75, 0.0])
    steps = [uneven.encode_steps({"x": x})[0] for x in (0.5, 5.5)]  # off the grid: interpolated
    assert steps == pytest.approx([0.5, 1.5])


def test_mixed_grid_round_trips_every_index():
    space = ContextSpace.grid(MIXED)
    assert (space.n, space.d, space.unit.shape) == (60, 3, (60, 5))
    for i in range(space.n):
        assert space.index(space.context(i)) == i
        assert space.encode_steps(space.context(i)) == pytest.approx(space.steps[i])


def test_a_coarser_grid_starts_in_the_middle_and_keeps_weights_and_levels():
    space = ContextSpace.grid({LENGTH: 100}, weights=np.arange(100))
    coarse = space.every(5)
    assert coarse.values("length") == space.values("length")[2::5]
    assert coarse.weights == pytest.approx(np.arange(2, 100, 5) / np.arange(2, 100, 5).sum())
    assert space.every(1) == space
    mixed = ContextSpace.grid(MIXED).every(3)
    assert mixed.shape == (2, 3, 1)
    assert mixed.values("n") == [2] * 6
    with pytest.raises(InvalidInput, match="a step of 1 or more"):
        space.every(0)
    with pytest.raises(InvalidInput, match="needs a grid"):
        POINTS.every(2)


@pytest.mark.parametrize(
    "space",
    [
        ContextSpace.grid(MIXED),
        ContextSpace.points([LENGTH], [{"length": 1.0}, {"length": 0.1}], weights=[3, 1]),
        POINTS,
    ],
)
def test_space_survives_json(space):
    again = ContextSpace.from_json(space.to_json())
    assert again == space
    assert np.array_equal(again.unit, space.unit)
    assert np.array_equal(again.weights, space.weights)


def test_a_context_is_described_with_units():
    space = ContextSpace.grid(MIXED | {LENGTH: 2})
    context = {"length": 0.123456, "road": "wet", "n": 3}
    assert space.describe(context) == "length = 0.1235 m, road = wet, n = 3"
    assert space.describe({"wind": 2.0} | context, "\n").splitlines()[0] == "wind = 2"


@pytest.mark.parametrize(
    ("make", "error", "words"),
    [
        (lambda: ContextSpace.points([LENGTH], [{"lenght": 1.0}]), UnknownName, "mean 'length'"),
        (lambda: ContextSpace.points([LENGTH], [{}]), ContextMismatch, "without"),
        (lambda: ContextSpace.points([LENGTH], [{"length": 9.0}]), ContextMismatch, "9.0"),
        (lambda: ContextSpace.points([LENGTH], [{"length": 1.0}] * 2), InvalidInput, "and again"),
        (lambda: ContextSpace.points([LENGTH], []), InvalidInput, "got none"),
        (lambda: ContextSpace.grid({LENGTH: [1.0, 1.0]}), InvalidInput, "strictly increasing"),
        (lambda: ContextSpace.grid({LENGTH: 2}, weights=[1, -1]), InvalidInput, ">= 0"),
        (lambda: ContextSpace.grid({LENGTH: 2}, weights=["a", "b"]), InvalidInput, "finite num"),
        (lambda: ContextSpace.grid({LENGTH: 2}, weights=[1, np.nan]), InvalidInput, ">= 0"),
        (lambda: ContextSpace.grid({LENGTH: 2}, weights=[0, 0]), InvalidInput, "positive sum"),
        (lambda: ContextSpace.grid({LENGTH: 2.5}), InvalidInput, "or the values, got 2.5"),
        (lambda: ContextSpace.grid({LENGTH: ["0.1", "0.2"]}), ContextMismatch, "got '0.1'"),
        (lambda: ContextSpace.points([LENGTH], [{"length": 1.0, "w": 2}]), UnknownName, "'w'"),
        (lambda: ContextSpace.grid({}), InvalidInput, "one or more axes"),
        (lambda: ContextSpace.grid([LENGTH]), InvalidInput, "grid takes axes as {Linear"),
        (lambda: ContextSpace.grid(LENGTH), InvalidInput, "grid takes axes as {Linear"),
        (lambda: ContextSpace.points({"length": 1.0}, [{}]), InvalidInput, "got {'length': 1.0}"),
        (lambda: ContextSpace.points({LENGTH: 3}, [{}]), InvalidInput, r"points takes axes as \["),
        (lambda: ContextSpace.points(LENGTH, [{}]), InvalidInput, r"points takes axes as \["),
        (lambda: ContextSpace.grid({LENGTH: 3}).context(3), InvalidInput, "0 to 2"),
        (lambda: ContextSpace.grid({LENGTH: 3}).index({"length": 1.0}), ContextMismatch, "nearest"),
        (lambda: ContextSpace.grid({LENGTH: 3}).nearest({"mass": 1.0}), UnknownName, "mass"),
        (lambda: ContextSpace.grid({LENGTH: 3}).values("mass"), UnknownName, "mass"),
    ],
)
def test_bad_contexts_are_refused_with_the_reason(make, error, words):
    with pytest.raises(error, match=words):
        make()


@settings(max_examples=30)
@given(st.lists(st.floats(0.05, 5.0), min_size=1, max_size=30, unique_by=lambda x: round(x, 6)))
def test_any_distinct_points_keep_their_indices(values):
    space = ContextSpace.points([LENGTH], [{"length": v} for v in values])
    assert [space.index({"length": v}) for v in values] == list(range(len(values)))


def test_contexts_of_whole_numbers_given_as_others_are_whole():
    space = ContextSpace.points(
        [Integer("n", 1, 9), LENGTH], [{"n": 3.0, "length": np.float32(0.5)}, {"n": 4, "length": 1}]
    )
    assert space.contexts == [{"n": 3, "length": 0.5}, {"n": 4, "length": 1}]
    assert [type(c["n"]) for c in space.contexts] == [int, int]
    assert space.index({"n": np.int64(3), "length": np.float32(0.5)}) == 0
    assert ContextSpace.from_json(json.loads(json.dumps(space.to_json()))) == space


SINGLE, DOUBLE = np.linspace(0.1, 0.7, 7, dtype=np.float32), np.linspace(0.1, 0.7, 7)


@pytest.mark.parametrize(
    ("axis", "own", "asked"),
    [
        (Linear("x", 0.1, 0.7), DOUBLE, SINGLE),  # the last float32 lies outside the axis
        (Linear("x", 0.1, 0.7), SINGLE, DOUBLE),
        (Linear("x", -500.0, 0.7), DOUBLE, 1e3 + SINGLE - np.float32(1e3)),
        (Log("x", 0.1, 0.7), DOUBLE, SINGLE),
        (Log("x", 0.1, 0.7), SINGLE, DOUBLE),
        (Categorical("x", tuple(DOUBLE)), DOUBLE, SINGLE),
        (Categorical("x", tuple(SINGLE.tolist())), SINGLE.tolist(), DOUBLE),
        (Integer("x", 1, 7), range(1, 8), np.arange(1, 8, dtype=np.float32)),
        (Integer("x", 1, 7), range(1, 8), 10 * SINGLE),
    ],
)
def test_contexts_in_single_precision_are_those_of_the_space(axis, own, asked):
    space = ContextSpace.grid({axis: list(own)})
    assert [space.index({"x": value}) for value in asked] == list(range(7))


def test_what_single_precision_cannot_tell_apart_is_found_exactly_or_not_at_all():
    space = ContextSpace.grid({Linear("time", 0.0, 1e9): [1e9 - 20.0, 1e9 - 10.0, 1e9]})
    assert [space.index({"time": value}) for value in space.values("time")] == [0, 1, 2]
    with pytest.raises(ContextMismatch, match="is not one of the 3 contexts"):
        space.index({"time": 1e9 - 15.0})


def test_any_damage_to_a_stored_space_gets_a_sentence_from_whoever_reads_it():
    whole = [ContextSpace.grid(MIXED, weights=np.arange(60)).to_json(), POINTS.to_json()]

    def attempt(seed):
        try:
            space = ContextSpace.from_json(damaged(whole[seed % 2], seed))
        except MALFORMED as error:
            raise InvalidInput(str(error)) from error
        for context in space.contexts[:3]:
            space.index(context), space.encode_steps(context), space.describe(context)

    assert refusals(attempt, 300) > 150


def test_any_context_gets_coordinates_or_a_sentence():
    space = ContextSpace.grid(MIXED)

    def attempt(seed):
        context = damaged(space.context(seed % space.n), seed)
        context = np.array(context) if seed % 17 == 0 else context
        assert np.isfinite(space.encode_steps(context)).all()
        assert np.isfinite(space.encode(context)).all()

    assert refusals(attempt, 300) > 150


def test_a_grid_that_no_memory_holds_is_refused_before_it_is_made():
    x, y = (Linear(name, 0.0, 1.0) for name in "xy")
    for axes in ({x: 2**31}, {x: 100_000, y: 100_000}):
        with pytest.raises(InvalidInput, match="10,000,000"):
            ContextSpace.grid(axes)
    record = ContextSpace.grid({x: 3}).to_json()
    with pytest.raises(InvalidInput, match="as to_json gives it"):
        ContextSpace.from_json({**record, "grid": [3]})
