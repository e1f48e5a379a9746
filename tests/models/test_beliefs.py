"""Beliefs: exact entries stay, noise is shrunk, gaps are predicted, as the textbook says."""

import numpy as np
import pytest

from mbtl.contexts import ContextSpace, Linear
from mbtl.history import standard_errors
from mbtl.models.beliefs import Beliefs, transfer_places
from mbtl.models.transfer_kernel import covariance, grid_pairs

N = 12
SPACE = ContextSpace.grid({Linear("x", 0.0, 1.0): N})
SOURCES = (2, 9, 5)
nan = np.nan


def truth(source):
    return 0.9 - 0.05 * abs(source - np.arange(N))


ROWS = np.array([truth(s) for s in SOURCES])


def gaps(rows, every=3):
    """Only each so many-th entry stays."""
    thinned = np.full(rows.shape, nan)
    thinned[:, ::every] = rows[:, ::every]
    return thinned


def test_complete_rows_without_noise_are_believed_as_they_are():
    beliefs = Beliefs(SPACE, SOURCES, ROWS)
    mean, std = beliefs.on(np.arange(N))
    assert beliefs.exact
    assert np.array_equal(mean, ROWS)
    assert not std.any()
    assert beliefs.error(np.array([0, 1]), np.array([3, 4]), np.array([0.5, 0.5])) == 0.0


def test_what_is_measured_stays_and_what_is_not_is_predicted_with_doubt():
    beliefs = Beliefs(SPACE, SOURCES, gaps(ROWS))
    mean, std = beliefs.on(np.arange(N))
    seen = beliefs.measured
    assert not beliefs.exact
    assert np.array_equal(mean[seen], ROWS[seen])
    assert not std[seen].any()
    assert (std[~seen] > 0).all()
    assert np.abs(mean - ROWS)[~seen].mean() < 0.04


def test_the_posterior_is_that_of_conditioning_a_gaussian():
    """By the dense formula: signal and own scatter are real, known noise is not, mu is fitted."""
    rng = np.random.default_rng(3)
    rows = gaps(ROWS + 0.15 * rng.standard_normal(ROWS.shape), every=2)
    errors = np.full(rows.shape, 0.15)
    beliefs = Beliefs(SPACE, SOURCES, rows, errors)
    every = grid_pairs(np.array(SOURCES), np.arange(N))
    seen = np.isfinite(rows).ravel()
    places, y = transfer_places(SPACE), rows.ravel()[seen]
    prior, noise = beliefs._likely_prior, errors.ravel()[seen] ** 2
    model, _, _ = beliefs._model(1)
    signal = model.scale * (
        covariance(places, prior, every, every) + prior.noise * np.eye(len(every))
    )
    data = signal[np.ix_(seen, seen)] + np.diag(noise)
    inverse, ones = np.linalg.inv(data), np.ones(seen.sum())
    mu = ones @ inverse @ y / (ones @ inverse @ ones)
    gain = signal[:, seen] @ inverse
    mean = mu + gain @ (y - mu)
    unsure = 1.0 - gain @ ones
    spread = signal - gain @ signal[seen] + np.outer(unsure, unsure) / (ones @ inverse @ ones)
    row, target = np.divmod(np.arange(len(every)), N)
    found, deviation = beliefs.on(np.arange(N))
    # known noise was relative to the scale of the last but one fit
    assert found.ravel() == pytest.approx(mean, abs=0.01)
    assert deviation.ravel() == pytest.approx(np.sqrt(np.diagonal(spread)), rel=0.1)
    weights = rng.standard_normal(len(every))
    own = float(np.sqrt(weights @ beliefs.joint(row, target)[1] @ weights))
    assert own == pytest.approx(np.sqrt(weights @ spread @ weights), rel=0.1)


def test_noise_is_shrunk_and_the_luckiest_mean_does_not_win():
    rng = np.random.default_rng(0)
    rows = 0.7 + 0.1 * rng.standard_normal((6, N))
    beliefs = Beliefs(SPACE, (0, 2, 4, 6, 8, 10), rows, np.full(rows.shape, 0.1))
    mean, std = beliefs.on(np.arange(N))
    assert rows.max(axis=0).mean() > 0.8
    assert mean.max(axis=0).mean() < 0.75
    assert (std > 0).all()


def test_noise_that_all_policies_share_is_independent_between_contexts_and_in_no_difference():
    rng = np.random.default_rng(1)
    rows = ROWS + 0.2 * rng.standard_normal(N)  # the same few episodes for all, of each context
    beliefs = Beliefs(SPACE, SOURCES, rows, np.full(rows.shape, 0.2), own=0.0)
    every, one = np.arange(N), np.zeros(N, dtype=int)
    assert 0.02 < beliefs.error(one, every, np.full(N, 1 / N)) <= 0.2 / N**0.5
    pair = np.array([0, 1]), np.array([4, 4]), np.array([1.0, -1.0])
    assert beliefs.error(*pair) < 0.02
    mean = beliefs.on(every)[0]
    assert mean[0, 4] - mean[1, 4] == pytest.approx(ROWS[0, 4] - ROWS[1, 4], abs=0.02)


def test_the_means_of_other_values_are_those_of_beliefs_made_of_them():
    rng = np.random.default_rng(2)
    rows = gaps(ROWS + 0.1 * rng.standard_normal(ROWS.shape), every=2)
    errors = np.full(rows.shape, 0.1)
    beliefs = Beliefs(SPACE, SOURCES, rows, errors)
    same = beliefs.on_folds(np.arange(N), lambda row, target: rows[row, target][:, None])
    assert same[0] == pytest.approx(beliefs.on(np.arange(N))[0])
    twice = beliefs.on_folds(
        np.arange(N), lambda row, target: rows[row, target][:, None] * [1.0, 2.0]
    )
    assert twice[1] == pytest.approx(2.0 * same[0])  # a linear smoother


def test_entries_beyond_what_the_model_can_hold_count_by_their_own_value(monkeypatch):
    monkeypatch.setattr("mbtl.models.beliefs._MOST", 12)
    monkeypatch.setattr("mbtl.models.beliefs._LEAST", 12)
    rng = np.random.default_rng(0)
    rows = ROWS + 0.05 * rng.standard_normal(ROWS.shape)
    mean, std = Beliefs(SPACE, SOURCES, rows, np.full(rows.shape, 0.05)).on(np.arange(N))
    assert np.abs(mean - ROWS).mean() < np.abs(rows - ROWS).mean()
    assert (std <= 0.05 + 1e-9).all()


def test_standard_errors_are_moderated_and_single_episodes_have_the_usual_scatter():
    rng = np.random.default_rng(0)
    scatter = 0.3 * np.sqrt(rng.chisquare(3, (5, 200)) / 3)
    scatter[4] = nan
    errors = standard_errors(scatter, [4, 4, 4, 4, 1])
    assert errors[:4].std() < 0.5 * (scatter[:4] / 2).std()  # less chance in the errors themselves
    assert errors[:4].mean() == pytest.approx(0.15, rel=0.05)
    assert errors[4].mean() == pytest.approx(0.3, rel=0.1)
    assert standard_errors(np.zeros((2, 3)), [5, 5]) is None
    assert standard_errors(np.full((2, 3), nan), [1, 1]) is None
