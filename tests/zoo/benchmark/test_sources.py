"""Matrices of which only some contexts were trained on: all are targets, some are sources."""

from itertools import permutations

import numpy as np
import pytest

from mbtl.errors import InvalidInput
from mbtl.objective import value_curve
from mbtl.selectors import get_selector, selector_names
from mbtl.selectors.base import Exhausted
from mbtl.zoo.benchmark import TransferMatrix, compare, nominal_source, reference_levels
from mbtl.zoo.benchmark.base import levels
from mbtl.zoo.benchmark.oracle import random_curve, sequential_oracle
from mbtl.zoo.benchmark.replay import replay

SOURCES = [0, 2, 5, 7]


@pytest.fixture
def matrix():
    rng = np.random.default_rng(0)
    returns, fresh = rng.uniform(0.1, 0.9, (2, 2, 4, 8))
    return TransferMatrix.of(returns, fresh_returns=fresh, sources=SOURCES, bounds=(0, 1))


def test_rows_are_found_by_context(matrix):
    assert (matrix.n, matrix.n_seeds) == (8, 2)
    np.testing.assert_array_equal(matrix.rows(1, [7, 2]), matrix.returns[1, [3, 1]])
    np.testing.assert_array_equal(matrix.fresh_rows(0, [5]), matrix.fresh_returns[0, [2]])
    with pytest.raises(InvalidInput, match="no training on context 3"):
        matrix.rows(0, [2, 3])
    whole = TransferMatrix.of(np.zeros((1, 8, 8)), bounds=(0, 1))
    for each in matrix, whole:
        for seed, sources, words in (
            (-1, [2], f"seeds run from 0 to {each.n_seeds - 1}, got -1"),
            (0.5, [2], "seed must be a whole number, got 0.5"),
            (0, [-1], r"indices of contexts, from 0 to 7, got \[-1\]"),
            (0, [2.0], "indices of contexts"),
            (0, [8], "no training on context 8"),
        ):
            with pytest.raises(InvalidInput, match=words):
                each.rows(seed, sources)
        with pytest.raises(InvalidInput, match="seeds run from"):
            each.performance(2)


@pytest.mark.parametrize(("nominal", "source"), [(3.1, 2), (3.9, 5), (5.0, 5), (0.9, 0)])
def test_the_nominal_policy_is_of_the_nearest_context_trained_on(nominal, source):
    known = {"sources": SOURCES, "contexts": np.arange(8.0)[:, None], "axes": ["x"]}
    returns = np.random.default_rng(0).uniform(0.1, 0.9, (1, 4, 8))
    matrix = TransferMatrix.of(
        returns, **known, bounds=(0, 1), provenance={"nominal": {"x": nominal}}
    )
    assert nominal_source(matrix) == source
    shown = reference_levels(matrix, 0)["nominal_policy"]
    assert shown == pytest.approx(returns[0, SOURCES.index(source)].mean())


def test_levels_are_of_the_sources(matrix):
    seen, fresh = matrix.returns[0], matrix.fresh_returns[0]
    known = levels(matrix, 0)
    assert known.independent == pytest.approx(np.mean([fresh[i, s] for i, s in enumerate(SOURCES)]))
    assert known.grand_mean == pytest.approx(fresh.mean())
    assert known.oracle_transfer == pytest.approx(fresh[seen.argmax(axis=0), np.arange(8)].mean())


def test_the_oracle_and_random_know_the_sources_only(matrix):
    plain = TransferMatrix.of(matrix.returns, sources=SOURCES, bounds=(0, 1))
    oracle = sequential_oracle(plain, 0, 4)
    assert oracle.sources[0] == SOURCES[plain.returns[0].mean(axis=1).argmax()]
    assert sorted(oracle.sources) == SOURCES
    curves = [
        value_curve(plain.rows(0, order), np.full(8, 0.125)) for order in permutations(SOURCES)
    ]
    np.testing.assert_allclose(random_curve(plain, 0, 4), np.mean(curves, axis=0))


@pytest.mark.parametrize("name", selector_names())
def test_every_selector_proposes_sources_only_and_all_of_them(matrix, name):
    found = replay(get_selector(name), matrix.problem(4), lambda i: matrix.rows(0, [i])[0])
    assert sorted(found.history.sources) == SOURCES
    with pytest.raises(Exhausted, match="all 4 contexts"):
        get_selector(name).propose(matrix.problem(4), found.history, np.random.default_rng(0))


def test_a_comparison_runs_on_it(matrix):
    found = compare(["specialists", "random", "oracle"], [matrix], budget=3, seeds=2)
    assert all(set(run.sources) <= set(SOURCES) for run in found.results)
    with pytest.raises(InvalidInput, match=r"trainable contexts \(4\)"):
        matrix.problem(5)
