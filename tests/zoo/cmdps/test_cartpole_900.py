"""CartPole with three axes: the 900 contexts of SD-MBTL (AAAI 2026)."""

import numpy as np

from mbtl.problems import get_cmdp
from mbtl.zoo.benchmark import load_matrix

ID = "cartpole-masses-length"
NOMINAL = {"masspole": 0.1, "masscart": 1.0, "length": 0.5}


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
