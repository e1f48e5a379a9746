"""CartPole with three axes: the 900 contexts of SD-MBTL (AAAI 2026)."""

import numpy as np
import pytest

from mbtl.problems import get_cmdp
from mbtl.zoo.benchmark import load_matrix

ID = "cartpole-masses-length"
NOMINAL = {"masspole": 0.1, "masscart": 1.0, "length": 0.5}
MULTIPLIERS = [0.2, 0.4, 0.6, 0.8, 1.0, 1.2, 1.4, 1.6, 1.8, 2.0]


def rollout(context, **switches):
    """Observations under the same seed and actions, the context hidden, to the end."""
    env = get_cmdp(ID, visibility="hidden", **switches).make_env(context)
    seen, ended = [env.reset(seed=1)[0]], False
    while not ended:
        observation, _, terminated, truncated, _ = env.step(len(seen) % 2)
        seen.append(observation)
        ended = terminated or truncated
    return np.array(seen)


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


def test_the_last_axis_is_the_fastest():
    space = get_cmdp(ID).space
    assert space.context(0) == {"masspole": 0.02, "masscart": 0.2, "length": 0.2}
    assert space.context(1) == {"masspole": 0.02, "masscart": 0.2, "length": 0.3}
    assert space.context(9) == {"masspole": 0.02, "masscart": 0.4, "length": 0.2}
    assert space.context(90) == {"masspole": 0.04, "masscart": 0.2, "length": 0.2}
    assert space.context(899) == {"masspole": 0.2, "masscart": 2.0, "length": 1.0}


def test_it_is_a_cartpole_like_the_others():
    cmdp, other = get_cmdp(ID), get_cmdp("cartpole-length")
    assert cmdp.nominal == cmdp.unit == NOMINAL
    assert (cmdp.bounds, cmdp.horizon) == (other.bounds, other.horizon)
    assert cmdp.presets == other.presets
    np.testing.assert_allclose(  # the same slope per multiple of the nominal value
        cmdp.theta / 0.2, other.theta / 0.1
    )
    assert get_cmdp(ID, grid="paper").space == cmdp.space


@pytest.mark.parametrize("axis", NOMINAL)
def test_every_axis_reaches_the_physics(axis):
    low, high = min(get_cmdp(ID).space.values(axis)), max(get_cmdp(ID).space.values(axis))
    one, two = (rollout({**NOMINAL, axis: value}) for value in (low, high))
    steps = min(len(one), len(two))
    np.testing.assert_array_equal(one[0], two[0])
    assert np.abs(one[:steps] - two[:steps]).max() > 1e-3


def test_the_reference_s_cart_mass_never_acts():
    one, two = (rollout({**NOMINAL, "masscart": mass}, physics="reference") for mass in (0.2, 2.0))
    np.testing.assert_array_equal(one, two)


def test_the_policy_sees_three_multipliers():
    env = get_cmdp(ID).make_env({"masspole": 0.02, "masscart": 2.0, "length": 0.3})
    np.testing.assert_allclose(env.reset(seed=0)[0][4:], [0.2, 2.0, 0.6], rtol=1e-6)


def test_both_engines_have_the_same_constants():
    pytest.importorskip("jax", reason="the jax extra is not installed")
    cmdp = get_cmdp(ID, engine="jax")
    contexts = [cmdp.space.context(i) for i in (0, 123, 899)]
    _, params = cmdp.trainer.problem(contexts)
    for i, context in enumerate(contexts):
        env = cmdp.make_env(context)
        assert tuple(field[i] for field in params[:-1]) == env.constants
        np.testing.assert_array_equal(params.visible[i], env.visible)


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
