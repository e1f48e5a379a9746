"""Contexts whose decisions last differently long: which of them are trained together."""

import numpy as np
import pytest

from mbtl.engine.worlds.beats import HoldParams, Holds
from mbtl.problems import get_cmdp


def groups(holds, most=25):
    return Holds.groups(None, HoldParams(np.array(holds), np.zeros((len(holds), 0))), most)


@pytest.mark.parametrize(
    ("holds", "sizes"),
    [
        (range(1, 41), [4, 16, 20]),
        (range(40, 0, -1), [25, 12, 3]),
        ([3, 3, 3], [3]),
        ([1, 5, 1, 4, 4], [1, 1, 3]),
        ([7], [1]),
    ],
)
def test_no_episode_of_a_group_has_more_than_four_times_the_decisions_of_another(holds, sizes):
    found = groups(list(holds))
    assert found == sizes
    ends = np.cumsum(found)
    for end, size in zip(ends, found, strict=True):
        some = list(holds)[end - size : end]
        assert max(some) <= 4 * min(some)


def test_a_trainer_of_the_ramp_divides_by_holds_and_others_by_number():
    ramp, green = get_cmdp("ramp-acc"), get_cmdp("eco-green")
    assert ramp.trainer_for().groups(ramp.space.contexts, 10) == [4, 10, 10, 10, 6]
    assert green.trainer_for().groups(green.space.contexts, 20) == [20, 20, 10]
