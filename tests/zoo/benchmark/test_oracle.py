"""The Sequential Oracle and Random's exact expectation, against full search and enumeration."""

import itertools
import math

import numpy as np
import pytest

from mbtl.contexts import ContextSpace, Linear
from mbtl.errors import InvalidInput
from mbtl.objective import regret
from mbtl.zoo.benchmark import (
    TransferMatrix,
    levels,
    linear_gap_world,
    random_curve,
    reference,
    sequential_oracle,
    synthetic_world,
)
from mbtl.zoo.benchmark import base as base_module
from mbtl.zoo.benchmark import oracle as oracle_module
from mbtl.zoo.benchmark.oracle import random_weights


def noisy(n, seeds=1, weights=None, seed=3):
    returns = np.random.default_rng(seed).normal(size=(seeds, n, n))
    space = ContextSpace.grid({Linear("x", 0, 1): n}, weights=weights)
    return TransferMatrix.of(returns, space=space)


def full_search(matrix, weights, budget):
    best, picks, curve = np.full(len(matrix), -np.inf), [], []
    for _ in range(budget):
        values = [np.average(np.maximum(row, best), weights=weights) for row in matrix]
        picks.append(int(np.argmax(values)))
        best = np.maximum(best, matrix[picks[-1]])
        curve.append(np.average(best, weights=weights))
    return picks, curve


def test_oracle_vector_of_the_linear_gap_world():
    run = sequential_oracle(linear_gap_world(), 0, 15)
    assert run.sources == (49, 82, 16, 32, 65, 93, 5, 40, 74, 23, 56, 10, 87, 97, 1)
    assert run.curve[-1] == pytest.approx(0.8911, abs=1e-12)
    assert run.curve[3] == pytest.approx(0.86515, abs=1e-12)


def test_the_vector_hangs_on_rounding_at_one_pick_only():
    # In whole steps 73 and 74 tie at the ninth pick; every value is the same whichever is taken.
    i = np.arange(100)
    whole = -np.abs(i[:, None] - i)
    best = whole[[49, 82, 16, 32, 65, 93, 5, 40]].max(axis=0)
    totals = np.maximum(whole, best).sum(axis=1)
    assert np.flatnonzero(totals == totals.max()).tolist() == [73, 74]


@pytest.mark.parametrize("weights", [None, np.arange(1, 31)])
def test_lazy_search_equals_full_search(weights, monkeypatch):
    matrix = noisy(30, weights=weights)
    monkeypatch.setattr(oracle_module, "BLOCK_BYTES", 16 * 30 * 4)  # blocks of four rows
    run = sequential_oracle(matrix, 0, 30)
    picks, curve = full_search(matrix.performance(0), weights, 30)
    gains = np.diff(curve)
    decided = 1 + int(np.argmin(gains > 1e-9))  # later picks gain nothing and are arbitrary
    assert list(run.sources[:decided]) == picks[:decided]
    assert run.curve == pytest.approx(curve)
    assert sorted(run.sources) == list(range(30))


def test_lazy_search_skips_most_rows(monkeypatch):
    world = synthetic_world("synthetic:3d-const-none-l1-eta0")
    asked = []
    rows = type(world).rows
    monkeypatch.setattr(
        type(world), "rows", lambda self, s, i: asked.append(len(i)) or rows(self, s, i)
    )
    monkeypatch.setattr(oracle_module, "BLOCK_BYTES", 16 * 512 * 32)
    sequential_oracle(world, 0, 20)
    assert sum(asked) < 0.6 * 20 * 512


def test_the_oracle_has_no_regret():
    matrix = noisy(20)
    assert regret(matrix.performance(0), sequential_oracle(matrix, 0, 8).sources) == pytest.approx(
        np.zeros(8), abs=1e-12
    )


def test_myopic_is_not_optimal():
    # two specialists beat the generalist that greedy takes first
    matrix = TransferMatrix.of(
        [[[1.0, 1.0, 0.0, 0.0], [0.7, 0.7, 0.7, 0.7], [0.0, 0.0, 1.0, 1.0], [0.0] * 4]],
        bounds=(0, 1),
    )
    run = sequential_oracle(matrix, 0, 2)
    assert run.sources == (1, 0)
    assert run.curve[-1] < matrix.oracle_transfer[0]


def test_random_weights_are_the_binomial_ratio():
    for n, budget in ((1, 1), (7, 7), (40, 12)):
        exact = [
            [math.comb(n - r, k - 1) / math.comb(n, k) for r in range(1, n + 1)]
            for k in range(1, budget + 1)
        ]
        assert random_weights(n, budget) == pytest.approx(np.array(exact), rel=1e-12, abs=0)


def test_random_weights_stay_exact_where_binomials_overflow():
    weights = random_weights(16384, 50)
    assert weights.sum(axis=1) == pytest.approx(np.ones(50), abs=1e-11)
    exact = math.comb(16384 - 900, 49) / math.comb(16384, 50)  # integers, then one division
    assert weights[49, 899] == pytest.approx(exact, rel=1e-11)


@pytest.mark.parametrize("weights", [None, [1, 2, 3, 4, 5, 6]])
def test_random_curve_equals_enumeration_of_all_subsets(weights):
    matrix = noisy(6, weights=weights)
    j = matrix.performance(0)
    for k, value in enumerate(random_curve(matrix, 0, 6), start=1):
        subsets = itertools.combinations(range(6), k)
        values = [np.average(j[list(s)].max(axis=0), weights=weights) for s in subsets]
        assert value == pytest.approx(np.mean(values), abs=1e-12)


def test_random_curve_agrees_with_monte_carlo():
    matrix = noisy(50)
    j = matrix.performance(0)
    rng = np.random.default_rng(0)
    orders = np.array([rng.permutation(50)[:8] for _ in range(4000)])
    curves = np.maximum.accumulate(j[orders], axis=1).mean(axis=2)
    error = curves.std(axis=0) / np.sqrt(len(curves))
    assert (np.abs(curves.mean(axis=0) - random_curve(matrix, 0, 8)) < 4.5 * error).all()


def test_random_starts_at_the_grand_mean_and_ends_at_oracle_transfer():
    matrix = noisy(12)
    known = reference(matrix, 0, 12)
    assert known.random[0] == pytest.approx(known.levels.grand_mean)
    assert known.random[-1] == pytest.approx(known.levels.oracle_transfer)
    assert known.oracle.curve[-1] == pytest.approx(known.levels.oracle_transfer)
    assert (np.diff(known.random) >= 0).all()


def test_small_blocks_change_nothing(monkeypatch):
    world = synthetic_world("synthetic:1d-lin-lin-nd-eta15")
    whole = reference(world, 1, 10)
    blocks = base_module.row_blocks
    monkeypatch.setattr(oracle_module, "BLOCK_BYTES", 8 * 100 * 7)
    monkeypatch.setattr(
        base_module,
        "row_blocks",
        lambda source, seed, block_bytes=0: blocks(source, seed, block_bytes=8 * 100 * 3),
    )
    small = reference(world, 1, 10)
    assert small.oracle.sources == whole.oracle.sources
    assert small.random == pytest.approx(whole.random, abs=1e-14)
    assert small.levels.oracle_transfer == whole.levels.oracle_transfer
    assert levels(world, 1).grand_mean == pytest.approx(whole.levels.grand_mean, abs=1e-14)


def test_budget_must_fit():
    with pytest.raises(InvalidInput, match="budget"):
        sequential_oracle(noisy(3), 0, 4)
    with pytest.raises(InvalidInput, match="budget"):
        random_weights(3, 4)
