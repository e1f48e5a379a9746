import numpy as np
import pytest

from mbtl.contexts import ContextSpace, Linear
from mbtl.errors import InvalidInput
from mbtl.history import History
from mbtl.selectors import SelectionProblem


def test_history_grows_without_changing_the_old_one():
    empty = History(3)
    one = empty.with_pending(2).with_row(2, np.array([0.1, 0.2, 0.9]))
    assert len(empty) == 0
    assert (one.sources, one.pending) == ((2,), ())
    assert one.training_performance == pytest.approx([0.9])


def test_taken_contexts_are_closed():
    history = History(5).with_row(0, np.zeros(5)).with_pending(1).with_pending(2).with_failure(2)
    assert history.open_mask(5).tolist() == [False, False, False, True, True]
    assert (history.pending, history.failed) == ((1,), (2,))


def test_nobody_writes_into_what_all_share():
    history = History(3).with_row(1, np.arange(3.0))
    problem = SelectionProblem.of(ContextSpace.grid({Linear("x", 0.0, 1.0): 3}), budget=2)
    for shared in (history.rows, history.best, problem.weights, problem.unit, problem.steps):
        with pytest.raises(ValueError, match="read-only"):
            shared *= 2.0


def test_rows_must_fit():
    with pytest.raises(InvalidInput, match="shape"):
        History(3, (0,), np.zeros((1, 4)))
