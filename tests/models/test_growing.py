"""A posterior that grows: the same numbers as one made anew of all it was told."""

import numpy as np
import pytest

from mbtl.models import growing
from mbtl.models.growing import Growing
from mbtl.models.transfer_gp import TransferGP
from mbtl.models.transfer_kernel import Places, TransferPrior, grid_pairs

N = 30
STEPS = np.arange(N, dtype=float)[:, None]
PLACES = Places.of(STEPS / (N - 1), STEPS)
PRIOR = TransferPrior()
TARGETS = np.arange(0, N, 3)
TOLD = grid_pairs(np.array([4, 17]), TARGETS)
Y = np.random.default_rng(0).random(len(TOLD))


def told():
    return TransferGP(PLACES, PRIOR, TOLD, Y)


def pick(source, number, targets=TARGETS):
    return grid_pairs(np.array([source]), targets, np.array([number]))


@pytest.mark.parametrize("most", [growing._MOST_ENTRIES, 4000])
def test_believing_pick_after_pick_is_being_told_what_was_expected(monkeypatch, most):
    monkeypatch.setattr(growing, "_MOST_ENTRIES", most)  # too little room: solved again
    model, pairs, y = Growing(PLACES, PRIOR, TOLD, Y), TOLD, Y
    sources = np.array([1, 9, 11, 26])
    for i, source in enumerate((9, 26, 12)):
        believed = pick(source, 2 + i, TARGETS[: 10 - 3 * i])
        y = np.append(y, told().predict_pairs(believed)[0])
        pairs = np.vstack([pairs, believed])
        model.believe(believed)
        direct = TransferGP(PLACES, PRIOR, pairs, y)
        for ours, theirs in zip(
            model.predict(sources, TARGETS), direct.predict(sources, TARGETS), strict=True
        ):
            np.testing.assert_allclose(ours, theirs, atol=1e-9)
        assert model.scale == pytest.approx(direct.scale)
        assert model.mean == pytest.approx(direct.mean)
        np.testing.assert_array_equal(model.believed, pairs[len(TOLD) :])
        rows = np.random.default_rng(5), np.random.default_rng(5)
        np.testing.assert_allclose(
            model.draws(sources[:2], TARGETS, 3, rows[0]),
            direct.draws(sources[:2], TARGETS, 3, rows[1]), atol=1e-6,
        )  # fmt: skip
        sources = sources[::-1]


def test_means_of_new_trainings_are_those_of_the_rows_told():
    model = Growing(PLACES, PRIOR, TOLD, Y)
    model.believe(pick(20, 2))
    sources = np.array([20, 3])
    expected = told().predict(sources, TARGETS)[0]
    np.testing.assert_allclose(model.means(sources, TARGETS), expected, atol=1e-12)
    np.testing.assert_allclose(model.means(sources, TARGETS), expected, atol=1e-12)


@pytest.mark.parametrize("noisy", [False, True])
def test_told_row_after_row_it_is_the_model_of_all_rows(noisy):
    rng, sources = np.random.default_rng(2), np.array([9, 26, 12, 20])
    model, pairs, y, noise = Growing(PLACES, PRIOR, TOLD, Y), TOLD, Y, np.zeros(len(TOLD))
    for i, source in enumerate(sources):
        asked = np.array([1, 11, source])
        model.predict(asked, TARGETS)
        model.believe(pick(3, 2 + i))
        model.predict(asked, TARGETS)
        new = pick(source, 2 + i, TARGETS[: 10 - i])
        pairs, y = np.vstack([pairs, new]), np.append(y, rng.random(len(new)))
        y[0] += 0.1  # values told before may change, too
        more = rng.random(len(new)) if noisy else np.zeros(len(new))
        noise = np.append(noise, more)
        model.tell(new, y, more)
        direct = TransferGP(PLACES, PRIOR, pairs, y, relative=PRIOR.noise + noise)
        for ours, theirs in zip(
            model.predict(asked, TARGETS), direct.predict(asked, TARGETS), strict=True
        ):
            np.testing.assert_allclose(ours, theirs, atol=1e-9)
        assert model.log_likelihood == pytest.approx(direct.log_likelihood)
        assert model.scale == pytest.approx(direct.scale)
        assert model.noisy == noisy
        np.testing.assert_allclose(model.smoothed(), direct.predict_pairs(pairs)[0], atol=1e-9)


def test_what_was_believed_is_forgotten_when_it_is_doubted():
    model, sources = Growing(PLACES, PRIOR, TOLD, Y), np.array([1, 9])
    before = model.predict(sources, TARGETS)
    model.believe(pick(9, 2))
    assert (model.predict(sources, TARGETS)[1] < before[1]).all()
    model.doubt()
    np.testing.assert_allclose(model.predict(sources, TARGETS), before, atol=1e-12)
    assert len(model.believed) == 0
