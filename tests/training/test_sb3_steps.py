"""Trainings in Stable-Baselines3 that pause, go on, and begin from others."""

from dataclasses import replace

import gymnasium
import numpy as np
import pytest
from mbtl.set_trainer import SetTrainer
from mbtl.training.sb3_steps import _can_be_copied
from training_envs import Guess, cartpole, pendulum

from mbtl.errors import InvalidInput
from mbtl.trainer import SteppingTrainer
from mbtl.training import SB3Trainer

POLE = {"length": 0.5}
MASS = {"mass": 1.0}
PPO = {"n_steps": 64, "batch_size": 32, "n_epochs": 2, "learning_rate": lambda left: 1e-3 * left}
DQN = {"buffer_size": 500, "learning_starts": 40, "batch_size": 16, "train_freq": 4}
SAC = {"buffer_size": 300, "learning_starts": 30, "batch_size": 16}


def trainer(make_env=cartpole, algorithm="PPO", timesteps=384, **changes):
    own = {"PPO": PPO, "DQN": DQN, "SAC": SAC}[algorithm]
    return SB3Trainer(
        make_env, timesteps=timesteps, algorithm=algorithm, hyperparameters=own, eval_episodes=3,
        **changes,
    )  # fmt: skip


def same(one, other):
    pairs = zip(one.policy.parameters(), other.policy.parameters(), strict=True)
    return all(bool((a == b).all()) for a, b in pairs)


@pytest.mark.parametrize(
    ("one", "context"),
    [
        (trainer(), POLE),
        (trainer(n_envs=2, timesteps=512), POLE),
        (trainer(normalize_reward=True), POLE),
        (trainer(algorithm="DQN"), POLE),
        (trainer(pendulum, "SAC", 120), MASS),
    ],
    ids=["PPO", "two environments", "rewards normalised", "DQN", "SAC"],
)
def test_a_training_extended_twice_is_the_whole_one(one, context, tmp_path):
    assert isinstance(one, SteppingTrainer)
    whole = one.train(context, seed=3)
    file = tmp_path / "training"
    total = one.whole_steps
    reached = [one.train_steps(context, 3, steps, saved=file) for steps in (total // 3, 70, total)]
    assert [r.steps for r in reached] == sorted(r.steps for r in reached)
    assert reached[-1].steps == whole.num_timesteps
    assert same(reached[-1].policy, whole)
    assert not same(reached[0].policy, whole)


@pytest.mark.parametrize("algorithm", ["PPO", "DQN"])
def test_a_training_on_several_contexts_extended_twice_is_the_whole_one(algorithm, tmp_path):
    one, contexts = trainer(algorithm=algorithm), [{"length": x} for x in (0.3, 0.5, 1.0)]
    assert isinstance(one, SetTrainer)
    one.check_on_set()
    marks, file = (128, 640), tmp_path / "training"
    whole = replace(one.for_all_contexts(contexts), timesteps=640).train({}, seed=3)
    reached = [
        one.train_on_steps(contexts, 3, steps, marks=marks, saved=file) for steps in (128, 320, 640)
    ]
    assert [r.steps for r in reached] == [128, 320, 640]
    assert same(reached[-1].policy, whole)
    assert not same(reached[0].policy, whole)
    assert len(one.evaluate(reached[-1].policy, contexts, range(len(contexts)))) == 3
    with pytest.raises(InvalidInput, match="got one of 4 episodes"):
        replace(one, timesteps=None, episodes=4).check_on_set()


class NotCopied(Guess, gymnasium.utils.EzPickle):
    """As those of MuJoCo and Box2D: a copy of it is in no episode."""

    def __init__(self, context):
        gymnasium.utils.EzPickle.__init__(self, context)
        super().__init__(context)


def test_environments_that_cannot_be_copied_begin_a_new_episode(tmp_path):
    from stable_baselines3.common.vec_env import DummyVecEnv

    assert not _can_be_copied(DummyVecEnv([lambda: NotCopied({})]))
    one = trainer(NotCopied)
    ways = []
    for name in "ab":
        file = tmp_path / name
        one.train_steps({}, 0, 64, saved=file)
        ways.append(one.train_steps({}, 0, one.whole_steps, saved=file))
    assert same(ways[0].policy, ways[1].policy)  # the same wherever it goes on, ...
    assert ways[0].steps == 384
    assert not same(ways[0].policy, one.train({}, seed=0))  # ... and not the undisturbed one


@pytest.mark.parametrize(
    ("one", "context"),
    [
        (trainer(), POLE),
        (trainer(normalize_reward=True), POLE),
        (trainer(algorithm="DQN"), POLE),
        (trainer(pendulum, "SAC", 120), MASS),
    ],
    ids=["PPO", "rewards normalised", "DQN", "SAC"],
)
def test_a_training_that_begins_from_another_model_acts_as_that_until_it_learns(one, context):
    first = one.train_steps(context, 0, one.whole_steps).policy
    frozen = replace(one, hyperparameters={**one.hyperparameters, "learning_rate": 0.0})
    warm = frozen.train_steps({name: 2.0 * x for name, x in context.items()}, 1, 64, start=first)
    space = first.observation_space
    seen = np.random.default_rng(0).normal(0.0, 2.0, (50, *space.shape)).astype(space.dtype)
    expected, _ = first.predict(seen, deterministic=True)
    assert np.array_equal(warm.policy.predict(seen, deterministic=True)[0], expected)


def test_a_model_of_another_kind_is_refused():
    with pytest.raises(InvalidInput, match="model of its own algorithm and network, got DQN"):
        trainer().train_steps(POLE, 0, 64, start=trainer(algorithm="DQN").train(POLE, 0))


def test_episodes_of_evaluations_are_counted():
    one = trainer()
    policy = one.train_steps(POLE, 0, 64).policy
    returns, steps = one.evaluate_steps(policy, [POLE, {"length": 1.0}], [5, 6])
    assert np.array_equal(returns, one.evaluate(policy, [POLE, {"length": 1.0}], [5, 6]))
    assert np.array_equal(returns, steps)  # a point per step


@pytest.mark.parametrize(
    ("algorithm", "changes"),
    [("PPO", {}), ("PPO", {"n_envs": 2}), ("DQN", {}), ("DQN", {"normalize_reward": True})],
    ids=["PPO", "two environments", "DQN", "rewards normalised"],
)
def test_a_training_of_episodes_extended_twice_is_the_whole_one(algorithm, changes, tmp_path):
    """Also where a rate falls: it follows the episodes."""
    falls = {**(PPO if algorithm == "PPO" else DQN), "learning_rate": lambda left: 1e-3 * left}
    one = replace(
        trainer(algorithm=algorithm, **changes), timesteps=None, episodes=25, hyperparameters=falls
    )
    assert one.whole_steps is None
    whole = one.train(POLE, seed=3)
    file, told = tmp_path / "training", []
    reached = [
        one.train_steps(POLE, 3, episodes, saved=file, on_progress=told.append)
        for episodes in (4, 11, 25)
    ]
    steps = [r.steps for r in reached]
    assert steps == sorted(set(steps))
    assert steps[-1] in (whole.num_timesteps, whole.num_timesteps - one.n_envs)  # one is begun
    assert same(reached[-1].policy, whole)
    assert not same(reached[0].policy, whole)
    assert {p.unit for p in told} == {"steps"}
    assert told[-1].step == steps[-1]
