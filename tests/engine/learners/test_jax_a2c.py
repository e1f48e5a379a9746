"""A2C in jax: RMSprop and a whole gradient step are Stable-Baselines3's, and it learns."""

import inspect
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

pytest.importorskip("jax", reason="the jax extra is not installed")
pytest.importorskip("gymnasium", reason="the envs extra is not installed")

import mbtl.engine.learners as engine  # isort: skip  # before jax: it sets jax's flags
import jax
import jax.numpy as jnp
from poles import assert_same, params_of, single

from mbtl.engine.learners import a2c, rollout
from mbtl.engine.learners.clock import Pace, clock_at
from mbtl.errors import InvalidInput, UnknownName
from mbtl.zoo.cmdps import cartpole
from mbtl.zoo.worlds import CartPole, Pendulum

TINY = engine.A2CRecipe(n_envs=32, n_steps=4, anneal=True)  # two rollouts in an update
ENV = engine.Solo(CartPole(horizon=9))  # shorter than an update: episodes are cut off
CARTPOLE = engine.Solo(CartPole())
FAST = replace(engine.recipe_named("A2C", "fast"), anneal=False)  # compiled once, with P = 2
PLAY, LEARN = (jax.jit(f, static_argnums=(0, 1)) for f in (rollout.play, a2c.learn))


# ---- the optimiser -------------------------------------------------------------------------------


@pytest.mark.parametrize("tensorflow", [True, False])
def test_a_step_of_rmsprop_follows_its_definition(tensorflow):
    recipe = engine.A2CRecipe(
        learning_rate=0.1, max_grad_norm=10.0, rms_decay=0.9, rms_eps=0.5,
        rms_like_tensorflow=tensorflow,
    )  # fmt: skip
    optimizer, square = a2c.optimizer(recipe), 1.0 if tensorflow else 0.0
    memory = optimizer.init(jnp.zeros(2))
    # the second gradient has norm 20 and is halved
    for given, gradient in (((3.0, -4.0), (3.0, -4.0)), ((12.0, -16.0), (6.0, -8.0))):
        step, memory = optimizer.update(jnp.array(given), memory)
        square = 0.9 * square + 0.1 * np.square(gradient)
        root = np.sqrt(square + 0.5) if tensorflow else np.sqrt(square) + 0.5
        np.testing.assert_allclose(step, -0.1 * np.array(gradient) / root, rtol=1e-6)


@pytest.mark.parametrize("tensorflow", [True, False])
def test_rmsprop_is_what_stable_baselines3_offers(tensorflow):
    torch = pytest.importorskip("torch")
    peer = pytest.importorskip("stable_baselines3.common.sb2_compat.rmsprop_tf_like")
    recipe = engine.A2CRecipe(rms_like_tensorflow=tensorflow)
    gradients = np.random.default_rng(0).normal(size=(20, 7)).astype(np.float32)
    weight = torch.nn.Parameter(torch.zeros(7))
    kind = peer.RMSpropTFLike if tensorflow else torch.optim.RMSprop
    theirs = kind([weight], lr=7e-4, alpha=0.99, eps=1e-5)
    ours, optimizer = jnp.zeros(7), a2c.optimizer(recipe)
    memory = optimizer.init(ours)
    for gradient in gradients:
        weight.grad = torch.from_numpy(gradient.copy())
        torch.nn.utils.clip_grad_norm_([weight], 0.5)
        theirs.step()
        steps, memory = optimizer.update(jnp.asarray(gradient), memory)
        ours = ours + steps
    np.testing.assert_allclose(ours, weight.detach(), rtol=1e-4, atol=1e-8)


# ---- one gradient step ---------------------------------------------------------------------------


update = jax.jit(partial(a2c.update, ENV, TINY))


@pytest.mark.long
def test_an_update_is_its_rollouts_one_after_another():
    state, params = single(a2c, ENV, TINY)
    key, noise = rollout.draw(ENV, state.key, (2, 4, 32))
    play, learn = (partial(f, ENV, TINY) for f in (PLAY, LEARN))
    by_hand = state._replace(key=key)
    for k in range(2):
        part = jax.tree.map(lambda x, k=k: x[k], noise)
        by_hand, played = play(by_hand, params, part)
        by_hand = learn(by_hand, played, jnp.float32(1.0))
    updated = update(state, params, clock_at(jnp.int32(0), Pace.falling(10)))
    for a, b in zip(jax.tree.leaves(updated), jax.tree.leaves(by_hand), strict=True):
        np.testing.assert_allclose(a, b, rtol=2e-4, atol=2e-6)


def test_annealing_ends_at_no_learning():
    state, params = single(a2c, ENV, TINY)
    updated = update(state, params, clock_at(jnp.int32(10), Pace.falling(10)))
    assert_same(updated.weights, state.weights)
    assert not np.array_equal(updated.copies.elapsed, state.copies.elapsed)


@pytest.mark.parametrize("time_limit", ["truncation", "terminal"])
def test_a_gradient_step_is_stable_baselines3s(time_limit):
    """The same networks and the same rollout in their buffer, then their `train`."""
    torch = pytest.importorskip("torch")
    peer = pytest.importorskip("stable_baselines3")
    from stable_baselines3.common.vec_env import DummyVecEnv

    env = engine.Solo(CartPole(horizon=9, time_limit=time_limit))
    recipe = engine.A2CRecipe(n_envs=2, n_steps=24, gae_lambda=0.9, entropy_coef=0.01)
    state, params = single(a2c, env, recipe)
    _, noise = rollout.draw(env, state.key, (24, 2))
    moved, played = PLAY(env, recipe, state, params, noise)
    ours = LEARN(env, recipe, moved, played, jnp.float32(1.0)).weights

    venv = DummyVecEnv([lambda: cartpole.CartPole({"length": 0.4})] * 2)
    model = peer.A2C(
        "MlpPolicy", venv, n_steps=24, gae_lambda=0.9, ent_coef=0.01, device="cpu"
    )  # fmt: skip
    model.learn(48)  # so that everything it needs exists
    policy = model.policy
    policy.optimizer.state.clear()
    layers = {
        "actor": [policy.mlp_extractor.policy_net[k] for k in (0, 2)] + [policy.action_net],
        "critic": [policy.mlp_extractor.value_net[k] for k in (0, 2)] + [policy.value_net],
    }
    for name, linears in layers.items():
        for linear, (weight, bias) in zip(linears, getattr(state.weights, name), strict=True):
            linear.weight.data = torch.from_numpy(np.array(weight).T.copy())
            linear.bias.data = torch.from_numpy(np.array(bias))
    r = jax.tree.map(np.array, played)
    assert r.done.any()
    assert (r.done != r.terminated).any() == (time_limit == "truncation")
    buffer, started = model.rollout_buffer, np.ones(2)
    buffer.reset()
    with torch.no_grad():
        for t in range(24):
            values, log_prob, _ = policy.evaluate_actions(
                torch.from_numpy(r.obs[t]), torch.from_numpy(r.action[t])
            )
            bonus = 0.99 * policy.predict_values(torch.from_numpy(r.after[t])).numpy()[:, 0]
            cut = r.done[t] & ~r.terminated[t]  # as `collect_rollouts` does it
            reward = r.reward[t] + np.where(cut, bonus, 0.0)
            buffer.add(r.obs[t], r.action[t][:, None], reward, started, values, log_prob)
            started = r.done[t].astype(np.float32)
        last = policy.predict_values(torch.from_numpy(r.after[-1]))
    buffer.compute_returns_and_advantage(last, r.done[-1])
    model.train()
    for name, linears in layers.items():
        for linear, (weight, bias) in zip(linears, getattr(ours, name), strict=True):
            theirs = linear.weight.detach().numpy().T
            np.testing.assert_allclose(weight, theirs, rtol=1e-4, atol=2e-6)
            np.testing.assert_allclose(bias, linear.bias.detach(), rtol=1e-4, atol=2e-6)
    moves = [np.abs(np.asarray(a) - b).max() for (a, _), (b, _) in zip(
        ours.actor, state.weights.actor, strict=True
    )]  # fmt: skip
    assert min(moves) > 1e-5  # the comparison is of a step that moved every layer


# ---- whole trainings -----------------------------------------------------------------------------


def test_cartpole_is_learnt():
    training = engine.train(
        CARTPOLE, FAST, [0, 1], params_of(CARTPOLE, [0.5, 0.5]), 200_000, checkpoint_every=20_000
    )
    assert (np.asarray(training.best_return) >= 400).all()


@pytest.mark.long
def test_pendulum_takes_a_step_with_a_gaussian():
    from mbtl.zoo.cmdps import pendulum

    env = engine.Solo(Pendulum())
    constants = [pendulum.derive(pendulum.Pendulum({"mass": 1.0}).features)]
    training = engine.train(env, TINY, [0], engine.stack_params(env, constants), 256)
    assert np.asarray(training.state.weights.log_std)[0, 0] != 0.0


# ---- recipes -------------------------------------------------------------------------------------


PEERS = {
    "A2C": {
        "n_steps": "n_steps", "gae_lambda": "gae_lambda", "entropy_coef": "ent_coef",
        "value_coef": "vf_coef", "rms_eps": "rms_prop_eps",
        "normalize_advantage": "normalize_advantage",
    },
    "DQN": {
        "batch_size": "batch_size", "learning_starts": "learning_starts",
        "train_freq": "train_freq", "gradient_steps": "gradient_steps",
        "target_every": "target_update_interval",
        "exploration_fraction": "exploration_fraction", "final_epsilon": "exploration_final_eps",
    },
}  # fmt: skip
FIXED = {"A2C": {"use_rms_prop": True}, "DQN": {"exploration_initial_eps": 1.0, "tau": 1.0}}


@pytest.mark.parametrize("algorithm", PEERS)
def test_recipes_have_stable_baselines3s_defaults(algorithm):
    peer = getattr(pytest.importorskip("stable_baselines3"), algorithm)
    theirs = {k: v.default for k, v in inspect.signature(peer.__init__).parameters.items()}
    names = PEERS[algorithm] | {k: k for k in ("learning_rate", "gamma", "max_grad_norm")}
    ours = engine.recipe_named(algorithm, "sb3")
    assert {k: getattr(ours, k) for k in names} == {k: theirs[v] for k, v in names.items()}
    assert {k: theirs[k] for k in FIXED[algorithm]} == FIXED[algorithm]


def test_recipes_are_found_by_algorithm_and_name():
    assert engine.recipe_named("A2C", "sb3") == engine.A2CRecipe()
    assert engine.recipe_named("A2C", "fast").record["hidden"] == [64, 64]
    with pytest.raises(UnknownName, match="Known: A2C, DQN, PPO"):
        engine.recipe_named("SARSA", "sb3")
    with pytest.raises(InvalidInput, match="n_steps must be >= 1, got 0"):
        engine.A2CRecipe(n_steps=0)
    assert engine.A2CRecipe(n_envs=3, n_steps=5).update_length == 270  # whole rollouts >= 256
