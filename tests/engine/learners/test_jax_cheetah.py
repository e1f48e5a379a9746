"""The batch of half cheetahs: the environment's physics, each in its own context."""

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="the envs extra is not installed")

from mbtl.engine import worlds
from mbtl.errors import TrainingFailed
from mbtl.problems import get_cmdp
from mbtl.zoo.cmdps.locomotion import cheetah_batch
from mbtl.zoo.cmdps.locomotion.cheetah import HalfCheetah
from mbtl.zoo.cmdps.locomotion.cheetah_batch import CheetahParams, HalfCheetahs

CONTEXTS = [{}, {"gravity": 30.0}, {"friction": 2.0}, {"stiffness": 5.0}, {"gravity": 1.0}]


def params_of(contexts):
    return CheetahParams(*zip(*(HalfCheetah(c).constants for c in contexts), strict=True), ())


def test_each_simulation_is_the_environment_of_its_context():
    """Every step from the same state, as what differs by rounding does not stay small for long."""
    envs, batch = [HalfCheetah(c, visibility="hidden") for c in CONTEXTS], HalfCheetahs()
    seen = np.array([env.reset(seed=i)[0] for i, env in enumerate(envs)])
    state = {"physics": np.concatenate([seen, np.zeros((len(envs), 9))], axis=1)}
    for action in np.random.default_rng(0).uniform(-1.0, 1.0, (100, len(envs), 6)):
        for env, now in zip(envs, state["physics"], strict=True):
            env.state = np.array([0.0, *now[:8]]), now[8:17]
        want = [env.step(a) for env, a in zip(envs, action, strict=True)]
        state, seen, reward, ended = batch.step(state, action, params_of(CONTEXTS))
        np.testing.assert_allclose(seen, [w[0] for w in want], rtol=1e-5, atol=1e-5)
        np.testing.assert_allclose(reward, [w[1] for w in want], rtol=1e-5, atol=1e-5)
    assert not ended.any()


def test_evaluated_episodes_begin_as_those_of_the_environment():
    world = worlds.hosted(HalfCheetahs())
    params = worlds.stack_params(world, [HalfCheetah(c).constants for c in CONTEXTS[:2]])
    first = world.start(world.draws(np.arange(2, dtype=np.uint32)), params)
    want = [HalfCheetah(visibility="hidden").reset(seed=seed)[0] for seed in range(2)]
    np.testing.assert_allclose(first.env.obs, want, atol=1e-6)


def test_results_do_not_depend_on_threads_or_company(monkeypatch):
    found = []
    rng = np.random.default_rng(1)
    physics, action = rng.normal(0.0, 0.1, (8, 26)), rng.uniform(-1.0, 1.0, (8, 6))
    params = params_of([CONTEXTS[i % 5] for i in range(8)])
    for threads in ("1", "3"):
        monkeypatch.setenv("NPROC", threads)
        cheetah_batch._cheetahs.cache_clear()
        found.append(HalfCheetahs().step({"physics": physics}, action, params)[0]["physics"])
    two = CheetahParams(*(x[2:4] for x in params[:3]), ())
    alone = HalfCheetahs().step({"physics": physics[2:4]}, action[2:4], two)[0]["physics"]
    np.testing.assert_array_equal(*found)
    np.testing.assert_array_equal(alone, found[0][2:4])


def test_a_simulation_that_is_lost_stays_lost_and_is_lost_alone(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)  # MuJoCo writes a log
    physics = np.zeros((3, 26))
    physics[1, 4] = np.nan
    state = {"physics": physics}
    for _ in range(2):
        state, seen, reward, _ = HalfCheetahs().step(state, np.zeros((3, 6)), params_of([{}] * 3))
        assert np.isnan(seen).any(axis=1).tolist() == [False, True, False]
        assert np.isnan(reward).tolist() == [False, True, False]


@pytest.mark.long
def test_a_training_whose_simulator_fails_is_the_only_one_that_does(monkeypatch):
    whole = HalfCheetahs.step

    def failing(self, state, action, params):
        state, seen, reward, ended = whole(self, state, action, params)
        return state, np.where(params.gravity[..., None] > 50.0, np.nan, seen), reward, ended

    monkeypatch.setattr(HalfCheetahs, "step", failing)
    few = {"n_envs": 2, "n_steps": 16, "batch_size": 32}
    trainer = get_cmdp("cheetah-gravity").trainer_for(
        timesteps=64, hyperparameters=few, checkpoint="final", checkpoint_episodes=1
    )
    with pytest.raises(TrainingFailed, match="finite"):
        trainer.train([{"gravity": 60.0}], seed=0)
    assert trainer.train([{"gravity": 10.0}], seed=0).policy
