"""One policy for all contexts: turns, composition, orthogonality, learning, resuming."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from poles import params_of

import mbtl.engine.learners as engine
from mbtl.engine import worlds
from mbtl.engine.learners import algorithms, networks
from mbtl.engine.learners.evaluation import own_measures
from mbtl.engine.learners.multitask import moore, paco, table
from mbtl.engine.learners.networks import Weights
from mbtl.engine.learners.rollout import draw, play
from mbtl.engine.worlds.copies import take_turns
from mbtl.zoo.worlds import CartPole

TINY = engine.PPORecipe(n_envs=3, n_steps=32, batch_size=48, n_epochs=1, learning_rate=1e-3)
CARTPOLE = worlds.Solo(CartPole(horizon=60))


LENGTHS = (0.1, 0.5, 1.0, 2.0, 5.0)


def recipe_of(method, n_parts=3, **changes):
    return engine.MultiTaskRecipe.of(method, replace(TINY, **changes), n_parts)


# ---- turns ---------------------------------------------------------------------------------------


def test_copies_that_end_together_take_the_next_contexts_in_order():
    context, turn = take_turns(
        jnp.array([0, 1, 2, 3]), jnp.int32(4), jnp.array([True, False, True, True]), 6
    )
    np.testing.assert_array_equal(context, [4, 1, 5, 0])
    assert int(turn) == 1
    same, turn = take_turns(context, turn, jnp.zeros(4, bool), 6)
    np.testing.assert_array_equal(same, context)
    assert int(turn) == 1


def test_every_context_is_started_equally_often():
    """Short and long episodes, more copies than contexts; read off the observations."""
    recipe = engine.MultiTaskRecipe.of("paco", replace(TINY, n_envs=7, n_steps=240))
    params = engine.in_sets(recipe, params_of(CARTPOLE, LENGTHS), 5)
    state = algorithms.init(CARTPOLE, recipe, [0], params)

    def played(state, params):
        _, noise = draw(CARTPOLE, state.key, (recipe.n_steps, recipe.n_envs))
        return play(CARTPOLE, recipe, state, params, noise)

    _, rollout = jax.jit(jax.vmap(played))(
        state, jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), params)
    )
    contexts = np.asarray(rollout.obs)[0, :, :, -1].astype(int)
    done = np.asarray(rollout.done)[0]
    started = list(contexts[0])
    for t in range(239):
        before, after = contexts[t], contexts[t + 1]
        started += list(after[done[t]])
        np.testing.assert_array_equal(before[~done[t]], after[~done[t]])
    np.testing.assert_array_equal(started, np.arange(len(started)) % 5)
    assert len(started) > 8


# ---- vectors per context -------------------------------------------------------------------------


def test_vectors_are_interpolated_between_contexts():
    rows = np.random.default_rng(0).normal(size=(5, 3)).astype(np.float32)
    np.testing.assert_array_equal(table.rows_at(rows, jnp.arange(5.0)), rows)
    between = table.rows_at(rows, jnp.array([1.25]))
    np.testing.assert_allclose(between[0], 0.75 * rows[1] + 0.25 * rows[2], rtol=1e-6)


def test_vectors_begin_as_hats_of_the_axis():
    hats = table.initial_table(5, 3)
    expected = [[1, 0, 0], [0.5, 0.5, 0], [0, 1, 0], [0, 0.5, 0.5], [0, 0, 1]]
    np.testing.assert_allclose(hats, expected)
    np.testing.assert_array_equal(table.initial_table(4, 1), np.ones((4, 1)))


# ---- PaCo ----------------------------------------------------------------------------------------


def paco_weights(vectors):
    init = paco.init_weights(CARTPOLE, recipe_of("paco"), 3, n_contexts=5, n_inputs=5)
    return init._replace(vectors=jnp.asarray(vectors, jnp.float32))


def composed(weights, places):
    """Ordinary networks at `places`, leading axis, by the definition."""
    mixture = table.rows_at(weights.vectors, places)
    sets = Weights(weights.actor_sets, weights.critic_sets, ())
    mixed = jax.tree.map(lambda part: jnp.tensordot(mixture, part, axes=1), sets)
    return mixed._replace(log_std=jnp.tile(weights.log_std, (len(mixture), 1)))


def test_the_composed_network_is_what_acts():
    vectors = np.random.default_rng(1).normal(size=(5, 3))
    weights = paco_weights(vectors)
    places = jnp.array([0.0, 2.0, 3.5])
    seen = jnp.asarray(np.random.default_rng(2).normal(size=(3, 7, 5)), jnp.float32)
    with_place = jnp.concatenate([seen, jnp.broadcast_to(places[:, None, None], (3, 7, 1))], -1)
    ordinary = jax.jit(jax.vmap(networks.apply))(composed(weights, places).actor, seen)
    found = jax.jit(networks.apply)(weights.actor, with_place)
    np.testing.assert_allclose(found, ordinary, rtol=1e-4, atol=1e-6)


def test_a_context_moves_its_own_vector_and_all_parameter_sets():
    weights = paco_weights(np.random.default_rng(1).normal(size=(5, 3)))
    observation = jnp.array([0.1, -0.2, 0.05, 0.3, 1.0, 2.0])  # the place is 2

    def loss(weights):
        return jnp.square(networks.apply(weights.actor, observation)).sum()

    gradient = jax.jit(jax.grad(loss))(weights)
    moved = np.abs(gradient.vectors).sum(axis=1) > 0
    np.testing.assert_array_equal(moved, [False, False, True, False, False])
    assert (np.abs(gradient.actor_sets[0][0]).max(axis=(1, 2)) > 0).all()
    assert not np.abs(gradient.critic_sets[0][0]).any()


# ---- MOORE ---------------------------------------------------------------------------------------


def test_gram_schmidt_gives_the_orthonormal_basis_of_qr():
    vectors = np.random.default_rng(0).normal(size=(4, 10, 64)).astype(np.float32)
    basis = np.asarray(moore.orthonormal(list(jnp.asarray(vectors))))
    products = np.einsum("ibn,jbn->bij", basis, basis)
    np.testing.assert_allclose(products, np.broadcast_to(np.eye(4), (10, 4, 4)), atol=1e-5)
    q, r = np.linalg.qr(vectors[:, 0].T.astype(float))
    np.testing.assert_allclose(basis[:, 0].T, q * np.sign(np.diag(r)), atol=1e-5)


def test_gram_schmidt_passes_the_gradient_and_survives_zeros():
    vectors = jnp.asarray(np.random.default_rng(0).normal(size=(3, 8)), jnp.float32)
    target = jnp.asarray(np.random.default_rng(1).normal(size=(3, 8)), jnp.float32)

    def loss(vectors):
        return (jnp.stack(moore.orthonormal(list(vectors))) * target).sum()

    slope = jax.jit(jax.grad(loss))
    assert np.abs(slope(vectors)).min() > 0.0
    assert np.isfinite(slope(jnp.zeros((3, 8)))).all()


def test_task_weights_mix_the_representations():
    weights = moore.init_weights(CARTPOLE, recipe_of("moore"), 3, n_contexts=5, n_inputs=5)
    seen = jnp.asarray(np.random.default_rng(0).normal(size=5), jnp.float32)
    experts = [
        networks.apply(jax.tree.map(lambda x, k=k: jnp.asarray(x[k]), weights.actor.experts), seen)
        for k in range(3)
    ]
    q, r = np.linalg.qr(np.stack(experts).T.astype(float))
    basis = q * np.sign(np.diag(r))
    for place, mixture in [(0.0, [1, 0, 0]), (1.0, [0.5, 0.5, 0]), (1.5, [0.25, 0.75, 0])]:
        expected = np.tanh(basis @ mixture) @ weights.actor.head[0]
        observation = jnp.append(seen, place)
        outputs = networks.apply(jax.tree.map(jnp.asarray, weights.actor), observation)
        np.testing.assert_allclose(outputs, expected, rtol=1e-3, atol=1e-6)


# ---- training ------------------------------------------------------------------------------------


@pytest.mark.long
@pytest.mark.parametrize("method", ["ppo", "paco", "moore"])
def test_cartpole_is_learnt_on_all_contexts(method):
    ppo = engine.PPORecipe(n_envs=10, n_steps=64, batch_size=128, n_epochs=4, learning_rate=2e-3)
    env, recipe = worlds.Solo(CartPole(horizon=200)), engine.MultiTaskRecipe.of(method, ppo, 2)
    scores = []
    sets = engine.in_sets(recipe, params_of(env, (0.25, 0.5, 1.0)), 3)
    start = engine.start(env, recipe, [0], sets)
    training = engine.train(
        env, recipe, [0], sets, 40_000, checkpoint_every=8_000, checkpoint_episodes=6,
        on_block=lambda block: scores.append(float(block.training.latest_return[0])),
    )  # fmt: skip
    contexts, seeds = worlds.context_of(sets, 0), np.arange(15).reshape(3, 5)
    returns = {
        name: engine.evaluate(env, engine.actor_of(weights), contexts, seeds)
        for name, weights in [("start", start.state.weights), ("best", training.best)]
    }
    assert returns["best"].shape == (1, 3, 5)
    assert returns["best"].mean() > 150 > 60 > returns["start"].mean()
    assert float(training.best_return[0]) == max(scores)
    assert max(scores) == pytest.approx(returns["best"].mean(), rel=0.2)
    weights = (start.state.weights, training.state.weights)
    for old, new in zip(*map(jax.tree.leaves, weights), strict=True):
        assert old.size == 0 or (np.asarray(old) != np.asarray(new)).mean() > 0.5


# ---- evaluation ----------------------------------------------------------------------------------


def test_a_checkpoint_is_scored_on_every_context_from_different_states():
    params, recipe = params_of(CARTPOLE, LENGTHS), recipe_of("ppo")
    sets = engine.in_sets(recipe, params, 5)
    weights = engine.start(CARTPOLE, recipe, [4], sets).state.weights
    actor, seeds = engine.actor_of(weights), np.arange(10, dtype=np.uint32)
    stacked = jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), sets)
    dealt = np.asarray(
        own_measures(CARTPOLE, "tanh", "mean", actor, seeds[None], stacked)["score"]
    ).reshape(5, 2)
    assert len(np.unique(dealt)) > 2
    played = engine.evaluate(CARTPOLE, actor, params, seeds.reshape(5, 2))[0]
    np.testing.assert_array_equal(dealt, played)
