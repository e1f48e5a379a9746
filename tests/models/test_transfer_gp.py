import numpy as np
import pytest

from mbtl.contexts import Categorical, ContextSpace, Integer, Linear, Log
from mbtl.errors import InvalidInput
from mbtl.models.transfer_gp import TransferGP, likely_noise
from mbtl.models.transfer_kernel import (
    NEW,
    Places,
    TransferPrior,
    covariance,
    grid_pairs,
    transfer_places,
    variance,
)

N = 20
STEPS = np.arange(float(N))[:, None]
LINE = Places.of(STEPS / (N - 1), STEPS)
PRIOR = TransferPrior()
EVERY = np.arange(N)


def matern(distance, length):
    return (1 + np.sqrt(3) * distance / length) * np.exp(-np.sqrt(3) * distance / length)


def test_covariance_is_the_sum_of_the_terms_as_stated():
    p = PRIOR
    (s, t), (s2, t2) = (3, 7), (3, 11)
    x, z = LINE.x[:, 0], LINE.z[:, 0]
    apart = matern(abs(x[7] - x[11]), p.target_length)
    shift = matern(abs((x[7] - x[3]) - (x[11] - x[3])), p.gap_length)
    log_shift = matern(abs(z[7] - z[11]), p.log_gap_length)
    shared = p.target * apart + p.source + p.gap * shift + p.log_gap * log_shift
    shared += p.interaction * apart
    one, other = np.array([[s, t, 0]]), np.array([[s2, t2, 0]])
    again, new = np.array([[s2, t2, 1]]), np.array([[s2, t2, NEW]])
    luck = p.luck + p.row_luck * matern(abs(x[7] - x[11]), p.row_luck_length)
    assert covariance(LINE, p, one, other) == pytest.approx(shared + luck)
    assert covariance(LINE, p, one, again) == pytest.approx(shared)
    assert covariance(LINE, p, new, new) == pytest.approx(variance(p) - p.luck - p.row_luck)
    assert covariance(LINE, p, one, one) == pytest.approx(variance(p))


def test_every_axis_counts_once_and_only_ratios_that_x_does_not_show_have_a_second_scale():
    linear = ContextSpace.grid({Linear("a", 0, 1): 4, Integer("b", 1, 5): 5})
    places, plain = transfer_places(linear), Places.of(linear.unit, linear.steps)
    np.testing.assert_array_equal(places.x, plain.x)
    np.testing.assert_array_equal(places.z, plain.z)
    kinds = {Log("a", 0.01, 1.0): 10, Categorical("b", ("p", "q", "r")): 3}
    shown = transfer_places(ContextSpace.grid(kinds))
    np.testing.assert_array_equal(shown.z, shown.x)
    axes = [Linear("a", 0.0, 1.0), Categorical("b", ("p", "q", "r", "s"))]
    contexts = [{"a": 0.0, "b": "p"}, {"a": 1.0, "b": "p"}, {"a": 0.0, "b": "s"}]
    x = transfer_places(ContextSpace.points(axes, contexts)).x
    assert np.ptp(Places.of(np.zeros((3, 1)), np.zeros((3, 1))).z) == 0.0
    root_mean_square = np.sqrt(np.square(x - x[0]).mean(axis=1))
    assert root_mean_square == pytest.approx([0.0, np.sqrt(0.5), np.sqrt(0.5)])


def test_posterior_is_that_of_the_normal_distribution():
    rng = np.random.default_rng(1)
    pairs = grid_pairs(np.array([2, 11]), np.arange(0, N, 3))
    y = rng.normal(0.5, 0.2, len(pairs))
    model = TransferGP(LINE, PRIOR, pairs, y)
    K = covariance(LINE, PRIOR, pairs, pairs) + PRIOR.noise * np.eye(len(y))
    inverse, ones = np.linalg.inv(K), np.ones(len(y))
    mu = ones @ inverse @ y / (ones @ inverse @ ones)
    square = (y - mu) @ inverse @ (y - mu)
    scale = (square + 2 * 0.05) / (len(y) + 2)
    query = grid_pairs(np.array([5]), np.array([4, 17]), np.array([NEW]))
    cross = covariance(LINE, PRIOR, query, pairs)
    mean, std = model.predict(np.array([5]), np.array([4, 17]))
    assert model.mean == pytest.approx(mu)
    assert mean[0] == pytest.approx(mu + cross @ inverse @ (y - mu))
    left = variance(PRIOR) - np.einsum("ij,jk,ik->i", cross, inverse, cross)
    assert std[0] == pytest.approx(np.sqrt(scale * left))
    from scipy.stats import multivariate_normal

    density = multivariate_normal(np.full(len(y), mu), scale * K).logpdf(y)
    assert model.log_likelihood == pytest.approx(density)


def test_a_done_training_is_predicted_as_it_was_seen_and_noise_is_averaged_out():
    pairs = grid_pairs(np.array([3, 15]), EVERY)
    truth = np.sin(pairs[:, 0] + pairs[:, 1] / 6.0)
    exact = TransferGP(LINE, PRIOR, pairs, truth)
    mean, std = exact.predict(np.array([3, 15]), EVERY, np.array([0, 1]))
    assert mean.ravel() == pytest.approx(truth, abs=0.02)
    again = exact.predict(np.array([3, 15]), EVERY)[1]  # a new training has luck of its own
    assert (std < again).all()
    assert (again**2 > 0.99 * exact.scale * (PRIOR.luck + PRIOR.row_luck)).all()
    error = 0.3 * np.random.default_rng(0).standard_normal(len(truth))
    noise = np.full(len(truth), 0.09)
    told = TransferGP(LINE, PRIOR, pairs, truth + error, noise)
    mean, _ = told.predict(np.array([3, 15]), EVERY, np.array([0, 1]))
    assert np.abs(mean.ravel() - truth).mean() < 0.7 * np.abs(error).mean()


def test_draws_have_the_posteriors_mean_and_scatter_and_share_their_luck():
    pairs = grid_pairs(np.array([3, 15]), EVERY)
    model = TransferGP(LINE, PRIOR, pairs, np.sin(pairs[:, 0] + pairs[:, 1] / 6.0))
    both = model.draws(np.array([9, 9]), EVERY, 4000, np.random.default_rng(0))
    draws = both[:, 0]
    mean, std = model.predict(np.array([9]), EVERY)
    assert draws.mean(axis=0) == pytest.approx(mean[0], abs=5 * std.max() / np.sqrt(4000))
    assert draws.std(axis=0) == pytest.approx(std[0], rel=0.06)
    assert np.corrcoef(draws[:, 0], draws[:, 1])[0, 1] > 0.5
    assert np.corrcoef(draws[:, 0], both[:, 1, 0])[0, 1] < 0.9  # another training, other luck


def test_scatter_of_pairs_is_believed_where_it_is_seen():
    pairs = grid_pairs(np.array([3, 9, 15]), EVERY)
    smooth = np.sin(pairs[:, 0] + pairs[:, 1] / 6.0)
    scatter = 0.4 * np.random.default_rng(0).standard_normal(len(smooth))
    quiet, none = likely_noise(LINE, PRIOR, pairs, smooth)
    noisy, _ = likely_noise(LINE, PRIOR, pairs, smooth + scatter)
    assert quiet == PRIOR
    assert noisy.noise > 10 * PRIOR.noise
    assert not none.any()


@pytest.mark.parametrize("seed", range(2))
def test_known_noise_counts_as_far_as_it_is_seen(seed):
    pairs = grid_pairs(np.array([3, 9, 15]), EVERY)
    smooth = np.sin(pairs[:, 0] + pairs[:, 1] / 6.0)
    known = np.where(pairs[:, 1] % 2, 0.16, 0.0)
    scatter = np.sqrt(known) * np.random.default_rng(seed).standard_normal(len(smooth))
    assert not likely_noise(LINE, PRIOR, pairs, smooth, known)[1].any()  # shared by all policies
    prior, counted = likely_noise(LINE, PRIOR, pairs, smooth + scatter, known)
    assert counted.any()
    told = TransferGP(LINE, prior, pairs, smooth + scatter, counted)
    mean, _ = told.predict(np.array([3, 9, 15]), EVERY, np.arange(3))
    assert np.abs(mean.ravel() - smooth).mean() < 0.8 * np.abs(scatter).mean()


def plateau(source):
    """A policy serves targets up to a third beyond its source, and none farther."""
    return np.where(EVERY - source <= 6, 0.9, 0.1)


def test_the_shape_of_the_gap_moves_with_the_source():
    known = np.array([2, 4, 8])
    y = np.concatenate([plateau(source) for source in known])
    mean, _ = TransferGP(LINE, PRIOR, grid_pairs(known, EVERY), y).predict(np.array([6]), EVERY)
    error = np.abs(mean[0] - plateau(6)).mean()
    assert error < 0.6 * np.abs(plateau(8) - plateau(6)).mean()
    assert error < 0.6 * np.abs(plateau(4) - plateau(6)).mean()


def test_bad_input_is_refused():
    with pytest.raises(InvalidInput, match="gap_length of a prior must be finite and > 0"):
        TransferPrior(gap_length=0.0)
    with pytest.raises(InvalidInput, match="drop what was not evaluated"):
        TransferGP(LINE, PRIOR, grid_pairs(EVERY[:1], EVERY), np.full(N, np.nan))
