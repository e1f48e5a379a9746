"""A posterior that believes: the same numbers as one that is told what it believes."""

import numpy as np
import pytest

from mbtl.models import believing
from mbtl.models.believing import Believing
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


@pytest.mark.parametrize("most", [believing._MOST_ENTRIES, 4000])
def test_believing_pick_after_pick_is_being_told_what_was_expected(monkeypatch, most):
    monkeypatch.setattr(believing, "_MOST_ENTRIES", most)  # too little room: solved again
    model, pairs, y = Believing(told()), TOLD, Y
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
    model = Believing(told())
    model.believe(pick(20, 2))
    sources = np.array([20, 3])
    expected = told().predict(sources, TARGETS)[0]
    np.testing.assert_allclose(model.means(sources, TARGETS), expected, atol=1e-12)
    np.testing.assert_allclose(model.means(sources, TARGETS), expected, atol=1e-12)
