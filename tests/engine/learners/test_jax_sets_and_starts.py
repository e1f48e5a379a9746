"""Policies with a set of contexts each, and trainings that begin from given weights."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import poles
import pytest
from poles import assert_same

import mbtl.engine.learners as engine
from mbtl.engine import worlds
from mbtl.engine.learners import algorithms
from mbtl.engine.learners.rollout import draw, play
from mbtl.errors import InvalidInput
from mbtl.zoo.worlds import CartPole

CARTPOLE = worlds.Solo(CartPole(horizon=60))
params_of = partial(poles.params_of, CARTPOLE)
TINY = engine.PPORecipe(n_envs=2, n_steps=32, batch_size=32, n_epochs=2, learning_rate=1e-3)
ON_SETS = engine.MultiTaskRecipe.of("ppo", TINY)
SMALL_REPLAY = engine.DQNRecipe(n_envs=2, buffer_size=800, learning_starts=0)


# ---- sets ----------------------------------------------------------------------------------------


def test_each_policy_plays_all_of_its_own_set_and_nothing_else():
    lengths = np.array([[0.1, 0.2, 0.3, 0.4], [1.0, 2.0, 4.0, 5.0]])
    recipe = replace(ON_SETS, n_steps=240, batch_size=48)
    params = jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), params_of(lengths))
    state = algorithms.init(CARTPOLE, recipe, [0, 1], params)

    def seen(state, params):
        _, noise = draw(CARTPOLE, state.key, (240, 2))
        return play(CARTPOLE, recipe, state, params, noise)[1].obs[..., -1]

    visible = np.asarray(jax.jit(jax.vmap(seen))(state, params))
    for own, expected in zip(visible, np.asarray(params.visible), strict=True):
        np.testing.assert_array_equal(np.unique(own), np.unique(expected))


def test_episodes_that_a_set_cannot_share_are_refused():
    with pytest.raises(InvalidInput, match="a multiple of the 4 contexts of each policy, got 10"):
        engine.train(CARTPOLE, ON_SETS, [3], params_of([[0.5, 1.0, 1.5, 2.0]]), 192)


# ---- given weights -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("recipe", "lengths"),
    [
        (TINY, [0.5, 1.0]),
        (engine.A2CRecipe(n_envs=2), [0.5, 1.0]),
        (SMALL_REPLAY, [0.5, 1.0]),
        (engine.MultiTaskRecipe.of("paco", TINY, 2), [[0.5, 1.0], [2.0, 3.0]]),
    ],
    ids=["ppo", "a2c", "dqn", "paco"],
)
def test_only_the_networks_come_from_the_given_weights(recipe, lengths):
    params = params_of(lengths)
    given = engine.start(CARTPOLE, recipe, [8, 9], params).state.weights
    fresh = engine.start(CARTPOLE, recipe, [0, 1], params)
    begun = engine.start(CARTPOLE, recipe, [0, 1], params, given)
    assert_same(begun.state.weights, given)
    assert_same(begun.best, given)
    networks = {"weights": None, "target": None} if recipe is SMALL_REPLAY else {"weights": None}
    assert_same(begun.state._replace(**networks), fresh.state._replace(**networks))
    assert_same(begun.best_return, fresh.best_return)
    if recipe is SMALL_REPLAY:
        assert_same(begun.state.target, given.actor)


def test_weights_of_another_shape_are_refused():
    wide = replace(TINY, hidden=(128, 128))
    given = engine.start(CARTPOLE, wide, [0], params_of([0.5])).state.weights
    with pytest.raises(InvalidInput, match="must have the shapes of this recipe"):
        engine.train(CARTPOLE, TINY, [0], params_of([0.5]), 64, weights=given)
    two = engine.start(CARTPOLE, TINY, [0, 1], params_of([0.5, 1.0])).state.weights
    with pytest.raises(InvalidInput, match="number of policies"):
        engine.start(CARTPOLE, TINY, [0], params_of([0.5]), two)
