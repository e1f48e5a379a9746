"""A2C in jax: RMSprop and a whole gradient step are Stable-Baselines3's, and it learns."""

import inspect
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from poles import params_of, single

import mbtl.engine.learners as engine
from mbtl.engine import worlds
from mbtl.engine.learners import a2c, rollout
from mbtl.zoo.cmdps import cartpole
from mbtl.zoo.worlds import CartPole

CARTPOLE = worlds.Solo(CartPole())
FAST = replace(engine.recipe_named("A2C", "fast"), anneal=False)  # compiled once, with P = 2
PLAY, LEARN = (jax.jit(f, static_argnums=(0, 1)) for f in (rollout.play, a2c.learn))


# ---- the optimiser -------------------------------------------------------------------------------


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


@pytest.mark.parametrize("time_limit", ["truncation", "terminal"])
def test_a_gradient_step_is_stable_baselines3s(time_limit):
    """The same networks and the same rollout in their buffer, then their `train`."""
    torch = pytest.importorskip("torch")
    peer = pytest.importorskip("stable_baselines3")
    from stable_baselines3.common.vec_env import DummyVecEnv

    env = worlds.Solo(CartPole(horizon=9, time_limit=time_limit))
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


@pytest.mark.long
def test_cartpole_is_learnt():
    training = engine.train(
        CARTPOLE, FAST, [0, 1], params_of(CARTPOLE, [0.5, 0.5]), 200_000, checkpoint_every=20_000
    )
    assert (np.asarray(training.best_return) >= 400).all()


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
    assert engine.A2CRecipe(n_envs=3, n_steps=5).update_length == 270  # whole rollouts >= 256
