"""Many walkers by number: here, in other processes, and in the engine."""

import numpy as np
import pytest

pytest.importorskip("gymnasium", reason="the envs extra is not installed")
pytest.importorskip("Box2D", reason="the envs extra is not installed")
pytest.importorskip("jax", reason="the jax extra is not installed")

import mbtl.training.jax as engine
from mbtl import worlds
from mbtl.cmdps import get_cmdp
from mbtl.cmdps.locomotion.walker_batch import BipedalWalkers
from mbtl.cmdps.locomotion.walker_herd import NOBODY, LocalHerd, SharedHerd
from mbtl.errors import TrainingFailed

CONTEXTS = np.array([[10.0, 2.5, 30.0], [4.0, 1.0, 20.0], [16.0, 5.0, 60.0]])


def lived(herd, steps=30):
    rng = np.random.default_rng(0)
    numbers, seen = herd.start(CONTEXTS, rng.random((3, 2)))
    found = [seen]
    for _ in range(steps):
        *moved, numbers = herd.step(numbers, rng.uniform(-1, 1, (3, 4)).astype(np.float32))
        found += moved
    return found, numbers


@pytest.fixture
def shared():
    herd = SharedHerd(1000, processes=2)
    yield herd
    herd.close()


def test_shared_out_to_processes_they_walk_the_same(shared):
    for ours, theirs in zip(lived(shared)[0], lived(LocalHerd(1000))[0], strict=True):
        np.testing.assert_array_equal(ours, theirs)


def test_walkers_of_a_process_that_died_are_lost_and_the_others_go_on(shared):
    numbers, _ = shared.start(CONTEXTS, np.zeros((3, 2)))
    shared._others[0]._process.kill()
    still = np.zeros((3, 4), np.float32)
    with pytest.warns(RuntimeWarning, match="are lost"):
        seen, reward, ended, after = shared.step(numbers, still)
    assert np.isnan(reward).tolist() == ended.tolist() == [False, True, False]
    assert np.isnan(seen[1]).all()
    assert (after[[0, 2]] == numbers[[0, 2]]).all()
    shared.start(CONTEXTS, np.zeros((3, 2)))  # in a new process
    assert np.isfinite(shared.step(after, still)[1][[0, 2]]).all()


def test_a_walker_ends_with_its_episode():
    herd = LocalHerd(horizon=5)
    _, numbers = lived(herd, steps=4)
    assert len(herd) == 3
    still = np.zeros((3, 4), np.float32)
    seen, reward, ended, after = herd.step(numbers, still)
    assert np.isfinite(seen).all()
    assert not ended.any()
    assert (after == NOBODY).all()
    assert len(herd) == 0
    seen, reward, ended, _ = herd.step(after, still)
    assert not seen.any()
    assert not reward.any()
    assert ended.all()


def test_a_number_that_nobody_has_gives_no_numbers():
    seen, reward, ended, _ = LocalHerd(1000).step(np.array([7]), np.zeros((1, 4), np.float32))
    assert np.isnan(seen).all()
    assert np.isnan(reward).all()
    assert ended.all()


def test_walkers_that_nobody_moves_any_more_are_forgotten():
    herd = LocalHerd(horizon=2)
    herd.start(CONTEXTS, np.zeros((3, 2)))
    for _ in range(2 * 22):
        herd.step(np.zeros(0, np.int64), np.zeros((0, 4), np.float32))
    assert len(herd) == 0


def test_in_the_engine_an_episode_is_that_of_the_gymnasium_environment():
    cmdp = get_cmdp("walker-scale", engine="gymnasium-jax")
    contexts = [{"scale": scale} for scale in (20.0, 30.0, 45.0)]
    world, params = cmdp.trainer.problem(contexts)
    recipe = engine.PPORecipe(n_envs=1, n_steps=64, hidden=(8,))
    weights = engine.start(world, recipe, [1], engine.context_of(params, slice(0, 1))).state.weights
    (policy,) = engine.export_policies(world, weights, "tanh")
    seeds = [[3, 4], [5, 6], [7, 8]]
    found = engine.evaluate(world, engine.actor_of(weights), params, seeds)[0]
    for context, own, returns in zip(contexts, seeds, found, strict=True):
        env, played = cmdp.make_env(context), []
        for seed in own:
            seen, total, over = env.reset(seed=seed)[0], 0.0, False
            while not over:
                action = policy.predict(seen[None], deterministic=True)[0][0]
                seen, reward, ended, out, _ = env.step(action)
                total, over = total + reward, ended or out
            played.append(total)
        np.testing.assert_allclose(returns, played, rtol=0.02, atol=1.0)


def test_a_training_whose_simulator_gives_no_numbers_fails():
    world = worlds.hosted(BipedalWalkers(horizon=20))
    context = {"gravity": 10.0, "friction": 2.5, "scale": 30.0}
    params = worlds.stack_params(world, [context])
    recipe = engine.PPORecipe(n_envs=2, n_steps=32, learning_rate=float("nan"))
    with pytest.raises(TrainingFailed, match="finite"):
        engine.train(world, recipe, [0], params, 256, checkpoint_every=64, checkpoint_episodes=1)


def test_an_interrupted_training_is_not_kept_for_another_process(tmp_path, monkeypatch):
    monkeypatch.setattr("mbtl.training.jax.saving._SECONDS", 0.0)
    few = {"n_envs": 2, "n_steps": 16, "batch_size": 32}
    trainer = get_cmdp("walker-gravity", engine="gymnasium-jax").trainer_for(
        timesteps=64, hyperparameters=few, checkpoint_every=32, checkpoint_episodes=1
    )
    file = tmp_path / "partial.npz"
    trainer.train_many([{"gravity": 10.0}], [0], partial=file)
    assert not file.exists()
