"""The Sequential Oracle and Random's exact expectation, against full search and enumeration."""

import math

import numpy as np
import pytest

from mbtl.contexts import ContextSpace, Linear
from mbtl.errors import InvalidInput
from mbtl.zoo.benchmark import TransferMatrix, sequential_oracle
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


def test_budget_must_fit():
    with pytest.raises(InvalidInput, match="budget"):
        sequential_oracle(noisy(3), 0, 4)
    with pytest.raises(InvalidInput, match="budget"):
        random_weights(3, 4)
