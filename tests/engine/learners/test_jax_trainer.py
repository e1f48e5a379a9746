"""The engine as a trainer: one policy or many, the same on resume, in a study and in a matrix."""

from dataclasses import replace

import numpy as np
import pytest
from poles import same_policy

import mbtl.engine.learners as engine
from flat import created
from mbtl.contexts import ContextSpace
from mbtl.engine import WorldTrainer
from mbtl.engine.learners import evaluation, saving
from mbtl.errors import UnknownName
from mbtl.problems import get_cmdp
from mbtl.seeds import evaluation_seeds, training_seed
from mbtl.study.job import rehearse
from mbtl.trainers import SB3Trainer
from mbtl.zoo.benchmark.build import Build
from mbtl.zoo.worlds import CartPole

SMALL = {"n_envs": 2, "n_steps": 64, "batch_size": 64}
CMDP = get_cmdp("cartpole-length", engine="jax")
TRAINER = CMDP.trainer_for(
    "quick", timesteps=2_000, hyperparameters=SMALL, eval_episodes=3, checkpoint_episodes=2
)
CONTEXTS = [{"length": 0.5}, {"length": 2.0}]


def test_the_named_recipes_never_change():
    """Matrices name them in their provenance: improve one by adding another name."""
    both = engine.PPORecipe(
        gamma=0.99, gae_lambda=0.95, clip_range=0.2, entropy_coef=0.0, value_coef=0.5,
        max_grad_norm=0.5, adam_eps=1e-5, normalize_advantage=True, hidden=(64, 64),
    )  # fmt: skip
    for name, own in (
        ("fast", (8, 128, 128, 1, 2e-3, True)), ("sb3", (1, 2048, 64, 10, 3e-4, False)),
    ):  # fmt: skip
        fields = ("n_envs", "n_steps", "batch_size", "n_epochs", "learning_rate", "anneal")
        known = replace(both, **dict(zip(fields, own, strict=True)))
        assert engine.recipe_named("PPO", name) == known


def test_it_is_the_default_where_there_is_an_environment_in_jax():
    for name, gamma in (("cartpole-masspole", 0.99), ("pendulum-timestep", 0.95)):
        trainer = get_cmdp(name).trainer
        assert isinstance(trainer, WorldTrainer)
        assert trainer.recipe["hyperparameters"]["gamma"] == gamma
    assert isinstance(get_cmdp("cartpole-length", engine="gymnasium").trainer, SB3Trainer)


def test_an_accelerator_trains_and_plays_all_of_them_in_one_program(monkeypatch):
    policies = [TRAINER.untrained(CONTEXTS[0])] * 2
    on_cpu = TRAINER.evaluate_many(policies, CONTEXTS, [5, 6])
    ring = get_cmdp("ring-acc", engine="jax")
    assert len(ring.trainer.groups(ring.space.contexts, ring.trainer.lanes)) > 1
    for module in (engine, evaluation):
        monkeypatch.setattr(module, "on_cpu", lambda: False)
    for cmdp in (CMDP, ring):
        assert cmdp.trainer.groups(cmdp.space.contexts, cmdp.trainer.lanes) == [cmdp.space.n]
    np.testing.assert_allclose(TRAINER.evaluate_many(policies, CONTEXTS, [5, 6]), on_cpu)
    monkeypatch.setattr(evaluation, "DEVICE_CROWDS", 3)  # of eight episodes
    twin, holds = ring.trainer_for(eval_episodes=2), [{"hold": 33.0}, {"hold": 40.0}]
    two = [twin.untrained(holds[0])] * 2
    there = twin.evaluate_many(two, holds, [5, 6])
    monkeypatch.setattr(evaluation, "on_cpu", lambda: True)
    returns, steps = twin.evaluate_steps(two[0], holds, [5, 6])
    np.testing.assert_allclose(there, [returns] * 2, rtol=1e-4)
    assert steps.tolist() == [[13, 13], [10, 10]]  # decisions of 400 s


def test_switches_of_the_cmdp_reach_the_engine():
    for switches, n_inputs, constant in (
        ({"visibility": "hidden"}, 4, 1.5),
        ({"visibility": "raw"}, 10, 1.5),
        ({"physics": "reference"}, 5, 1.1),
    ):
        cmdp = get_cmdp("cartpole-masspole", engine="jax", **switches)
        env, params = cmdp.trainer.problem([{"masspole": 0.5}])
        assert env.n_features + params.visible.shape[1] == n_inputs
        np.testing.assert_allclose(params.total_mass, constant)
    cmdp = get_cmdp("cartpole-length", engine="jax", time_limit="terminal")
    assert cmdp.trainer.problem([{"length": 0.5}])[0].time_limit == "terminal"


def test_an_interrupted_training_goes_on_to_the_same_policies(tmp_path, monkeypatch):
    monkeypatch.setattr(saving, "_SECONDS", 0.0)
    partial, seen = tmp_path / "partial.npz", []

    def stop(progress):
        seen.append(progress.step)
        if len(seen) == 5:
            raise KeyboardInterrupt

    whole = TRAINER.train_many(CONTEXTS[:1], [0])
    with pytest.raises(KeyboardInterrupt):
        TRAINER.train_many(CONTEXTS[:1], [0], on_progress=stop, state=partial)
    assert partial.is_file()
    rest = []
    again = TRAINER.train_many(
        CONTEXTS[:1], [0], on_progress=lambda progress: rest.append(progress.step), state=partial
    )
    assert rest[0] == seen[4]  # what was saved is the fourth block
    for checkpoint in ("best", "final"):
        for one, other in zip(whole[checkpoint], again[checkpoint], strict=True):
            assert same_policy(one, other)
    assert partial.is_file()  # removed by whom the policies are for, when they are safe
    ended = []
    TRAINER.train_many(CONTEXTS[:1], [0], on_progress=ended.append, state=partial)
    assert [progress.step for progress in ended] == rest[-1:]  # from the end one is told once


def test_a_damaged_partial_file_only_costs_time(tmp_path):
    partial = tmp_path / "partial.npz"
    partial.write_bytes(b"PK\x03\x04 no archive")
    one = TRAINER.train_many(CONTEXTS[:1], [0], state=partial)["best"][0]
    assert same_policy(one, TRAINER.train([CONTEXTS[0]], seed=0).policy)


def test_training_ends_when_the_best_cannot_get_better(monkeypatch):
    def trained(keep):
        heard = []
        policies = TRAINER.train_many(CONTEXTS[:1], [0], on_progress=heard.append, keep=keep)
        return policies, [progress.metrics["episode_return"] for progress in heard]

    whole, returns = trained(("best", "final"))
    monkeypatch.setattr(CartPole, "max_return", max(returns))
    only, seen = trained(("best",))
    assert seen == returns[: returns.index(max(returns)) + 1]
    assert same_policy(only["best"][0], whole["best"][0])
    monkeypatch.setattr(CartPole, "max_return", returns[0])
    assert trained(("best",))[1] == returns[:1]
    assert trained(("best", "final"))[1] == returns


def test_a_matrix_row_is_the_row_of_a_study(tmp_path):
    space = ContextSpace.points(CMDP.space.axes, CONTEXTS)
    building = Build(TRAINER, space, 7, tmp_path / "work", {}, ("best",), lanes=1)
    building.run()
    study = created(space, budget=2, seed=7, bounds=(0, 500), storage=tmp_path / "study.db")
    study.run(trainer=TRAINER, report=False)
    returns = building.returns("best").mean(axis=2)
    for row in study.state.rows:
        np.testing.assert_allclose(row.returns, returns[row.source])
    policy = TRAINER.load(next((tmp_path / "policies").rglob("source-0001-*")))
    assert same_policy(policy, TRAINER.train([CONTEXTS[1]], training_seed(7, 0, 1)).policy)
    again = TRAINER.evaluate(policy, CONTEXTS, evaluation_seeds(7, 0, range(2)))
    np.testing.assert_allclose(again.mean(axis=1), returns[1])


def test_an_untrained_policy_shows_that_evaluation_works():
    assert rehearse(TRAINER, CONTEXTS, [5, 6]) is None
    trouble = rehearse(replace(TRAINER, hyperparameters={"n_enws": 2}), CONTEXTS, [5, 6])
    assert isinstance(trouble.error, UnknownName)
