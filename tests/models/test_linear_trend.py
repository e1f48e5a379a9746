"""The linear trend: slopes of worlds made of straight lines, and when it is believed."""

import numpy as np
import pytest

from mbtl.contexts import ContextSpace, Linear
from mbtl.models.linear_trend import fit_linear_trend
from mbtl.models.transfer_kernel import grid_pairs

STEPS = ContextSpace.grid({Linear("x", 0, 1): 6, Linear("y", 0, 1): 5}).steps
EVERY = np.arange(len(STEPS))
SOURCES = np.array([7, 13, 16, 29])
A, B, BEND = np.array([0.02, 0.0]), np.array([-0.01, 0.03]), np.array([-0.04, -0.01])


def world(pairs, a=A, b=B, bend=BEND):
    s, t = STEPS[pairs[:, 0]], STEPS[pairs[:, 1]]
    return 0.7 + s @ a + t @ b + np.abs(s - t) @ bend


def fitted(sources, scatter=0.0, seed=0):
    pairs = grid_pairs(sources, EVERY)
    y = world(pairs) + scatter * np.random.default_rng(seed).standard_normal(len(pairs))
    return fit_linear_trend(STEPS, pairs, y)


def test_straight_lines_are_predicted_exactly_far_from_what_was_seen():
    trend = fitted(SOURCES)
    pairs = grid_pairs(EVERY, EVERY)
    mean, std = trend.predict(EVERY, EVERY)
    assert mean.ravel() == pytest.approx(world(pairs))
    assert trend.predict_pairs(pairs)[0] == pytest.approx(mean.ravel())
    assert std == pytest.approx(np.zeros(std.shape), abs=1e-6)


def test_scatter_is_told_and_part_of_what_is_drawn():
    trend = fitted(SOURCES, scatter=0.05)
    assert trend.scatter == pytest.approx(0.05, rel=0.15)
    drawn = trend.draws(EVERY[:2], EVERY[:3], 4000, np.random.default_rng(0))
    mean, std = trend.predict(EVERY[:2], EVERY[:3])
    assert drawn.mean(axis=0) == pytest.approx(mean, abs=0.005)
    assert drawn.std(axis=0) == pytest.approx(std, rel=0.05)


def test_one_row_and_rows_in_one_line_leave_slopes_open():
    assert fitted(SOURCES[:1]).log_likelihood == -np.inf
    assert fitted(np.array([5, 6, 8])).log_likelihood == -np.inf  # x is the same in all three
    assert np.isfinite(fitted(SOURCES).log_likelihood)


def test_known_noise_is_no_scatter_and_draws_entries_to_the_trend():
    pairs = grid_pairs(SOURCES, EVERY)
    noise = 0.05 * np.random.default_rng(1).standard_normal(len(pairs))
    y, known = world(pairs) + noise, np.full(len(pairs), 0.05**2)
    trend = fit_linear_trend(STEPS, pairs, y, known)
    assert trend.scatter < 0.025
    rows, truth = (v.reshape(len(SOURCES), -1) for v in (y, world(pairs)))
    believed = trend.believed(SOURCES, EVERY, rows, known.reshape(rows.shape))
    assert np.abs(believed - truth).mean() < 0.5 * np.abs(rows - truth).mean()
    assert trend.believed(SOURCES, EVERY, rows, None) == pytest.approx(rows)


def test_entries_that_were_not_evaluated_are_believed_on_the_trend():
    trend = fitted(SOURCES)
    rows = np.full((1, len(EVERY)), np.nan)
    rows[0, 3] = 0.9
    believed = trend.believed(SOURCES[:1], EVERY, rows, None)[0]
    assert believed[3] == pytest.approx(0.9)
    assert believed[4] == pytest.approx(world(np.array([[SOURCES[0], 4, 0]]))[0])
