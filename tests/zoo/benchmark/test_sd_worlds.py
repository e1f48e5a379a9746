"""The published synthetic families: their formula entry by entry, and the list of their members."""

import itertools

import numpy as np
import pytest
from sd_worlds import sd_world, sd_worlds

from mbtl.errors import InvalidInput, UnknownName
from mbtl.zoo.benchmark import synthetic_world

LEFT = {
    (3, "l1"): (-3, -3, -3),
    (3, "nd"): (1, 1, -3),
    (5, "nd2"): (1, 1, 1, 1, -3),
    (7, "nd"): (1, 1, 1, 1, 1, -3, -3),
}
LEVELS = {3: 8, 5: 5, 7: 4}
SLOPES = {3: (4, 3), 5: (2, 2), 7: (0, 2)}


@pytest.mark.parametrize(("dims", "h"), LEFT)
def test_entries_follow_the_published_formula(dims, h):
    f = "linear" if SLOPES[dims][0] else "constant"
    world = sd_world(dims, f=f, g="linear", h=h, noise=0.0)
    x = np.array(list(itertools.product(range(LEVELS[dims]), repeat=dims)))
    assert world.n == len(x)
    a, b = SLOPES[dims]
    sources = np.array([0, 7, len(x) // 2, len(x) - 1])
    targets = np.array([0, 5, len(x) // 3, len(x) - 1])
    returns = world.returns(0, sources)[:, targets]
    for i, s in enumerate(sources):
        for j, t in enumerate(targets):
            expected = 500.0 + a * x[s].sum() + b * x[t].sum()
            for q, difference in enumerate(x[s] - x[t]):
                slope = LEFT[dims, h][q] if difference < 0 else 3
                expected -= slope * difference
            assert returns[i, j] == pytest.approx(expected)


@pytest.mark.parametrize(("dims", "count"), [(3, 8), (5, 12), (7, 4)])
def test_a_set_lists_its_published_members_once(dims, count):
    worlds = sd_worlds(dims, noise=5.0, n_seeds=5)
    assert len({world.name for world in worlds}) == count
    assert all(world.n_seeds == 5 and world.noise == 5.0 for world in worlds)
    assert not any("minor" in world.name for world in worlds)


def test_parts_and_id_name_the_same_world():
    by_parts = sd_world(3, f="constant", g="linear", h="nd", noise=5.0, n_seeds=2)
    by_id = synthetic_world("synthetic:3d-const-lin-nd-eta5@2")
    assert by_parts.name == by_id.name
    assert np.array_equal(by_parts.returns(1, [3]), by_id.returns(1, [3]))


def test_mistakes_are_named():
    with pytest.raises(InvalidInput, match="g must be one of"):
        sd_world(3, g="constant")
    with pytest.raises(InvalidInput, match="3, 5 or 7 axes, got 4"):
        sd_worlds(4)
    with pytest.raises(UnknownName, match="nd1"):
        sd_world(3, h="nd1")
