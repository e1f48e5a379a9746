"""Names of checkpoints: what they mean, and what is none."""

from fractions import Fraction

import pytest

from mbtl.engine.checkpoints import Along, Checkpoint, shares_of
from mbtl.errors import InvalidInput


def test_a_name_says_which_policy_and_when():
    assert Checkpoint.named("best") == Checkpoint("best", Fraction(1))
    assert Checkpoint.named("last@1/8") == Checkpoint("last", Fraction(1, 8))
    assert not Checkpoint.named("last@1").on_the_way
    for name in ("best", "final", "best@1/64", "last@1/2", "last@1"):
        assert str(Checkpoint.named(name)) == name


@pytest.mark.parametrize("name", ["", "worst", "last", "best@", "best@2", "best@1/0", "final@1/2"])
def test_other_names_are_refused(name):
    with pytest.raises(InvalidInput, match="a checkpoint is 'best', 'final'"):
        Checkpoint.named(name)


def test_rows_along_a_training_are_its_halvings_and_its_end():
    along = Along(episodes=2, halvings=2)
    assert along.shares == [Fraction(1, 4), Fraction(1, 2), Fraction(1)]
    assert along.names == {
        "best": ["best@1/4", "best@1/2", "best"],
        "last": ["last@1/4", "last@1/2", "last@1"],
    }
    assert shares_of(["final", *along.names["best"], *along.names["last"]]) == along.shares[:2]


@pytest.mark.parametrize(("episodes", "halvings"), [(1, 6), (0, 6), (10, -1)])
def test_one_episode_has_no_second_half(episodes, halvings):
    with pytest.raises(InvalidInput, match="2 episodes or more and 0 halvings or more"):
        Along(episodes, halvings)
