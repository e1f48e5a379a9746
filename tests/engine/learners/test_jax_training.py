"""PPO over many contexts and seeds: independence, resuming, learning, export, evaluation."""

import os
import subprocess
import sys
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from poles import params_of

import mbtl.engine.learners as engine
from mbtl.engine import worlds
from mbtl.engine.learners import blocks, evaluation, networks
from mbtl.engine.worlds.environments import Box, Discrete
from mbtl.engine.worlds.flags import settings
from mbtl.errors import InvalidInput, StorageError
from mbtl.zoo.cmdps import cartpole, pendulum
from mbtl.zoo.worlds import CartPole, Pendulum

TINY = engine.PPORecipe(n_envs=2, n_steps=32, batch_size=32, n_epochs=2, learning_rate=1e-3)
CARTPOLE = worlds.Solo(CartPole())
PENDULUM = worlds.Solo(Pendulum())
# compiling a program takes longer than running it, so most tests share these, with P = 2
RECIPE = {
    "cartpole": replace(engine.recipe_named("PPO", "fast"), anneal=False),
    "pendulum": replace(TINY, anneal=True, entropy_coef=0.01),
}


cartpole_params = partial(params_of, CARTPOLE)


def pendulum_params(masses):
    envs = [pendulum.Pendulum({"mass": mass}) for mass in masses]
    constants = [pendulum.derive(env.features) for env in envs]
    return worlds.stack_params(PENDULUM, constants, [env.visible for env in envs])


# ---- training ------------------------------------------------------------------------------------


def test_saved_arrays_of_another_training_are_refused():
    small = engine.start(CARTPOLE, TINY, [0], cartpole_params([0.5]))
    large = engine.start(CARTPOLE, TINY, [0, 1], cartpole_params([0.5, 1.0]))
    with pytest.raises(StorageError, match="must fit its recipe"):
        engine.from_arrays(large, engine.to_arrays(small))
    with pytest.raises(StorageError, match=r"must hold .state.weights.actor\[0\]\[0\]"):
        engine.from_arrays(large, {})


def test_cartpole_is_learnt_and_the_best_checkpoint_is_kept():
    bests = []
    # as shipped: without annealing some seeds fall back, and which do depends on the processor
    recipe, params = replace(RECIPE["cartpole"], anneal=True), cartpole_params([0.5, 0.5])
    training = engine.train(
        CARTPOLE, recipe, [0, 1], params, 120_000, checkpoint_every=20_000, checkpoint_episodes=5,
        on_block=lambda b: bests.append(np.array(b.training.best_return)),
    )  # fmt: skip
    assert (np.diff(bests, axis=0) >= 0).all()
    assert (bests[-1] >= 400).all()
    assert (bests[-1] >= np.asarray(training.latest_return)).all()


# ---- the algorithm's parts -----------------------------------------------------------------------


def test_sampling_has_the_stated_distribution():
    rng = np.random.default_rng(0)
    logits = jnp.asarray([0.3, -1.0, 0.7])
    noise = jnp.asarray(rng.random(40_000), jnp.float32)
    outputs = jnp.broadcast_to(logits, (40_000, 3))
    drawn = np.asarray(networks.sample(outputs, jnp.zeros(0), noise, Discrete(3)))
    shares = np.bincount(drawn, minlength=3) / 40_000
    np.testing.assert_allclose(shares, jax.nn.softmax(logits), atol=0.01)
    chosen = networks.log_prob(outputs[:3], jnp.zeros(0), jnp.arange(3), Discrete(3))
    np.testing.assert_allclose(chosen, jax.nn.log_softmax(logits), rtol=1e-6)


def test_gaussian_density_and_entropy_are_scipys():
    from scipy.stats import norm

    box = Box((-1.0, -1.0), (1.0, 1.0))
    mean, log_std, action = jnp.array([0.2, -3.0]), jnp.array([0.1, -0.5]), jnp.array([1.0, -2.0])
    scipys = norm(np.asarray(mean), np.exp(np.asarray(log_std)))
    ours = float(networks.log_prob(mean, log_std, action, box))
    assert ours == pytest.approx(scipys.logpdf(np.asarray(action)).sum(), rel=1e-5)
    assert float(networks.entropy(mean, log_std, box)) == pytest.approx(
        scipys.entropy().sum(), rel=1e-5
    )
    np.testing.assert_allclose(networks.mode(mean, box), [0.2, -1.0])


def test_initial_weights_are_orthogonal_with_the_stated_gains():
    weights = networks.init_weights(0, 5, Discrete(2), (64, 64))
    (first, _), (second, _), (last, bias) = weights.actor
    np.testing.assert_allclose(first @ first.T, 2.0 * np.eye(5), atol=1e-5)
    np.testing.assert_allclose(second @ second.T, 2.0 * np.eye(64), atol=1e-5)
    np.testing.assert_allclose(last.T @ last, 1e-4 * np.eye(2), atol=1e-9)
    assert weights.critic[2][0].shape == (64, 1)
    assert np.linalg.norm(weights.critic[2][0]) == pytest.approx(1.0, rel=1e-5)
    assert not bias.any()


# ---- evaluation and export -----------------------------------------------------------------------


@pytest.fixture(scope="module", params=["cartpole", "pendulum"])
def trained(request):
    """Environment, two contexts, the same in Gymnasium, and a short training on them."""
    if request.param == "cartpole":
        env, params = CARTPOLE, cartpole_params([0.1, 2.0])
        theirs = [cartpole.CartPole({"length": v}) for v in (0.1, 2.0)]
    else:
        env, params = PENDULUM, pendulum_params([0.5, 3.0])
        theirs = [pendulum.Pendulum({"mass": v}) for v in (0.5, 3.0)]
    return env, params, theirs, engine.train(env, RECIPE[request.param], [0, 1], params, 512)


def test_returns_are_those_of_the_exported_policies_in_gymnasium(trained):
    env, params, theirs, training = trained
    seeds = [[11, 12], [13, 14]]
    returns = engine.evaluate(env, engine.actor_of(training.state.weights), params, seeds)
    assert returns.shape == (2, 2, 2)
    for p, policy in enumerate(engine.export_policies(env, training.state.weights)):
        for c, gym_env in enumerate(theirs):
            for e, seed in enumerate(seeds[c]):
                obs, _ = gym_env.reset(seed=seed)
                total, over = 0.0, False
                while not over:
                    obs, reward, terminated, truncated, _ = gym_env.step(policy.predict(obs)[0])
                    total, over = total + reward, terminated or truncated
                assert returns[p, c, e] == pytest.approx(total, rel=0.02, abs=1.0)


def test_the_size_of_blocks_does_not_change_returns(trained, monkeypatch):
    env, params, _, training = trained
    seeds, actor = [[0, 1, 2], [3, 4, 5], [0, 1, 2]], engine.actor_of(training.best)
    params = jax.tree.map(lambda x: np.concatenate([x, x[:1]]), params)
    whole = engine.evaluate(env, actor, params, seeds)
    monkeypatch.setattr(evaluation, "CPU_ROWS", 6)
    small = engine.evaluate(env, actor, params, seeds)
    np.testing.assert_allclose(small, whole, rtol=1e-3)
    np.testing.assert_array_equal(small[:, 0], small[:, 2])
    actors = engine.import_actor(engine.export_policies(env, training.best))
    np.testing.assert_array_equal(small, engine.evaluate(env, actors, params, seeds))


def test_a_return_is_the_same_in_any_company_and_every_context_has_luck_of_its_own(trained):
    env, params, _, training = trained
    actor = engine.actor_of(training.best)
    twice = jax.tree.map(lambda x: np.concatenate([x, x[:1]]), params)  # one context two times
    seeds = np.arange(15).reshape(3, 5)
    together = engine.evaluate(env, actor, twice, seeds)
    assert not np.array_equal(together[:, 0], together[:, 2])
    for c in range(3):
        one = jax.tree.map(lambda x, c=c: x[c : c + 1], twice)
        alone = engine.evaluate(env, actor, one, seeds[c : c + 1])
        np.testing.assert_array_equal(alone[:, 0], together[:, c])


def test_of_equal_evaluations_the_earliest_is_the_best():
    training = engine.start(PENDULUM, TINY, [0, 1], pendulum_params([0.5, 1.0]))
    for number, found in enumerate([(1.0, 3.0), (1.0, 2.0), (4.0, 3.0)]):
        now = training.state.weights._replace(log_std=jnp.full((2, 1), float(number)))
        training = training._replace(state=training.state._replace(weights=now))
        training = blocks.keep_better(training, jnp.array(found))
    assert training.best_return.tolist() == [4.0, 3.0]
    assert training.latest_return.tolist() == [4.0, 3.0]
    assert training.best.log_std[:, 0].tolist() == [2.0, 0.0]


@pytest.mark.parametrize("seeds", [[], [[]], [1, 2], [[1], [2]]])
def test_nothing_to_evaluate_and_seeds_of_other_contexts_are_refused(seeds):
    weights = engine.start(CARTPOLE, TINY, [0], cartpole_params([0.5])).state.weights
    with pytest.raises(InvalidInput, match="for each of one or more contexts the seeds"):
        engine.evaluate(CARTPOLE, engine.actor_of(weights), cartpole_params([0.5]), seeds)


# ---- flags and the hang --------------------------------------------------------------------------


SCHEDULER = "--xla_cpu_enable_concurrency_optimized_scheduler"


def test_flags_are_added_and_a_users_own_are_kept():
    ours = {"XLA_FLAGS": f"{SCHEDULER}=false", "NPROC": "1"}
    assert settings({}) == ours
    assert settings(ours) == {}
    assert settings({"XLA_FLAGS": f"--xla_dump_to=x {SCHEDULER}=true", "NPROC": "2"}) == {}
    both = {"XLA_FLAGS": f"--xla_dump_to=x {SCHEDULER}=false"}
    assert settings({"XLA_FLAGS": "--xla_dump_to=x", "NPROC": "2"}) == both


def program(text, **environ):
    """Output and errors of a program in a process of its own."""
    clean = {k: v for k, v in os.environ.items() if k not in ("XLA_FLAGS", "NPROC")}
    return subprocess.run(
        [sys.executable, "-c", text],
        env={**clean, **environ}, capture_output=True, text=True, check=True,
    )  # fmt: skip


LENT = f"""
import os
import jax
before, seen, start = dict(os.environ), {{}}, jax.devices
jax.devices = lambda: seen.update(os.environ) or start()
import mbtl.engine.learners
jax.devices = start
assert dict(os.environ) == before
assert seen["NPROC"] == "1"
assert seen["XLA_FLAGS"] == os.environ["XLA_FLAGS"] + " {SCHEDULER}=false"
del os.environ["XLA_FLAGS"]
jax.jit(lambda x: 2 * x)(1.0)
print(len(os.listdir("dump")))
"""


def test_jax_starts_with_our_settings_and_leaves_the_environment_as_it_was(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = program(LENT, XLA_FLAGS="--xla_dump_to=dump")
    assert int(done.stdout) > 0  # what was set when jax started is what it compiles with


LATE = """
import jax
jax.devices()
import mbtl.processes
mbtl.processes.usable_cores = lambda: 2
import mbtl.engine.learners, mbtl.zoo.worlds.traffic.ring
"""


def test_who_has_started_jax_without_them_is_told_so_once():
    assert program(LATE).stderr.count("RuntimeWarning: jax was started before") == 1


HUNDRED = """
import mbtl.engine.learners as engine
from mbtl.engine import worlds
from mbtl.engine.learners import evaluation
from mbtl.zoo.cmdps import cartpole
from mbtl.zoo.worlds import CartPole
env = worlds.Solo(CartPole())
constants = cartpole.derive(cartpole.CartPole.FEATURES)
params = worlds.stack_params(env, [constants] * 100)
training = engine.train(env, engine.recipe_named("PPO", "fast"), range(100), params, 3_000)
print(int(training.updates))
"""


@pytest.mark.long
def test_a_hundred_policies_do_not_hang():
    assert program(HUNDRED).stdout.split() == ["3"]
