import types

import numpy as np
import pytest

import mbtl
from mbtl.errors import InvalidInput, UnknownName
from mbtl.selectors import Proposal, Traits, get_selector
from mbtl.selectors.contract import traits_of


class Lowest:
    name = "lowest"

    def __init__(self, step=1):
        self.step = step

    def propose(self, problem, history, rng):
        taken = {*history.sources, *history.pending, *history.failed}
        return Proposal(min(set(range(0, problem.n, self.step)) - taken), "lowest left")


class NeedsMore:
    name = "needs-more"

    def __init__(self, number):
        raise NotImplementedError


SECOND = Lowest(2)
NOTHING = 3


def test_a_class_in_a_file_and_a_selector_made_there_are_both_found():
    assert get_selector(f"{__file__}:Lowest").step == 1
    assert get_selector(f"{__file__}:SECOND").step == 2
    assert get_selector("mbtl.selectors:Random").name == "random"


@pytest.mark.parametrize(
    ("name", "error", "match"),
    [
        ("NOTHING", InvalidInput, "got int 3"),
        ("NeedsMore", InvalidInput, "without arguments"),
        ("Lowst", UnknownName, "Did you mean 'Lowest'"),
    ],
)
def test_what_is_no_selector_is_refused_in_one_sentence(name, error, match):
    with pytest.raises(error, match=match):
        get_selector(f"{__file__}:{name}")


class Bare:
    """A plain class with the one method that a selector needs."""

    def propose(self, problem, history, rng):
        return Proposal(int(np.flatnonzero(history.open_mask(problem.n))[-1]), "the last one")


def test_several_contexts_may_be_given_one_after_the_other():
    assert Proposal(0, "", sources=(i for i in (2, 0, 1))).contexts == (0, 1, 2)
    with pytest.raises(InvalidInput, match="on several, got 5"):
        Proposal(0, "", sources=5)


def test_one_method_is_enough_for_a_selector():
    space = mbtl.ContextSpace.grid({mbtl.Linear("x", 0.0, 1.0): 5})
    study = mbtl.create_study(space, budget=2, strategy=Bare())
    assert [study.ask().source, study.ask().source] == [4, 3]
    assert study.spec.selector["name"] == "Bare"
    assert traits_of(study.selector) == Traits()
    bare = Bare()
    bare.traits = Traits(one_axis=True)  # it may say what it can
    assert traits_of(get_selector(bare)).one_axis
    bare.traits = "deterministic"
    with pytest.raises(InvalidInput, match=r"selectors.Traits\(...\), got 'deterministic'"):
        mbtl.create_study(space, budget=2, strategy=bare)


@pytest.mark.parametrize(
    ("given", "match"),
    [(42, "got int 42"), (Bare, r"give Bare\(\)"), (None, "got NoneType"), (object(), "propose")],
)
def test_an_object_that_is_no_selector_is_refused_in_one_sentence(given, match):
    with pytest.raises(InvalidInput, match=match):
        get_selector(given)


@pytest.mark.parametrize(
    ("proposed", "match"),
    [
        (3, "got int 3 from 'Bare'"),
        (Proposal(7, ""), "from 0 to 4, .*got 7"),
        (Proposal(1.5, ""), "got 1.5"),
        (Proposal(2, ""), "neither trained, under way nor failed, got 2"),
        (Proposal(1, None), "a text as its reason and .*, got reason=None"),
        (Proposal(1, "", notes="a fit fell back"), "notes='a fit fell back'"),
        (Proposal(1, "", acquisition=np.nan), "acquisition of a proposal is a number, .*got nan"),
    ],
)
def test_a_proposal_that_breaks_the_contract_is_refused_and_the_next_asker_goes_on(proposed, match):
    space = mbtl.ContextSpace.grid({mbtl.Linear("x", 0.0, 1.0): 5})
    study = mbtl.create_study(space, budget=3, strategy=Bare())
    study.tell(2, np.zeros(5))
    study.selector = types.SimpleNamespace(name="Bare", propose=lambda *_: proposed)
    with pytest.raises(InvalidInput, match=match):
        study.ask()
    study.selector = Bare()
    assert study.ask().source == 4
