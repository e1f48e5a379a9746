import numpy as np
import pytest

import mbtl
from mbtl.history import History
from mbtl.selectors import get_selector
from mbtl.selectors.base import SelectionProblem
from mbtl.selectors.outlook import MOST, outlook

N = 30
SPACE = mbtl.ContextSpace.grid({mbtl.Linear("x", 0.0, 1.0): N})
PROBLEM = SelectionProblem.of(SPACE, budget=10)


def history_of(sources):
    history = History(N)
    for source in sources:
        history = history.with_row(source, 0.9 - 0.02 * np.abs(source - np.arange(N)))
    return history


@pytest.mark.parametrize("name", ["mbtl", "mbtl-ei", "specialists"])
def test_the_outlook_peaks_where_the_selector_picks(name):
    history = history_of([14, 29, 0, 21, 7])
    found = outlook(PROBLEM, history, name)
    pick = get_selector(name).propose(PROBLEM, history, np.random.default_rng(0))
    assert found.model == name
    assert found.gain[pick.source] == pytest.approx(pick.acquisition, abs=1e-9)
    assert np.nanmax(np.where(history.open_mask(N), found.gain, -1)) == found.gain[pick.source]


def test_what_was_seen_later_does_not_change_what_was_believed_before():
    early, late = history_of([14, 29]), history_of([14, 29, 0, 21])
    now, then = outlook(PROBLEM, early), outlook(PROBLEM, late, after=2)
    assert then.mean == pytest.approx(now.mean)
    assert then.gain == pytest.approx(now.gain)
    assert outlook(PROBLEM, late, after=0) is None
    with pytest.raises(mbtl.MbtlError, match="from 0 to the 4"):
        outlook(PROBLEM, late, after=5)


def test_a_selector_without_a_model_gets_that_of_specialists():
    history = history_of([14, 29, 0])
    found = outlook(PROBLEM, history, "random")
    assert found.model == "specialists"
    assert outlook(PROBLEM, history, "no/such.py:Mine").mean == pytest.approx(found.mean)
    proposal = get_selector("specialists").propose(PROBLEM, history, np.random.default_rng(0))
    assert found.gain[proposal.source] == pytest.approx(proposal.acquisition)


def test_of_many_contexts_some_are_asked_for_their_gain():
    space = mbtl.ContextSpace.grid({mbtl.Linear("x", 0, 1): 20, mbtl.Linear("y", 0, 1): 15})
    history = History(300).with_row(150, np.linspace(0, 1, 300))
    found = outlook(SelectionProblem.of(space, budget=3), history)
    assert np.isfinite(found.gain).sum() == MOST
    assert np.isfinite(found.mean).all()
