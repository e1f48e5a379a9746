"""One policy for all contexts of a native simulator: its recipe, its files, its failures."""

from dataclasses import replace

import numpy as np
import pytest

import mbtl.engine.learners as engine
from mbtl.errors import InvalidInput
from mbtl.problems import get_cmdp
from mbtl.seeds import MATRIX_TRIAL, evaluation_seeds
from mbtl.zoo.benchmark.multitask import InJax, train_on_all

FEW = {"n_envs": 2, "n_steps": 64, "batch_size": 64, "n_epochs": 1}


def short_trainer(id, horizon=20, **switches):
    """Of one source, with episodes of a few steps."""
    cmdp = get_cmdp(id, **switches)
    factory = replace(
        cmdp.trainer.problem.make_env,
        options={**cmdp.trainer.problem.make_env.options, "horizon": horizon},
    )
    problem = replace(cmdp.trainer.problem, make_env=factory)
    merged = {**cmdp.trainer.hyperparameters, **FEW}
    return replace(cmdp.trainer, problem=problem, hyperparameters=merged, eval_episodes=2)


def contexts_of(id, *places):
    return [get_cmdp(id).space.contexts[place] for place in places]


SEEN_OR_NOT = pytest.mark.parametrize(  # compiled once each, for both tests
    ("id", "visibility", "inputs"),
    [
        pytest.param("cheetah-friction", "hidden", 17, marks=pytest.mark.long),
        ("cheetah-gravity", "multiplier", 18),
    ],
)


@SEEN_OR_NOT
def test_one_policy_is_trained_on_all_contexts_and_played_in_the_episodes_of_a_matrix(
    id, visibility, inputs, tmp_path
):
    trainer = short_trainer(id, visibility=visibility)
    contexts = contexts_of(id, 3, 40, 99)
    job = InJax(trainer, contexts, "ppo", 500)
    told, recipe = [], job._problem().recipe
    returns, std, record = train_on_all(job, 0, tmp_path, lambda done, *_: told.append(done))
    assert returns.shape == std.shape == (3,)
    assert np.isfinite(returns).all()
    assert len(set(returns.tolist())) == 3  # each in its own physics
    assert (recipe.n_envs, recipe.n_steps) == (4, 32)  # the same update
    assert record["steps"] == 512
    assert record["checkpoint_episodes"] == 1
    assert told == [128, 256, 384, 512]
    world, params = trainer.problem(contexts)
    sets = engine.in_sets(recipe, params, len(contexts))
    with np.load(tmp_path / "training.npz") as saved:
        begun = engine.start(world, recipe, [record["training_seed"]], sets)
        training = engine.from_arrays(begun, saved)
    assert training.best.actor[0][0].shape == (1, inputs, 64)
    policies = engine.export_policies(world, training.best, recipe.activation)
    seeds = evaluation_seeds(0, MATRIX_TRIAL, range(len(contexts)))
    again = trainer.evaluate(policies[0], contexts, seeds)
    np.testing.assert_allclose(again.mean(axis=1), returns, rtol=1e-4, atol=1e-4)


@SEEN_OR_NOT
def test_an_interrupted_baseline_gives_what_it_would_have(id, visibility, inputs, tmp_path):
    """It goes on; where training has ended it is only evaluated."""
    trainer = short_trainer(id, visibility=visibility)
    job = InJax(trainer, contexts_of(id, 3, 40, 99), "ppo", 500)
    whole = train_on_all(job, 0, tmp_path / "whole", lambda *_: None)[0]

    class Killed(Exception):
        pass

    def kill(done, total, note):
        if done == 384:
            raise Killed

    with pytest.raises(Killed):
        train_on_all(job, 0, tmp_path / "killed", kill)
    again = train_on_all(job, 0, tmp_path / "killed", lambda *_: None)[0]
    told = []
    ended = train_on_all(job, 0, tmp_path / "killed", lambda done, *_: told.append(done))[0]
    assert told == [512]  # nothing was trained
    np.testing.assert_array_equal(again, whole)
    np.testing.assert_array_equal(ended, whole)
    for other in (replace(job, length=501), replace(job, contexts=contexts_of(id, 3, 40, 98))):
        with pytest.raises(InvalidInput, match=r"other settings: (timesteps|contexts) was"):
            train_on_all(other, 0, tmp_path / "killed", lambda *_: None)


def test_judging_costs_no_more_than_training_and_is_done_five_times_at_least():
    job = InJax(short_trainer("cheetah-gravity"), contexts_of("cheetah-gravity", 3, 40), "ppo", 500)
    assert job.settings["checkpoint_every"] == 40  # two contexts of 20 steps
    assert replace(job, length=150).settings["checkpoint_every"] == 30
    assert replace(job, length=15_000).settings["checkpoint_every"] == 300


def test_vectors_per_context_do_not_go_with_standardised_observations():
    """They are found by a number in the observation that must stay as it is."""
    trainer, contexts = short_trainer("cheetah-gravity"), contexts_of("cheetah-gravity", 3, 40)
    with pytest.raises(InvalidInput, match="paco cannot learn from standardised"):
        _ = InJax(trainer, contexts, "paco", 500).settings
    walkers = InJax(
        short_trainer("walker-gravity"), contexts_of("walker-gravity", 3, 40), "paco", 500
    )
    assert walkers.settings["recipe"]["n_parts"] == 5


def test_a_recipe_of_another_algorithm_is_refused():
    trainer = get_cmdp("cartpole-length").trainer_for(algorithm="A2C")
    with pytest.raises(InvalidInput, match="learn by PPO, got a recipe of A2C"):
        InJax(trainer, contexts_of("cartpole-length", 3), "ppo", 500)


def test_the_update_of_one_source_is_spread_over_many_contexts():
    one = engine.PPORecipe(n_envs=32, n_steps=128, batch_size=256)
    found = [engine.multitask_recipe("ppo", one, None, n) for n in (1, 100, 512)]
    assert [(x.n_envs, x.n_steps) for x in found] == [(32, 128), (128, 32), (256, 16)]
    assert {x.update_length for x in found} == {4096}
