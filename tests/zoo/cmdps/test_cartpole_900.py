"""CartPole with three axes: the 900 contexts of SD-MBTL (AAAI 2026)."""

import numpy as np

from mbtl.problems import get_cmdp
from mbtl.zoo.benchmark import load_matrix

ID = "cartpole-masses-length"
NOMINAL = {"masspole": 0.1, "masscart": 1.0, "length": 0.5}
MULTIPLIERS = [0.2, 0.4, 0.6, 0.8, 1.0, 1.2, 1.4, 1.6, 1.8, 2.0]


def test_the_grid_is_the_follow_up_s():
    space = get_cmdp(ID).space
    assert space.shape == (10, 10, 9)
    assert [(axis.name, axis.unit) for axis in space.axes] == [
        ("masspole", "kg"), ("masscart", "kg"), ("length", "m"),
    ]  # fmt: skip
    for name, nominal in NOMINAL.items():
        multiples = MULTIPLIERS[1:] if name == "length" else MULTIPLIERS
        levels = list(dict.fromkeys(space.values(name)))
        assert levels == [round(nominal * m, 2) for m in multiples], "as their scripts round them"


def test_it_is_a_cartpole_like_the_others():
    cmdp, other = get_cmdp(ID), get_cmdp("cartpole-length")
    assert cmdp.nominal == cmdp.unit == NOMINAL
    assert (cmdp.bounds, cmdp.horizon) == (other.bounds, other.horizon)
    assert cmdp.presets == other.presets
    np.testing.assert_allclose(  # the same slope per multiple of the nominal value
        cmdp.theta / 0.2, other.theta / 0.1
    )
    assert get_cmdp(ID, grid="paper").space == cmdp.space


def test_the_shipped_matrix_is_of_this_problem():
    matrix = load_matrix(ID)
    cmdp = get_cmdp(ID)
    assert matrix.returns.shape == (matrix.n_seeds, 900, 900)
    assert matrix.std.shape == matrix.returns.shape
    assert matrix.space == cmdp.space
    assert (matrix.bounds.low, matrix.bounds.high) == cmdp.bounds
    assert matrix.theta == cmdp.theta
    assert matrix.returns.min() >= 1.0
    assert matrix.returns.max() == 500.0
    for seed, record in enumerate(matrix.provenance["seeds"]):
        assert (record["problem"], record["version"], record["seed"]) == (ID, cmdp.version, seed)
        assert record["switches"] == get_cmdp(ID, engine="jax").settings
