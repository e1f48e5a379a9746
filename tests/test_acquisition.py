"""Acquisition: closed answers, also under a posterior that is known: independent Gaussians."""

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.stats import norm

from mbtl.acquisition import RowGain, argmax_open, expected_gain, optimistic_gain
from mbtl.errors import InvalidInput

LINE = np.arange(3.0)[:, None]


def gain(upper, best, theta, where=LINE, weights=None):
    weights = np.full(len(where), 1 / len(where)) if weights is None else weights
    return optimistic_gain(
        np.asarray(upper, float), where, where, np.asarray(best, float), weights, theta=theta
    )


def test_gain_counts_only_the_improved_targets_by_their_weight():
    # from target 0 with 0.9 and slope 0.3: 0.9, 0.6, 0.3 against 0.5, 0.7, 0.2
    assert gain([0.9, 0, 0], [0.5, 0.7, 0.2], 0.3)[0] == pytest.approx((0.4 + 0.0 + 0.1) / 3)
    weights = np.array([0.5, 0.5, 0.0])
    assert gain([0.9, 0, 0], [0.5, 0.7, 0.2], 0.3, weights=weights)[0] == pytest.approx(0.2)
    assert gain([0.5] * 3, [0.6] * 3, 0.1) == pytest.approx([0.0] * 3)


def test_distance_is_euclidean_in_steps():
    where = np.array([[0.0, 0.0], [3.0, 4.0]])
    weights = np.array([0.0, 1.0])
    assert gain([1.0, 0.0], [0.0, 0.0], 0.1, where, weights)[0] == pytest.approx(0.5)


def test_expected_gain_is_the_expectation_of_the_gain():
    rng = np.random.default_rng(0)
    mean, std, best = np.array([0.6]), np.array([0.2]), np.array([0.5, 0.7, 0.2])
    weights = np.array([0.2, 0.3, 0.5])
    exact = expected_gain(mean, std, LINE[:1], LINE, best, weights, theta=0.1)[0]
    draws = rng.normal(0.6, 0.2, 400_000)
    sampled = (np.maximum(draws[:, None] - 0.1 * LINE[:, 0] - best, 0) @ weights).mean()
    assert exact == pytest.approx(sampled, abs=5e-4)


def test_expected_gain_without_uncertainty_is_the_plain_gain():
    upper, best, weights = np.array([0.9, 0.4, 0.8]), np.array([0.5, 0.7, 0.2]), np.full(3, 1 / 3)
    exact = expected_gain(upper, np.zeros(3), LINE, LINE, best, weights, theta=0.3)
    assert exact == pytest.approx(gain(upper, best, 0.3))


@pytest.mark.parametrize("z", [-30.0, -8.0, -1.0, 0.0, 2.0, 30.0])
def test_improvement_keeps_its_digits_in_the_tail(z):
    one = np.ones(1)
    got = expected_gain(z * one, one, LINE[:1], LINE[:1], 0 * one, one, theta=0.0)[0]
    # for z << 0, z Phi(z) + phi(z) = phi(z) (1/z^2 - 3/z^4 + ...)
    expected = z * norm.cdf(z) + norm.pdf(z)
    if z <= -8:
        expected = norm.pdf(z) * (1 / z**2 - 3 / z**4 + 15 / z**6 - 105 / z**8)
    assert got == pytest.approx(expected, rel=2e-3)
    assert got > 0


def test_blocks_do_not_change_the_result(monkeypatch):
    rng = np.random.default_rng(1)
    where = rng.uniform(0, 5, (50, 2))
    upper, best = rng.normal(size=50), rng.normal(size=50)
    whole = gain(upper, best, 0.2, where)
    monkeypatch.setattr("mbtl.acquisition._BLOCK_ENTRIES", 64)
    assert gain(upper, best, 0.2, where) == pytest.approx(whole, abs=1e-15)


def test_a_negative_theta_is_refused():
    with pytest.raises(InvalidInput, match=r"theta must be finite and >= 0, got -0.1"):
        gain([1] * 3, [0] * 3, -0.1)


def test_the_argmax_is_the_lowest_of_equals_among_what_is_open():
    assert argmax_open(np.array([0.1, 0.3, 0.3 + 1e-16, 0.2]), np.ones(4, bool)) == 1
    assert argmax_open(np.array([9.0, 1.0, 2.0]), np.array([False, True, True])) == 2
    with pytest.raises(InvalidInput, match="none"):
        argmax_open(np.zeros(2), np.zeros(2, bool))
    with pytest.raises(InvalidInput, match="NaN"):
        argmax_open(np.array([0.0, np.nan]), np.ones(2, bool))


# ---- of whole rows ---

TARGETS = np.arange(3)
EVEN = np.full(3, 1 / 3)


@dataclass(frozen=True)
class Known:
    """Every pair of a source has its mean and the same deviation."""

    means: np.ndarray
    std: float

    def predict(self, sources, targets):
        mean = self.means[np.ix_(sources, targets)]
        return mean, np.full(mean.shape, self.std)

    def predict_pairs(self, pairs):
        mean = self.means[pairs[:, 0], pairs[:, 1]]
        return mean, np.full(mean.shape, self.std)

    def draws(self, sources, targets, n, rng):
        mean = self.predict(sources, targets)[0]
        return mean + self.std * rng.standard_normal((n, *mean.shape))


MEANS = np.array([[0.5, 0.4, 0.3], [0.4, 0.9, 0.8], [0.2, 0.3, 0.6]])
BEST = np.array([0.5, 0.5, 0.5])


def row_gain(seen, std=0.1):
    return RowGain(Known(MEANS, std), TARGETS, BEST, seen, EVEN)


def test_a_model_trusted_beyond_the_best_seen_gains_what_it_predicts():
    """0.9 and 0.8 where 0.5 was reached: nothing caps them."""
    assert row_gain(np.inf, std=1e-6).expected(TARGETS) == pytest.approx(
        [0, 0.7 / 3, 0.1 / 3], abs=1e-6
    )


def test_nothing_gains_more_than_the_best_seen_nor_than_a_training_on_the_target():
    found = row_gain(0.7, std=1e-6).by_target(TARGETS)
    assert found[1] == pytest.approx([0.0, 0.2, 0.1], abs=1e-5)  # seen 0.7; 0.6 at home on target 2
    assert row_gain(0.7).expected(TARGETS)[1] < row_gain(np.inf).expected(TARGETS)[1]


@pytest.mark.parametrize("seen", [0.7, np.inf])
def test_the_expected_gain_is_the_mean_of_what_is_drawn(seen):
    found = row_gain(seen)
    for source in TARGETS:
        rng = np.random.default_rng(0)
        rows = found.model.draws(np.array([source]), found.targets, 4000, rng)[:, 0]
        drawn = found._gained(np.minimum(rows, found._top(rng.standard_normal((4000, 1)))))
        error = drawn.std() / np.sqrt(len(drawn))
        assert drawn.mean() == pytest.approx(found.expected(np.array([source]))[0], abs=4 * error)
