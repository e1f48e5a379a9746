import numpy as np
import pytest

from mbtl.acquisition import argmax_open
from mbtl.errors import InvalidInput


def test_ties_go_to_the_lowest_index_even_when_the_last_digit_differs():
    assert argmax_open(np.array([0.1, 0.3, 0.3 + 1e-16, 0.2]), np.ones(4, bool)) == 1


def test_closed_candidates_are_never_chosen():
    assert argmax_open(np.array([9.0, 1.0, 2.0]), np.array([False, True, True])) == 2


def test_nothing_open_and_nan_are_refused():
    with pytest.raises(InvalidInput, match="none"):
        argmax_open(np.zeros(2), np.zeros(2, bool))
    with pytest.raises(InvalidInput, match="NaN"):
        argmax_open(np.array([0.0, np.nan]), np.ones(2, bool))
