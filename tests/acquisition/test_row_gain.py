"""The gain of a whole row under a posterior that is known: independent Gaussians."""

from dataclasses import dataclass

import numpy as np
import pytest

from mbtl.acquisition import RowGain

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


def gain(seen, std=0.1):
    return RowGain(Known(MEANS, std), TARGETS, BEST, seen, EVEN)


def test_a_model_trusted_beyond_the_best_seen_gains_what_it_predicts():
    """0.9 and 0.8 where 0.5 was reached: nothing caps them."""
    assert gain(np.inf, std=1e-6).expected(TARGETS) == pytest.approx(
        [0, 0.7 / 3, 0.1 / 3], abs=1e-6
    )


def test_nothing_gains_more_than_the_best_seen_nor_than_a_training_on_the_target():
    found = gain(0.7, std=1e-6).by_target(TARGETS)
    assert found[1] == pytest.approx([0.0, 0.2, 0.1], abs=1e-5)  # seen 0.7; 0.6 at home on target 2
    assert gain(0.7).expected(TARGETS)[1] < gain(np.inf).expected(TARGETS)[1]


@pytest.mark.parametrize("seen", [0.7, np.inf])
def test_the_expected_gain_is_the_mean_of_what_is_drawn(seen):
    found = gain(seen)
    for source in TARGETS:
        drawn = found.drawn(int(source))
        error = drawn.std() / np.sqrt(len(drawn))
        assert drawn.mean() == pytest.approx(found.expected(np.array([source]))[0], abs=4 * error)
