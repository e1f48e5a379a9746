"""PPO learns in the units of what it sees, and nobody else notices."""

import math

import numpy as np

import mbtl.engine.learners as engine
from mbtl.engine import worlds
from mbtl.engine.learners import networks
from mbtl.engine.learners.units import Units
from mbtl.zoo.cmdps import pendulum
from mbtl.zoo.worlds import Pendulum

RNG = np.random.default_rng(0)
OBS = np.float32(RNG.normal([0.0, 5.0, -300.0, 0.7], [1.0, 0.01, 80.0, 0.0], (500, 4)))
NETWORK = networks.init_weights(0, 4, worlds.Discrete(3), (8, 8)).actor


def test_a_network_says_the_same_in_other_units():
    units = Units.of(OBS.reshape(50, 10, 4))
    seen = units.measured(OBS)
    np.testing.assert_allclose(seen[:, :3].mean(axis=0), 0.0, atol=1e-3)
    np.testing.assert_allclose(seen[:, :3].std(axis=0), 1.0, rtol=1e-3)
    entered = units.entered(NETWORK)
    np.testing.assert_allclose(
        networks.apply(entered, seen), networks.apply(NETWORK, OBS), atol=1e-5
    )
    for back, given in zip(units.left(entered), NETWORK, strict=True):
        for a, b in zip(back, given, strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-4, atol=1e-4)


def test_a_number_that_never_changes_is_taken_as_it_is():
    units = Units.of(OBS)
    assert (units.mean[3], units.spread[3]) == (0.0, 1.0)
    np.testing.assert_array_equal(units.measured(OBS)[:, 3], OBS[:, 3])


def test_the_first_rollout_only_shows_the_units():
    world = worlds.Solo(Pendulum(horizon=50))
    params = worlds.stack_params(world, [pendulum.Pendulum({}).constants])
    recipe = engine.PPORecipe(n_envs=4, n_steps=64, batch_size=64, n_epochs=2, standardize=True)
    new = engine.start(world, recipe, [3], params).state.weights
    one = engine.train(world, recipe, [3], params, 1, checkpoint_episodes=1).state.weights
    two = engine.train(world, recipe, [3], params, 512, checkpoint_episodes=1).state.weights
    (weight, bias), (scaled, moved) = new.actor[0], one.actor[0]
    spread = np.median(np.asarray(weight / scaled)[0], axis=-1)  # (3,) of cos t, sin t, w
    np.testing.assert_allclose(weight, scaled * spread[None, :, None], rtol=1e-3)
    assert spread[2] > 2 * spread[0]  # speeds are larger than cosines
    assert np.isfinite(moved - bias).all()
    for a, b in zip(new.actor[1:], one.actor[1:], strict=True):
        np.testing.assert_array_equal(a[0], b[0])
    assert not np.array_equal(one.actor[1][0], two.actor[1][0])
    assert math.isfinite(float(two.actor[1][0].sum()))
