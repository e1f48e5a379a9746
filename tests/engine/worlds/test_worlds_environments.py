"""The pure environments step as the Gymnasium ones do."""

from itertools import product

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mbtl.engine import worlds
from mbtl.errors import InvalidInput
from mbtl.zoo.cmdps import cartpole, pendulum
from mbtl.zoo.worlds import CartPole, Pendulum


def corners(**ends):
    """Of the paper's grids."""
    return [dict(zip(ends, values, strict=True)) for values in product(*ends.values())]


def cartpole_pairs():
    """(Gymnasium environment, constants) per corner, by the intended physics and by the frozen."""
    for context in corners(masscart=(0.1, 10.0), masspole=(0.01, 1.0), length=(0.05, 5.0)):
        for physics in ("intended", "reference"):
            env = cartpole.CartPole(context, physics=physics)
            yield env, cartpole.derive(env.features, physics)


def pendulum_pairs():
    for context in corners(timestep=(0.005, 0.5), mass=(0.1, 10.0), length=(0.1, 10.0)):
        env = pendulum.Pendulum(context)
        yield env, pendulum.derive(env.features)


FAMILIES = {"cartpole": (CartPole(), cartpole_pairs), "pendulum": (Pendulum(), pendulum_pairs)}


def random_actions(name, rng, n):
    if name == "cartpole":
        return rng.integers(0, 2, n)
    return rng.uniform(-3, 3, (n, 1)).astype(np.float32)  # beyond the torque limit, too


@pytest.mark.parametrize("name", FAMILIES)
def test_rollouts_agree_in_float64_up_to_the_first_termination(name):
    env, pairs = FAMILIES[name]
    with jax.enable_x64(True):
        step = jax.jit(env.step)
        for index, (gym_env, constants) in enumerate(pairs()):
            params = jax.tree.map(
                lambda x: jnp.asarray(x[0], jnp.float64), worlds.stack_params(env, [constants])
            )
            gym_env.reset(seed=index)
            noise = np.random.default_rng(index).random(env.n_noise)
            state = env.initial(jnp.asarray(noise), params)
            np.testing.assert_allclose(np.stack(state), gym_env.state, rtol=0, atol=1e-15)
            rng = np.random.default_rng(index)
            for _ in range(200):
                action = random_actions(name, rng, 1)[0]
                state, reward, terminated = step(state, jnp.asarray(action), params)
                _, theirs, ended, truncated, _ = gym_env.step(action)
                np.testing.assert_allclose(np.stack(state), gym_env.state, rtol=1e-8, atol=1e-8)
                assert float(reward) == pytest.approx(theirs, rel=1e-8, abs=1e-8)
                assert bool(terminated) == ended
                if ended or truncated:
                    break


def nominal(world):
    constants = cartpole.derive(cartpole.CartPole.FEATURES)
    return jax.tree.map(lambda x: jnp.float32(x[0]), worlds.stack_params(world, [constants]))


def test_a_seed_or_a_key_starts_episodes_within_the_reset_range():
    world = worlds.Solo(CartPole())
    params = nominal(world)
    for drawn in (jnp.arange(2000, dtype=jnp.uint32), world.noise(jax.random.key(0), (2000,))):
        states = np.stack(world.start(drawn, params).env)
        assert np.abs(states).max() <= cartpole.RESET_HALF_WIDTH
        np.testing.assert_allclose(states.mean(axis=1), 0.0, atol=0.005)
        assert states.std() > 0.02


def test_what_comes_after_a_terminal_state_does_not_count():
    world = worlds.Solo(CartPole())
    params = nominal(world)
    state = world.start(world.draws(np.arange(3, dtype=np.uint32)), params)
    pushed, step = jnp.ones((3, 1), jnp.int32), jax.jit(world.step)
    rewards, deaths = np.zeros(3), np.zeros(3)
    for _ in range(30):
        moved = step(state, pushed, params)
        state = moved.state
        rewards += moved.reward[:, 0]
        deaths += moved.done[:, 0]
    assert world.over(state).all()
    assert not world.observe(state, params).acting.any()
    np.testing.assert_array_equal(world.score(state), rewards)
    np.testing.assert_array_equal(deaths, 1)  # an agent dies once
    assert rewards.max() < 15


def test_parameters_are_matched_by_name():
    world = worlds.Solo(CartPole())
    constants = cartpole.derive(cartpole.CartPole.FEATURES)
    named = dict(reversed(constants._asdict().items()))
    params = worlds.stack_params(world, [constants, named])
    for field in params[:-1]:
        assert field[0] == field[1]
    with pytest.raises(InvalidInput, match="named gravity"):
        worlds.stack_params(world, [{**named, "wind": 1.0}])
    with pytest.raises(InvalidInput, match="no names"):
        worlds.stack_params(world, [tuple(constants)])


def test_visible_features_need_one_row_per_context():
    constants = pendulum.derive(pendulum.Pendulum.FEATURES)
    with pytest.raises(InvalidInput, match="one row per context"):
        worlds.stack_params(Pendulum(), [constants], [[1.0], [2.0]])
