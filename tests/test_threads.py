"""Small linear algebra has one thread, wherever a selector is asked."""

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from flat import created
from mbtl.contexts import ContextSpace, Linear
from mbtl.models import transfer_gp
from mbtl.processes import MANY, _controller, threads_for
from mbtl.selectors.base import Proposal, SelectionProblem
from mbtl.zoo.benchmark.replay import replay


def most_threads():
    """Of the libraries of numpy and scipy; a simulator may have brought others meanwhile."""
    ours = {pool["filepath"] for pool in _controller().info()}
    pools = [pool for pool in threadpool_info() if pool["filepath"] in ours]
    return max((pool["num_threads"] for pool in pools if pool["user_api"] == "blas"), default=1)


class Asked:
    """A selector that notes how many threads it has."""

    name = "asked"

    def __init__(self):
        self.threads = []

    def propose(self, problem, history, rng):
        self.threads.append(most_threads())
        return Proposal(len(history.sources), "the next one")


def test_a_replay_asks_its_selector_on_one_thread_and_gives_the_others_back():
    space = ContextSpace.grid({Linear("x", 0.0, 4.0): 5})
    problem = SelectionProblem.of(space, budget=3)
    asked, before = Asked(), most_threads()
    replay(asked, problem, lambda source: np.zeros(5))
    assert asked.threads == [1, 1, 1]
    assert most_threads() == before


def test_many_contexts_keep_the_threads_there_are():
    before = most_threads()
    with threads_for(MANY + 1):
        assert most_threads() == before
    with threads_for(MANY):
        assert most_threads() == 1


@pytest.fixture
def two_threads():
    with threadpool_limits(limits=2, user_api="blas"):
        assert most_threads() == 2
        yield


def test_the_threads_come_back_when_the_last_of_several_is_out(two_threads):
    one, other = threads_for(MANY), threads_for(1)
    one.__enter__(), other.__enter__()
    assert most_threads() == 1
    one.__exit__(None, None, None)
    assert most_threads() == 1
    other.__exit__(None, None, None)
    assert most_threads() == 2


@pytest.mark.parametrize("risk", [1.0, 0.3])
def test_value_curve_and_routes_take_one_thread_as_a_pick_does(two_threads, monkeypatch, risk):
    seen, solve = [], transfer_gp.half_solved
    noted = lambda *given: seen.append(most_threads()) or solve(*given)  # noqa: E731
    monkeypatch.setattr(transfer_gp, "half_solved", noted)
    space = ContextSpace.grid({Linear("x", 0.0, 4.0): 5})
    study = created(space, budget=3, risk=risk, strategy="equidistant")
    rng = np.random.default_rng(0)
    for ask in ("value", "curve", "routing"):
        study.tell(study.ask(), rng.random((5, 3)))
        found = getattr(study, ask)
        if ask == "routing":
            assert found.value.margin > 0.0
            assert found.gain.margin > 0.0
            assert found.route.shape == found.believed[0].shape
    assert len(seen) > 10
    assert set(seen) == {1}
    assert most_threads() == 2
