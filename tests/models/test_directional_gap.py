"""The directional gap: slopes of noiseless worlds, and the gain as a double sum."""

import numpy as np
import pytest

from mbtl.contexts import ContextSpace, Linear
from mbtl.models.directional_gap import DirectionalGap, fit_directional_gap


def grid(*levels):
    return ContextSpace.grid({Linear(f"x{q}", 0, 1): n for q, n in enumerate(levels)})


def piecewise(sources, targets, left, right):
    difference = sources[:, None] - targets
    return np.minimum(difference, 0) @ left + np.maximum(difference, 0) @ right


def test_gap_regression_recovers_slopes_of_a_noiseless_world():
    steps = grid(6, 5).steps
    sources = steps[[0, 7, 13, 29]]
    left, right = np.array([0.03, -0.01]), np.array([-0.02, -0.04])
    rows = 0.7 + piecewise(sources, steps, left, right)
    rows[1, 3:9] = np.nan
    gap = fit_directional_gap(sources, steps, rows)
    assert gap.left == pytest.approx(left)
    assert gap.right == pytest.approx(right)
    assert gap.between(sources, steps) == pytest.approx(piecewise(sources, steps, left, right))


def test_pooled_slopes_take_up_difficulty_and_slopes_per_target_do_not():
    steps = grid(6, 5).steps
    sources = steps[[0, 7, 13, 29]]
    left, right = np.array([0.03, 0.02]), np.array([-0.02, -0.04])
    difficulty = 0.05 * steps.sum(axis=1)
    rows = 0.7 + piecewise(sources, steps, left, right) + difficulty
    assert fit_directional_gap(sources, steps, rows).left[0] < 0.01
    gap = fit_directional_gap(sources, steps, rows, per_target=True)
    assert gap.left == pytest.approx(left)
    assert gap.right == pytest.approx(right)


def test_directions_that_nothing_shows_have_slope_zero():
    steps = grid(5).steps
    gap = fit_directional_gap(steps[[0]], steps, 0.9 - 0.1 * steps.T)
    assert gap.left == pytest.approx([0.1])
    assert gap.right == pytest.approx([0.0])  # no target lies below the first context
    empty = fit_directional_gap(steps[[2]], steps, np.full((1, 5), np.nan))
    assert np.array_equal([empty.left, empty.right], np.zeros((2, 1)))


def test_gain_is_the_direct_double_sum():
    rng = np.random.default_rng(0)
    steps = grid(4, 3, 2).steps
    gap = DirectionalGap(rng.normal(size=3), rng.normal(size=3))
    upper, best, weights = rng.normal(size=24), rng.normal(size=24), rng.dirichlet(np.ones(24))
    reached = upper[:, None] + piecewise(steps, steps, gap.left, gap.right)
    expected = np.maximum(reached - best, 0.0) @ weights
    assert gap.gain(upper, steps, steps, best, weights) == pytest.approx(expected)
