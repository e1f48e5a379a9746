"""DQN on whole episodes: how it explores, what it keeps and learns, and its place in the loop."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mbtl.engine.learners import networks
from mbtl.engine.learners.clock import Pace, clock_at
from mbtl.engine.learners.episodic import dqn
from mbtl.engine.learners.episodic.episodes import Episodes
from mbtl.engine.learners.recipes import EpisodicDQNRecipe
from mbtl.engine.worlds.environments import Discrete
from mbtl.problems import get_cmdp

CHOICES = Discrete(3)
D, A = 6, 2


def setting(acting, done=None, **changes):
    """Recipe, weights, and episodes of (D, 1, A) in which action a earns a, whatever is seen."""
    settings = {"hidden": (8,), "buffer_size": 16, "gradient_steps": 20, "gamma": 0.0, **changes}
    recipe = EpisodicDQNRecipe(**{"normalize_reward": False, "learning_rate": 1e-2, **settings})
    weights = jax.tree.map(jnp.asarray, networks.init_q_network(0, [2, 8, 3]))
    rng = np.random.default_rng(1)
    action = jnp.asarray(rng.integers(3, size=(D, 1, A)))
    lived = Episodes(
        obs=jnp.asarray(rng.standard_normal((D * A, 2)), jnp.float32),
        row=jnp.arange(D * A).reshape(D, 1, A),
        outputs=jnp.zeros((D, 1, A, 3)),
        action=action,
        value=jnp.zeros((D, 1, A)),
        acting=acting,
        reward=action.astype(jnp.float32),
        done=jnp.zeros((D, 1, A), bool) if done is None else done,
        last_value=jnp.zeros((1, A)),
        last_acting=jnp.ones((1, A), bool),
        score=jnp.zeros(1),
    )
    return recipe, weights, lived


learn, entered = jax.jit(dqn.learn, static_argnums=(0, 1)), jax.jit(dqn.entered)
EVERYBODY = jnp.ones((D, 1, A), bool)
ONE = EVERYBODY.at[:, :, 1].set(False)


def clock(number):
    return clock_at(jnp.int32(number), Pace.endless(10))


def test_it_begins_at_random_and_ends_greedily():
    recipe, values = EpisodicDQNRecipe(exploration_fraction=0.5), jnp.array([1.0, 5.0, 2.0])
    for progress, epsilon in ((0.0, 1.0), (0.25, 0.5), (0.5, 0.0), (0.9, 0.0)):
        chances = jax.nn.softmax(dqn.explored(recipe, jnp.float32(progress), values))
        rest = epsilon / 3
        np.testing.assert_allclose(chances, [rest, 1.0 - 2.0 * rest, rest], atol=1e-6)


def test_the_ring_keeps_decisions_that_are_known_to_their_end():
    done = jnp.zeros((D, 1, A), bool).at[2, 0, 0].set(True)  # and a new life begins
    acting = EVERYBODY.at[4:, 0, 0].set(False)  # the second life is cut off
    recipe, weights, lived = setting(acting, done)
    replay, kept = entered(dqn.start(recipe, weights), lived)
    assert int(kept) == 3 + 5  # of the first agent 0 to 2, of the other all but the last
    rows = np.asarray(replay)[: int(kept)]
    batch = dqn.unpacked(rows)
    obs = np.asarray(lived.obs)
    order = [0, 1, 2, 3, 4, 5, 7, 9]  # decision by decision, agent by agent
    np.testing.assert_array_equal(batch.obs, obs[order])
    np.testing.assert_array_equal(batch.terminated, [i == 4 for i in order])
    alive = batch.terminated == 0.0
    np.testing.assert_array_equal(batch.after[alive], obs[np.array(order)[alive] + A])
    np.testing.assert_array_equal(batch.action, np.asarray(lived.action).reshape(-1)[order])


def test_a_time_limit_that_is_an_end_is_known():
    recipe, weights, lived = setting(EVERYBODY)
    lived = lived._replace(last_acting=jnp.zeros((1, A), bool))
    replay, kept = entered(dqn.start(recipe, weights), lived)
    assert int(kept) == D * A
    ends = dqn.unpacked(np.asarray(replay)[: int(kept)]).terminated
    np.testing.assert_array_equal(ends, [0.0] * (D * A - A) + [1.0] * A)


def test_the_oldest_make_room():
    recipe, weights, lived = setting(EVERYBODY)
    memory = dqn.start(recipe, weights)
    for _ in range(2):
        replay, kept = entered(memory, lived)
        memory = memory._replace(replay=replay, kept=kept)
    assert int(memory.kept) == 20  # in 16 places: the ring begins with the last four
    np.testing.assert_array_equal(memory.replay[:4, :2], lived.obs[6:10])
    np.testing.assert_array_equal(memory.replay[4:10, :2], lived.obs[4:10])


def test_an_end_is_worth_nothing_and_a_life_that_goes_on_is():
    """Two states in turn, one reward each, over after the second: worth 1.5 and 1."""
    done = (jnp.arange(D) % 2 == 1)[:, None, None] & EVERYBODY
    recipe, weights, lived = setting(EVERYBODY, done, gamma=0.5, gradient_steps=50)
    obs = jnp.repeat(jnp.eye(2)[jnp.arange(D) % 2], A, axis=0)
    action = jnp.zeros((D, 1, A), int)
    lived = lived._replace(obs=obs, action=action, reward=jnp.ones((D, 1, A)))
    memory = dqn.start(recipe, weights)
    for number in range(20):
        # the other actions were never taken, and must not look better
        first = weights.actor[-1][1].at[1:].set(-5.0)
        weights = weights._replace(actor=(*weights.actor[:-1], (weights.actor[-1][0], first)))
        weights, memory = learn(CHOICES, recipe, weights, memory, lived, clock(number))
    values = networks.apply(weights.actor, jnp.eye(2), recipe.activation)[:, 0]
    np.testing.assert_allclose(values, [1.5, 1.0], atol=0.05)


def test_a_lost_simulation_fails_the_training():
    recipe, weights, lived = setting(EVERYBODY)
    lived = lived._replace(score=jnp.array([jnp.nan]))
    new, _ = learn(CHOICES, recipe, weights, dqn.start(recipe, weights), lived, clock(0))
    assert np.isnan(new.actor[0][0]).all()


def test_who_does_not_act_teaches_nothing():
    results = []
    for reward in (0.0, 50.0):
        recipe, weights, lived = setting(ONE)
        lived = lived._replace(reward=jnp.where(ONE, lived.reward, reward))
        memory = dqn.start(recipe, weights)
        results.append(learn(CHOICES, recipe, weights, memory, lived, clock(0))[0])
    for a, b in zip(*map(jax.tree.leaves, results), strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.long
def test_contexts_of_the_ring_are_trained_together_and_act_greedily():
    trainer = get_cmdp("ring-vel", engine="jax").trainer_for(
        "quick", algorithm="DQN", recipe_name="fast", episodes=4, eval_episodes=2,
        checkpoint_every=4, checkpoint_episodes=1,
        hyperparameters={"hidden": (8,), "gradient_steps": 5, "buffer_size": 500},
    )  # fmt: skip
    contexts = [{"hold": 20.0}, {"hold": 40.0}]
    policies = trainer.train_many(contexts, [1, 2], keep=("final",))["final"]
    assert trainer.recipe["acting"] == "mean"
    scores = trainer.evaluate_many(policies, contexts, [3, 4])
    assert ((scores > 0.0) & (scores < 4.5)).all()
    fresh = trainer.untrained(contexts[0])
    assert not np.array_equal(policies[0].weights[-1], fresh.weights[-1])
    again = trainer.train_many(contexts, [1, 2], keep=("final",))["final"]
    np.testing.assert_array_equal(policies[1].weights[0], again[1].weights[0])
