"""Summaries by hand: levels, censoring, ratios of sums, paired intervals."""

import json

import numpy as np
import pytest

from mbtl.zoo.benchmark import summarise
from mbtl.zoo.benchmark.base import Levels
from mbtl.zoo.benchmark.oracle import OracleRun, Reference


def ref(random, oracle, *, grand=0.0, independent=0.5, top=1.0):
    run = OracleRun(tuple(range(len(oracle))), np.array(oracle, dtype=float), 0.0)
    return Reference(Levels(independent, top, grand), np.array(random, dtype=float), run)


def one(curves, refs, name="s"):
    return summarise({"m": {name: np.array(curves)}}, {"m": refs}).matrices["m"].selectors[name]


def test_values_and_closed_fraction_by_hand():
    s = one([[0.3, 0.6], [0.5, 0.7]], [ref([0.1, 0.4], [0.5, 0.8]), ref([0.2, 0.5], [0.6, 0.9])])
    assert s.V_K.value == pytest.approx(0.65)
    assert s.V_mean.value == pytest.approx((0.45 + 0.6) / 2)
    assert s.minus_random_at_K.value == pytest.approx(0.2)
    assert s.closed_at_K.value == pytest.approx((0.2 + 0.2) / (0.4 + 0.4))
    assert s.closed_under_curve.value == pytest.approx((0.2 + 0.2 + 0.3 + 0.2) / (0.4 * 4))


def test_closed_fraction_is_a_ratio_of_sums_not_a_mean_of_ratios():
    # the second seed has hardly any room: its ratio alone would be -10
    refs = [ref([0.0], [0.5]), ref([0.5], [0.501])]
    assert one([[0.25], [0.49]], refs).closed_at_K.value == pytest.approx(0.24 / 0.501)


def test_trainings_are_counted_from_one_and_reached_levels_include_equality():
    curve = [[0.2, 0.5, 0.9, 0.95, 0.99]]
    s = one(curve, [ref([0] * 5, [1] * 5)])
    assert (s.k_star.per_seed, s.k90.per_seed) == ((2,), (3,))
    assert (s.k95.per_seed, s.k99.per_seed) == ((4,), (5,))
    assert s.k90.estimate.value == pytest.approx(3)


def test_censored_seeds_show_none_and_enter_as_one_more_than_the_budget():
    refs = [ref([0, 0], [1, 1])] * 2
    s = one([[0.1, 0.9], [0.1, 0.2]], refs)
    assert s.k90.per_seed == (2, None)
    assert s.k90.censored == 1
    assert s.k90.estimate.value == pytest.approx(np.sqrt(2 * 3))
    assert s.k99.censored == 2
    assert s.k99.estimate.value is None


def test_pooling_counts_each_matrix_once_and_needs_intervals_of_all():
    curves = {"a": {"s": np.array([[0.2], [0.4]])}, "b": {"s": np.array([[0.9]])}}
    references = {"a": [ref([0.1], [0.5])] * 2, "b": [ref([0.8], [1.0])]}
    summary = summarise(curves, references)
    s = summary.pooled["s"]
    assert s.V_K.value == pytest.approx((0.3 + 0.9) / 2)
    assert s.closed_at_K.value == pytest.approx((0.2 + 0.1) / (0.4 + 0.2))
    assert s.k90.per_seed == (None, None, 1)
    assert s.k90.estimate.value == pytest.approx(np.sqrt(2 * 1))
    assert summary.matrices["a"].n_seeds == 2
    assert summary.matrices["a"].selectors["s"].V_K.low == pytest.approx(0.2)
    assert summary.matrices["b"].selectors["s"].V_K.low is None  # one seed has no interval
    assert s.V_K.low is None


def test_interval_of_many_seeds_is_that_of_a_mean():
    rng = np.random.default_rng(0)
    values = rng.normal(0.6, 0.1, size=(200, 1))
    s = one(values, [ref([0.5], [0.9])] * 200)
    error = 1.96 * values.std() / np.sqrt(200)
    assert s.V_K.low == pytest.approx(values.mean() - error, abs=0.1 * error)
    assert s.V_K.high == pytest.approx(values.mean() + error, abs=0.1 * error)


def test_differences_are_paired_seeds_common_scatter_cancels():
    base = np.linspace(0.2, 0.8, 10)
    refs = [ref([v], [v + 0.1]) for v in base]
    s = one((base + 0.05)[:, None], refs)
    assert s.V_K.high - s.V_K.low > 0.1
    assert (s.minus_random_at_K.low, s.minus_random_at_K.high) == pytest.approx((0.05, 0.05))
    assert (s.closed_at_K.low, s.closed_at_K.high) == pytest.approx((0.5, 0.5))


def test_the_record_is_plain_json():
    summary = summarise({"m": {"s": np.array([[0.3, 0.6]])}}, {"m": [ref([0.1, 0.2], [0.5, 0.8])]})
    document = json.loads(json.dumps(summary.to_json(), allow_nan=False))
    entry = document["matrices"]["m"]["selectors"]["s"]
    assert set(entry) == {
        "V_K", "V_mean", "k_star", "k90", "k95", "k99", "minus_random", "closed_fraction",
    }  # fmt: skip
    assert set(entry["closed_fraction"]) == {"at_K", "under_curve"}
    assert document["matrices"]["m"]["curves"]["random"] == [0.1, 0.2]
    assert set(document["pooled"]) == {"s"}
