"""Synthetic worlds: the formula, exact extremes, and rows that need no neighbours."""

import itertools

import numpy as np
import pytest

from mbtl.errors import InvalidInput, UnknownName
from mbtl.zoo.benchmark import (
    RowSource,
    SyntheticWorld,
    linear_gap_world,
    random_curve,
    sequential_oracle,
    synthetic_ids,
    synthetic_world,
)

LEFT = {
    (3, "l1"): (-3, -3, -3),
    (3, "nd"): (1, 1, -3),
    (5, "nd2"): (1, 1, 1, 1, -3),
    (7, "nd"): (1, 1, 1, 1, 1, -3, -3),
}
LEVELS = {3: 8, 5: 5, 7: 4}
SLOPES = {3: (4, 3), 5: (2, 2), 7: (0, 2)}


def test_linear_gap_world_is_its_formula():
    i = np.arange(100)
    expected = 0.9 - 0.005 * np.abs(i[:, None] - i)
    world = synthetic_world("synthetic:linear-gap")
    assert np.array_equal(world.rows(0, np.arange(100)), expected)
    assert world.problem(3).theta == 0.005
    assert isinstance(world, RowSource)


@pytest.mark.parametrize(
    ("variant", "random", "oracle"),
    [
        ("const-lin-nd", 0.7028, 0.7250),
        ("const-none-nd", 0.8688, 0.9091),
        ("lin-none-nd", 0.6761, 0.7000),
    ],
)
def test_published_values_without_noise_at_fifty_trainings(variant, random, oracle):
    # SD-MBTL's table; its Random is one run, and its oracle breaks exact ties by another rule.
    world = synthetic_world(f"synthetic:3d-{variant}-eta0")
    assert random_curve(world, 0, 50)[-1] == pytest.approx(random, abs=1e-3)
    assert sequential_oracle(world, 0, 50).curve[-1] == pytest.approx(oracle, abs=3e-4)


def test_every_named_world_exists_in_its_dimension():
    dimensions = {"1d": 100, "3d": 8**3, "5d": 5**5, "7d": 4**7}
    ids = synthetic_ids()
    assert len(ids) == len(set(ids)) == 1 + 32 + 48 + 12 + 4
    for name in ids[1:]:
        world = synthetic_world(name)
        assert world.name == name
        assert world.n == dimensions[name.split(":")[1][:2]]
        assert world.n_seeds == (1 if name.endswith("eta0") else 3)


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


def test_a_row_is_the_same_alone_in_a_block_and_in_any_order():
    world = synthetic_world("synthetic:3d-lin-lin-nd-eta5")
    block = world.rows(1, [7, 300, 2])
    assert np.array_equal(world.rows(1, [300])[0], block[1])
    again = synthetic_world("synthetic:3d-lin-lin-nd-eta5")
    assert np.array_equal(again.rows(1, [2, 7])[1], block[0])


def test_noise_differs_between_rows_and_seeds_and_has_the_stated_size():
    world = SyntheticWorld(
        "noise", (40, 40), 0.0, 0.0, (0.0, 0.0), (0.0, 0.0), noise=5.0, n_seeds=2
    )
    first, second = (world.returns(s, np.arange(100)) for s in (0, 1))
    z = np.concatenate([first, second]).ravel() / 5.0
    n = z.size
    assert abs(z.mean()) < 4 / np.sqrt(n)
    assert abs(z.std() - 1) < 4 / np.sqrt(2 * n)
    rows = np.corrcoef(np.vstack([first[:10], second[:10]]))
    assert np.abs(rows - np.eye(20)).max() < 0.15  # 6 sigma of independent rows of 1600


def test_worlds_of_other_names_have_noise_of_their_own():
    worlds = [
        linear_gap_world(100, noise=noise, name=name)
        for noise, name in ((0.1, "a"), (0.1, "b"), (0.0, "c"))
    ]
    one, other, smooth = (world.returns(0, np.arange(100)).ravel() for world in worlds)
    assert abs(np.corrcoef(one - smooth, other - smooth)[0, 1]) < 0.05
    few, usual = (synthetic_world(f"synthetic:1d-lin-lin-l1-eta5{seeds}") for seeds in ("@1", ""))
    np.testing.assert_array_equal(few.returns(0, [3]), usual.returns(0, [3]))


def test_bounds_are_exact_over_all_seeds_or_each_alone():
    for scale in ("all", "each"):
        world = SyntheticWorld(
            "w", (6, 5), np.arange(30), 0.0, (-1, -1), (1, 1), noise=2.0, n_seeds=3, scale=scale
        )
        matrices = np.array([world.returns(s, np.arange(30)) for s in range(3)])
        for s in range(3):
            of = matrices if scale == "all" else matrices[s]
            assert (world.bounds(s).low, world.bounds(s).high) == (of.min(), of.max())


@pytest.mark.parametrize("name", ["", "2d-lin-lin-nd-eta5", "3d-lin-lin-nd1-eta5", "3d-lin-lin-nd"])
def test_unknown_ids_are_refused(name):
    with pytest.raises(UnknownName, match="no synthetic world"):
        synthetic_world(f"synthetic:{name}")


def test_several_seeds_without_noise_would_be_one_matrix_counted_twice():
    with pytest.raises(InvalidInput, match="without noise"):
        synthetic_world("synthetic:linear-gap@3")
    with pytest.raises(InvalidInput, match="from 0 to 0"):
        synthetic_world("synthetic:linear-gap").rows(1, [0])


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"left": (1.0, 1.0)}, "per axis"),
        ({"noise": -1.0}, "noise"),
        ({"quality": np.zeros(3)}, "quality"),
        ({"n_seeds": 0}, "at least one seed"),
        ({"quality": np.nan}, "quality must be a finite number or 4 of them, got nan"),
        ({"difficulty": "a"}, "difficulty must be"),
        ({"shape": (2.5,)}, "a level count must be a whole number, got 2.5"),
        ({"n_seeds": 1.5}, "n_seeds must be a whole number"),
        ({"right": (np.inf,)}, "a slope, offset or noise must be finite"),
        ({"left": (None,)}, "a slope, offset or noise must be finite"),
        ({"offset": np.nan}, "a slope, offset or noise must be finite"),
        ({"theta": "a"}, "a slope, offset or noise must be a number"),
        ({"noise": "a"}, "noise must be a number"),
        ({"name": None}, "name is a text"),
    ],
)
def test_world_rules(change, match):
    rules = {
        "name": "w", "shape": (4,), "quality": 0.0, "difficulty": 0.0, "left": (-1.0,),
        "right": (1.0,),
    }  # fmt: skip
    with pytest.raises(InvalidInput, match=match):
        SyntheticWorld(**{**rules, **change})
