"""DQN in jax: targets, ring, epsilon and a gradient step by their definitions, and it learns."""

from dataclasses import replace
from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from poles import assert_same, first, params_of, same, single

import mbtl.engine.learners as engine
from mbtl.engine import worlds
from mbtl.engine.learners import dqn, networks
from mbtl.engine.learners.clock import Pace, clock_at
from mbtl.zoo.cmdps import cartpole
from mbtl.zoo.worlds import CartPole

# one round is an update, and an update is shorter than the ring
TINY = engine.DQNRecipe(
    n_envs=64, train_freq=4, batch_size=16, buffer_size=512, learning_starts=256, target_every=512,
    exploration_fraction=0.5, learning_rate=1e-3, hidden=(8,),
)  # fmt: skip
ENV = worlds.Solo(CartPole(horizon=7))  # episodes are cut off
CARTPOLE = worlds.Solo(CartPole())
FAST = replace(  # compiled once, with P = 2; for fewer steps than the recipe is for
    engine.recipe_named("DQN", "fast"), batch_size=64, gradient_steps=4, learning_rate=1e-3,
    target_every=512, exploration_fraction=0.2,
)  # fmt: skip
FEATURES = 4


@cache
def states_of(recipe):
    """The state before the first of five updates, and after each."""
    state, params = single(dqn, ENV, recipe)
    step = jax.jit(partial(dqn.update, ENV, recipe))
    states = [state]
    for k in range(5):
        states.append(step(states[-1], params, clock_at(jnp.int32(k), Pace.endless(10))))
    return states


# ---- the definitions -----------------------------------------------------------------------------


def test_epsilon_falls_from_1_in_the_given_share_of_the_training():
    recipe = engine.DQNRecipe(exploration_fraction=0.1, final_epsilon=0.05, learning_starts=100)
    at = [float(dqn.epsilon(recipe, jnp.int32(s), 10_000)) for s in (0, 99, 100, 500, 1000, 9999)]
    assert at == pytest.approx([1.0, 1.0, 1.0 - 0.095, 1.0 - 0.475, 0.05, 0.05], rel=1e-6)
    copy = [float(dqn.epsilon(recipe, jnp.int32(s), 10_000, 400)) for s in (99, 100, 600)]
    assert copy == pytest.approx([1.0, 1.0 - 0.475, 0.05], rel=1e-6)


def test_actions_are_greedy_but_for_a_share_epsilon():
    recipe = replace(TINY, n_envs=512, buffer_size=2048, final_epsilon=0.25, learning_starts=0)
    state, params = single(dqn, ENV, recipe)
    rng = np.random.default_rng(0)
    coin, reset = (jnp.asarray(rng.random((4, 512, *d)), jnp.float32) for d in ((), (4,)))

    explore = jax.jit(partial(dqn.explore, ENV, recipe))

    def rows_at(step):
        now = dqn.Round(jnp.int32(step), coin, reset, jnp.zeros((1, 16)))
        return explore(state, params, now, (0, jnp.int32(10_000)))[1]

    batch = dqn.unpack(rows_at(9_000), params.visible)
    greedy = np.argmax(networks.apply(state.weights.actor, batch.obs, "relu"), axis=-1)
    assert np.mean(batch.action == greedy) == pytest.approx(1.0 - 0.25 / 2, abs=0.02)
    never = np.asarray(coin).reshape(-1) >= 0.25
    np.testing.assert_array_equal(np.asarray(batch.action)[never], greedy[never])
    first_actions = np.asarray(dqn.unpack(rows_at(0), params.visible).action)[:512]
    np.testing.assert_array_equal(first_actions, np.asarray(coin[0]) >= 0.5)  # all at random
    np.testing.assert_allclose(batch.obs[:, FEATURES:], 0.8)  # the multiplier is put back


# ---- the ring ------------------------------------------------------------------------------------


def test_the_ring_wraps_and_keeps_the_latest_transitions():
    random = replace(TINY, learning_starts=10**6)
    small = states_of(random)
    large = states_of(replace(random, buffer_size=1280))[-1].replay
    assert_same(large[:512], small[2].replay)
    np.testing.assert_array_equal(small[-1].replay[256:], large[768:1024])  # the fourth update
    np.testing.assert_array_equal(small[-1].replay[:256], large[1024:])  # the fifth


def test_truncated_transitions_bootstrap_and_end_where_they_were_cut_off():
    batch = dqn.unpack(states_of(TINY)[2].replay, jnp.zeros(1))
    obs, after = (x.reshape(8, 64, 5)[..., :4] for x in (batch.obs, batch.after))  # (T, E, f)
    terminated = np.asarray(batch.terminated).reshape(8, 64)
    assert not terminated.any()  # no pole falls in so few steps
    np.testing.assert_allclose(after[:6], obs[1:7], atol=1e-6)
    assert (np.abs(after[6] - obs[7]).max(axis=-1) > 1e-3).all()  # not the next episode's start
    assert (np.abs(obs[7]) <= 0.05).all()
    np.testing.assert_array_equal(batch.reward, 1.0)


def test_transitions_of_several_contexts_keep_what_the_policy_saw_of_them():
    """And it is the own one: heavier poles are pushed back less by the same action."""
    env, lengths = worlds.Solo(CartPole(horizon=3)), [0.1, 0.6, 5.0]
    params = jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), params_of(env, [lengths]))
    state, own = first(dqn.init(env, TINY, [3], params)), first(params)
    state = jax.jit(partial(dqn.update, env, TINY))(
        state, own, clock_at(jnp.int32(0), Pace.endless(10))
    )
    batch = dqn.unpack(state.replay[:256], own.visible)
    obs, after = (np.asarray(x) for x in (batch.obs, batch.after))
    seen = obs[:, FEATURES:]
    np.testing.assert_array_equal(np.unique(seen), np.unique(own.visible))
    np.testing.assert_array_equal(after[:, FEATURES:], seen)  # not yet the next
    assert (seen.reshape(4, 64)[0] != seen.reshape(4, 64)[3]).any()  # an episode has ended
    turned = np.abs(after[:, 3] - obs[:, 3])  # speed of the pole in one step
    each = [turned[seen[:, 0] == shown] for shown in np.ravel(own.visible)]
    assert each[0].min() > each[1].max()
    assert each[1].min() > each[2].max()


@pytest.mark.long
def test_the_ring_is_never_copied():
    recipe = replace(TINY, buffer_size=2**19)
    params = jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), params_of(ENV, [0.4, 0.5]))
    state = dqn.init(ENV, recipe, [0, 1], params)
    every = jax.vmap(partial(dqn.update, ENV, recipe), in_axes=(0, 0, None))
    clock = clock_at(jnp.int32(0), Pace.endless(10))
    compiled = jax.jit(every, donate_argnums=0).lower(state, params, clock).compile()
    assert compiled.memory_analysis().temp_size_in_bytes < state.replay.nbytes / 10


# ---- learning ------------------------------------------------------------------------------------


def test_learning_starts_and_the_target_is_copied_when_stated():
    states = states_of(TINY)  # 256 steps each; the target is copied at 512 and 1024
    networks_, targets = [s.weights.actor for s in states], [s.target for s in states]
    assert same(networks_[1], networks_[0])  # 256 steps are not more than learning_starts
    assert not any(same(networks_[k], networks_[k + 1]) for k in range(1, 5))
    # the copy is made before the gradient steps of its round
    assert same(targets[1], networks_[0])
    assert same(targets[2], networks_[1])
    assert same(targets[3], targets[2])
    assert same(targets[4], networks_[3])
    assert not same(targets[4], targets[3])
    assert same(targets[5], targets[4])


def test_gradient_steps_are_stable_baselines3s():
    """The same networks and the same transitions in their replay, then their `train`."""
    torch = pytest.importorskip("torch")
    peer = pytest.importorskip("stable_baselines3")

    recipe = replace(TINY, gradient_steps=3, hidden=(16, 16), learning_rate=1e-2, max_grad_norm=1.0)
    state, params = single(dqn, ENV, recipe)
    target = jax.tree.map(lambda x: x + 0.3, state.weights.actor)
    rng = np.random.default_rng(0)
    rows = rng.normal(size=(3, 16, 11)).astype(np.float32)
    rows[..., 8], rows[..., 10] = rng.integers(0, 2, (2, 3, 16))
    rows[..., 9] *= 5.0  # both pieces of the Huber loss
    ours, _ = dqn.learn(
        recipe, jnp.float32(1.0), params.visible, state.weights.actor, state.optimizer, target,
        jnp.asarray(rows),
    )  # fmt: skip

    model = peer.DQN(
        "MlpPolicy", cartpole.CartPole({"length": 0.4}), learning_rate=1e-2, max_grad_norm=1.0,
        policy_kwargs={"net_arch": [16, 16]}, buffer_size=48, device="cpu",
    )  # fmt: skip
    model.learn(1)
    for net, values in ((model.q_net, state.weights.actor), (model.q_net_target, target)):
        for linear, (weight, bias) in zip(net.q_net[::2], values, strict=True):
            linear.weight.data = torch.from_numpy(np.array(weight).T.copy())
            linear.bias.data = torch.from_numpy(np.array(bias))
    parts = iter(rows)

    def sample(batch_size, env=None):
        part = next(parts)
        batch = dqn.unpack(jnp.asarray(part), params.visible)
        obs, after, action, reward, terminated = (
            torch.from_numpy(np.array(x).reshape(batch_size, -1)) for x in batch
        )
        return peer.common.type_aliases.ReplayBufferSamples(
            obs, action.long(), after, terminated, reward
        )

    model.replay_buffer.sample = sample
    model.train(gradient_steps=3, batch_size=16)
    for linear, (weight, bias) in zip(model.q_net.q_net[::2], ours, strict=True):
        theirs = linear.weight.detach().numpy().T
        np.testing.assert_allclose(weight, theirs, rtol=1e-3, atol=2e-5)
        np.testing.assert_allclose(bias, linear.bias.detach(), rtol=1e-3, atol=2e-5)
    assert np.abs(np.asarray(ours[0][0]) - state.weights.actor[0][0]).max() > 1e-2


def test_initial_weights_are_uniform_as_pytorchs():
    (weight, bias), (last, _) = networks.init_q_network(0, [5, 400, 2]).actor
    assert weight.shape == (5, 400)
    assert last.shape == (400, 2)
    for values, bound in ((weight, 5**-0.5), (bias, 5**-0.5), (last, 400**-0.5)):
        assert np.abs(values).max() <= bound
        assert np.abs(values).max() == pytest.approx(bound, rel=0.02)
        assert np.std(values) == pytest.approx(bound / 3**0.5, rel=0.1)


# ---- whole trainings -----------------------------------------------------------------------------


@pytest.mark.long
def test_cartpole_is_learnt_and_the_policy_acts_in_numpy():
    training = engine.train(
        CARTPOLE, FAST, [0, 1], params_of(CARTPOLE, [0.5, 0.5]), 40_000, checkpoint_every=4_000
    )
    assert (np.asarray(training.best_return) >= 120).all()  # at random: 20
    observations = np.random.default_rng(0).normal(size=(200, 5)).astype(np.float32)
    values = networks.apply(first(training.best.actor), jnp.asarray(observations), "relu")
    policy = engine.export_policies(CARTPOLE, training.best, FAST.activation)[0]
    clear = np.abs(np.diff(values)[:, 0]) > 1e-4
    assert clear.mean() > 0.9
    actions, _ = policy.predict(observations)
    np.testing.assert_array_equal(actions[clear], np.argmax(values, axis=-1)[clear])


# ---- recipes -------------------------------------------------------------------------------------
