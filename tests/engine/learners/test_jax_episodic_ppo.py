"""PPO on whole episodes: the rows it learns from, its limits, and its place in the loop."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mbtl.engine.learners import networks
from mbtl.engine.learners.clock import Pace, clock_at
from mbtl.engine.learners.episodic import ppo
from mbtl.engine.learners.episodic.episodes import Episodes
from mbtl.engine.learners.episodic.returns import Returns
from mbtl.engine.learners.networks import kl
from mbtl.engine.learners.recipes import TWIN_RECIPES, EpisodicPPORecipe
from mbtl.engine.worlds.environments import Box

BOX = Box((-1.0,), (1.0,))
D, A = 60, 3


def setting(acting, **changes):
    """Recipe, weights, and episodes in which larger actions pay; a life ends with its last row."""
    settings = {"rows": 64, "minibatches": 4, "hidden": (8,), "learning_rate": 1e-2, **changes}
    recipe = EpisodicPPORecipe(**settings)
    weights = jax.tree.map(jnp.asarray, networks.init_weights(0, 2, BOX, (8,)))
    rng = np.random.default_rng(1)
    obs = jnp.asarray(rng.standard_normal((D, 1, A, 2)), jnp.float32)
    outputs = networks.apply(weights.actor, obs)
    action = outputs + jnp.asarray(rng.standard_normal((D, 1, A, 1)), jnp.float32)
    reward = jnp.where(acting, action[..., 0], 0.0)
    lived = Episodes(
        obs=obs.reshape(-1, 2),
        row=jnp.arange(D * A).reshape(D, 1, A),
        outputs=outputs,
        action=action,
        value=networks.apply(weights.critic, obs)[..., 0],
        acting=acting,
        reward=reward,
        done=acting & ~jnp.roll(acting, -1, axis=0),
        last_value=jnp.zeros((1, A)),
        last_acting=jnp.zeros((1, A), bool),
        score=jnp.zeros(1),
    )
    return recipe, weights, lived


learn, rows_of = (jax.jit(f, static_argnums=(0, 1)) for f in (ppo.learn, ppo.rows_of))


def updated(recipe, weights, lived, number=0):
    pace = (Pace.falling if recipe.anneal else Pace.endless)(10)
    clock = clock_at(jnp.int32(number), pace)
    return learn(BOX, recipe, weights, ppo.start(recipe, weights), lived, clock)


EVERYBODY = jnp.ones((D, 1, A), bool)
FEW = EVERYBODY.at[:, :, 1:].set(False).at[20:].set(False)  # 20 decisions


@pytest.mark.parametrize(("acting", "rows", "count"), [(EVERYBODY, 64, 64), (FEW, 64, 20)])
def test_rows_are_decisions_of_agents_and_nothing_else(acting, rows, count):
    recipe, weights, lived = setting(acting, rows=rows)
    marked = lived._replace(obs=jnp.where(acting.reshape(-1, 1), lived.obs, 77.0))
    batch, _ = rows_of(BOX, recipe, weights, Returns.empty(), marked, jax.random.PRNGKey(0))
    assert int(batch.weight.sum()) == count
    used = np.asarray(batch.obs)[np.asarray(batch.weight) == 1.0]
    assert (used != 77.0).all()
    assert len(np.unique(used[:, 0])) == count  # without repetition


def test_a_place_without_an_agent_changes_nothing():
    results = []
    for filler in (0.0, 5.0):
        recipe, weights, lived = setting(FEW)
        other = jnp.where(FEW.reshape(-1, 1), lived.obs, filler)
        results.append(updated(recipe, weights, lived._replace(obs=other))[0])
    for a, b in zip(*map(jax.tree.leaves, results), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-6)


def moved(recipe, weights, lived):
    new, memory = updated(recipe, weights, lived)
    after = networks.apply(new.actor, lived.obs)[lived.row]
    apart = kl(lived.outputs, weights.log_std, after, new.log_std, BOX).mean()
    return float(apart), float((after - lived.outputs).mean()), memory


def test_it_moves_towards_what_paid_and_stops_when_far():
    options = {"gae_lambda": 0.0, "normalize_advantage": True, "n_epochs": 30, "clip_range": 0.2}
    near, shift, _ = moved(*setting(EVERYBODY, target_kl=0.02, **options))
    far, larger, memory = moved(*setting(EVERYBODY, target_kl=10.0, kl_coef=0.1, **options))
    assert 0.0 < near < 0.06 < far
    assert 0.0 < shift < larger
    assert float(memory.kl_coef) == pytest.approx(0.05)  # a penalty that is not needed


@pytest.mark.parametrize(("before", "after"), [(0.1, 0.15), (0.0, 0.0)])
def test_the_penalty_follows_the_kl_and_none_stays_none(before, after):
    recipe, weights, lived = setting(EVERYBODY, target_kl=1e-9, kl_coef=before)
    _, memory = updated(recipe, weights, lived)
    assert float(memory.kl_coef) == pytest.approx(after)


def test_updates_draw_other_rows():
    recipe, weights, lived = setting(EVERYBODY)
    one, two = (updated(recipe, weights, lived, number)[0] for number in (0, 1))
    assert any(
        not np.array_equal(a, b)
        for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(two), strict=True)
    )


def test_a2c_is_one_step_along_the_policy_gradient():
    recipe, weights, lived = setting(EVERYBODY)
    recipe = replace(TWIN_RECIPES["A2C"]["fast"], rows=D * A, hidden=(8,), value_coef=0.0)
    key = jax.random.PRNGKey(0)
    batch, _ = rows_of(BOX, recipe, weights, Returns.empty(), lived, key)

    def plain(actor):
        outputs = networks.apply(actor, batch.obs)
        return -(
            batch.advantage * networks.log_prob(outputs, weights.log_std, batch.action, BOX)
        ).mean()

    (new, _), slope = updated(recipe, weights, lived), jax.jit(jax.grad(plain))(weights.actor)
    for before, after, g in zip(
        *map(jax.tree.leaves, (weights.actor, new.actor, slope)), strict=True
    ):
        clear = np.abs(g) > 1e-4  # Adam's first step is the sign of the gradient
        np.testing.assert_array_equal(np.sign(before - after)[clear], np.sign(g)[clear])
        np.testing.assert_allclose(np.abs(before - after)[clear], recipe.learning_rate, rtol=0.05)
