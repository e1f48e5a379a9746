"""Small linear algebra has one thread, wherever a selector is asked."""

import numpy as np
import pytest
from threadpoolctl import threadpool_info

from mbtl.benchmark.replay import replay
from mbtl.contexts import ContextSpace, Linear
from mbtl.selectors.base import Proposal, SelectionProblem
from mbtl.threads import MANY, threads_for


def most_threads():
    return max(
        (pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"), default=1
    )


class Asked:
    """A selector that notes how many threads it has."""

    name = "asked"

    def __init__(self):
        self.threads = []

    def propose(self, problem, history, rng):
        self.threads.append(most_threads())
        return Proposal(len(history.sources), "the next one")


@pytest.fixture
def problem():
    space = ContextSpace.grid({Linear("x", 0.0, 4.0): [0.0, 1.0, 2.0, 3.0, 4.0]})
    return SelectionProblem.of(space, budget=3)


def test_a_replay_asks_its_selector_on_one_thread_and_gives_the_others_back(problem):
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
