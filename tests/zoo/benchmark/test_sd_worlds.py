"""The published synthetic families: their formula entry by entry."""

import itertools

import numpy as np
import pytest

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
    f = "lin" if SLOPES[dims][0] else "const"
    world = synthetic_world(f"synthetic:{dims}d-{f}-lin-{h}-eta0")
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
