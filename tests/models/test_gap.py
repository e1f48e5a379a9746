import numpy as np
import pytest

from mbtl.errors import InvalidInput
from mbtl.history import History
from mbtl.models import FittedGap, LinearGap, predicted_rows

STEPS = np.arange(10.0)[:, None]


def linear_row(source, theta):
    return 0.9 - theta * np.abs(source - STEPS[:, 0])


def test_theta_of_a_linear_world_is_recovered():
    history = History(10).with_row(2, linear_row(2, 0.03)).with_row(7, linear_row(7, 0.03))
    assert FittedGap(prior=0.5).slope(history, STEPS) == pytest.approx(0.03)


def test_theta_before_the_first_row_is_the_prior():
    assert FittedGap(prior=0.5).slope(History(10), STEPS) == 0.5


def test_theta_is_never_negative():
    history = History(10).with_row(0, STEPS[:, 0] / 10)
    assert FittedGap(prior=0.5).slope(history, STEPS) == 0.0


def test_given_theta_ignores_the_rows():
    history = History(10).with_row(2, linear_row(2, 0.03))
    assert LinearGap(0.2).slope(history, STEPS) == 0.2


def test_predicted_rows_decay_linearly():
    rows = predicted_rows(np.array([0.9]), STEPS[[2]], STEPS, 0.03)
    assert rows[0] == pytest.approx(linear_row(2, 0.03))


def test_negative_theta_is_refused():
    with pytest.raises(InvalidInput, match="-1"):
        LinearGap(-1.0)
