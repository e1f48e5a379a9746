"""TRPO on whole episodes: each part has a closed form, and the whole learns to calm the ring."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import mbtl.engine.learners as engine
from mbtl.engine import worlds
from mbtl.engine.learners import networks
from mbtl.engine.learners.clock import Pace, clock_at
from mbtl.engine.learners.episodic import trpo
from mbtl.engine.learners.episodic.episodes import Episodes, actor_of, record
from mbtl.engine.learners.episodic.returns import Returns, advantages
from mbtl.engine.learners.networks import kl
from mbtl.engine.learners.recipes import TRPORecipe
from mbtl.engine.worlds.environments import Box, Discrete
from mbtl.problems import get_cmdp

BOX = Box((-1.0,), (1.0,))
RAW = {"normalize_reward": False, "center_reward": False}


def lived(rewards, acting=None, done=None, last_acting=False, value=0.0):
    """Episodes of one agent, (D, 1, 1), with zeros to observe; everything is worth `value`."""
    d = len(rewards)

    def column(x, dtype):
        return jnp.asarray(np.reshape(x, (d, 1, 1)), dtype)

    return Episodes(
        obs=jnp.zeros((d, 2)),
        row=jnp.arange(d).reshape(d, 1, 1),
        outputs=jnp.zeros((d, 1, 1, 1)),
        action=jnp.zeros((d, 1, 1, 1)),
        value=column([value] * d, jnp.float32),
        acting=column([True] * d if acting is None else acting, bool),
        reward=column(rewards, jnp.float32),
        done=column([False] * d if done is None else done, bool),
        last_value=jnp.full((1, 1), value),
        last_acting=jnp.full((1, 1), last_acting),
        score=jnp.zeros(1),
    )


# ---- parts ---------------------------------------------------------------------------------------


def test_conjugate_gradients_solve_a_small_system_exactly():
    rng = np.random.default_rng(0)
    root = rng.standard_normal((4, 4))
    matrix = jnp.asarray(root @ root.T + np.eye(4), jnp.float32)
    b = jnp.asarray(rng.standard_normal(4), jnp.float32)
    found = trpo.conjugate_gradients(lambda x: matrix @ x, b, 4)
    np.testing.assert_allclose(found, np.linalg.solve(matrix, b), rtol=1e-3)
    assert np.isfinite(trpo.conjugate_gradients(lambda x: matrix @ x, b, 50)).all()


def test_kl_of_gaussians_and_of_choices():
    old, new = jnp.array([[0.5]]), jnp.array([[1.5]])
    got = kl(old, jnp.log(jnp.array([2.0])), new, jnp.log(jnp.array([1.0])), BOX)
    assert float(got[0]) == pytest.approx(-np.log(2.0) + (4.0 + 1.0) / 2.0 - 0.5, rel=1e-6)
    p, q = np.array([0.2, 0.8]), np.array([0.5, 0.5])
    none = jnp.zeros(0)
    got = kl(jnp.log(p)[None], none, jnp.log(q)[None], none, Discrete(2))
    assert float(got[0]) == pytest.approx(float((p * np.log(p / q)).sum()), rel=1e-5)


def test_advantages_are_discounted_sums_less_the_value():
    recipe = TRPORecipe(gamma=0.5, **RAW)
    advantage, target, _ = advantages(
        recipe, Returns.empty(), lived([1.0, 2.0, 4.0], last_acting=True, value=1.0)
    )
    # the end of time is worth V = 1: 4 + .5, 2 + .5 (4.5), 1 + .5 (4.25)
    np.testing.assert_allclose(target[:, 0, 0], [3.125, 4.25, 4.5])
    np.testing.assert_allclose(advantage, target - 1.0)


def test_an_ended_life_is_worth_nothing_more_and_the_next_one_starts_afresh():
    recipe = TRPORecipe(gamma=0.5, **RAW)
    _, target, _ = advantages(
        recipe,
        Returns.empty(),
        lived([1.0, 2.0, 9.0, 4.0], acting=[1, 1, 0, 1], done=[0, 1, 0, 0], value=1.0),
    )
    np.testing.assert_allclose(target[:2, 0, 0], [2.0, 2.0])
    assert float(target[3, 0, 0]) == 4.0  # nobody is there at the end


def test_running_statistics_are_those_of_all_decisions_together():
    rng = np.random.default_rng(1)
    recipe = TRPORecipe(gamma=0.9, center_reward=False)
    parts = [rng.standard_normal(5), rng.standard_normal(9)]
    returns, sums = Returns.empty(), []
    for rewards in parts:
        returns = returns.updated(recipe, lived(rewards))
        total = 0.0
        for reward in rewards:
            total = 0.9 * total + reward
            sums.append(total)
    assert float(returns.count) == 14
    assert float(returns.mean) == pytest.approx(np.mean(sums), rel=1e-4)
    assert float(returns.variance) == pytest.approx(np.var(sums), rel=1e-4)
    assert float(returns.reward_mean) == pytest.approx(np.mean(np.concatenate(parts)), rel=1e-4)


def test_centred_rewards_are_scaled_by_the_deviation_of_their_own_sums():
    recipe = TRPORecipe(gamma=0.5)
    _, target, returns = advantages(recipe, Returns.empty(), lived([1.0, 2.0, 6.0]))
    sums = np.array([-2.0, -2.0, 2.0])  # of -2, -1, 3
    assert float(returns.reward_mean) == pytest.approx(3.0)
    assert float(returns.variance) == pytest.approx(sums.var(), rel=1e-5)
    np.testing.assert_allclose(target[:, 0, 0], np.array([-1.75, 0.5, 3.0]) / sums.std(), rtol=1e-5)


def test_living_on_at_a_cost_is_worth_less_where_lives_end():
    """Of rewards of -1, less their mean, six moments would be worth no less than two."""
    recipe = engine.recipe_named("PPO", "fast", "episodes")
    life = lived([-1.0] * 8, done=[0, 1, 0, 0, 0, 0, 0, 1])
    _, target, _ = advantages(recipe, Returns.empty(), life)
    assert float(target[2, 0, 0]) < 2.0 * float(target[0, 0, 0]) < 0.0


# ---- one update ----------------------------------------------------------------------------------


learn = jax.jit(trpo.learn, static_argnums=(0, 1))


def one_update(bounds=1e9, **changes):
    recipe = TRPORecipe(**changes)
    weights = networks.init_weights(0, 2, BOX, (8,))
    weights = jax.tree.map(jnp.asarray, weights)
    rng = np.random.default_rng(2)
    obs = jnp.asarray(rng.standard_normal((50, 1, 1, 2)), jnp.float32)
    outputs = networks.apply(weights.actor, obs)
    action = outputs + jnp.asarray(rng.standard_normal((50, 1, 1, 1)), jnp.float32)
    action = jnp.clip(action, -bounds, bounds)
    data = lived(np.zeros(50))._replace(obs=obs[:, 0, 0], outputs=outputs, action=action)
    data = data._replace(reward=jnp.clip(action[..., 0], -1.0, 1.0))  # larger actions pay
    memory = trpo.start(recipe, weights)
    new, _ = learn(BOX, recipe, weights, memory, data, clock_at(jnp.int32(0), Pace.endless(1)))
    after = networks.apply(new.actor, obs)
    moved = kl(outputs, weights.log_std, after, new.log_std, BOX).mean()
    return float(moved), float((after - outputs).mean())


def test_a_step_uses_the_trust_region_and_stays_in_it():
    max_kl = 0.001
    moved, shift = one_update(max_kl=max_kl, gae_lambda=0.0, normalize_reward=False)
    assert 0.2 * max_kl < moved <= max_kl
    assert shift > 0.0  # towards what paid


def test_learning_sees_the_actions_that_were_applied():
    assert one_update() == one_update(bounds=1.0, clip_actions=False)
    assert one_update() != one_update(clip_actions=False)


def test_a_step_that_would_not_pay_is_not_made():
    moved, shift = one_update(accept=1e6)
    assert moved == shift == 0.0


# ---- whole trainings -----------------------------------------------------------------------------


def test_episodes_record_what_was_done():
    trainer = get_cmdp("ring-vel", engine="jax").trainer_for("quick")
    twin, params = trainer.problem([{"hold": 40.0}])
    params = worlds.context_of(params, 0)
    recipe = TRPORecipe()
    state = engine.start(twin, recipe, [5], params).state
    seeds = np.arange(3, dtype=np.uint32)[None]
    played = jax.jit(record, static_argnums=(0, 1, 2))
    got = played(twin, "tanh", 10, actor_of(state.weights), seeds, params)
    obs = got.obs[:, got.row[0]]
    assert obs.shape == (1, 10, 3, 1, 3)
    assert set(np.unique(got.action)) <= set(range(10))
    assert got.acting.all()
    found = (got.outputs, state.weights.actor), (got.value[..., None], state.weights.critic)
    for of_moment, network in found:
        whole = jax.vmap(networks.apply)(network, obs)
        np.testing.assert_allclose(of_moment, whole, atol=1e-6)
