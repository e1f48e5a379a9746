"""Trainings in Stable-Baselines3 that pause, go on, and begin from others."""

from dataclasses import replace

import gymnasium
import numpy as np
import pytest
from training_envs import Guess, cartpole, pendulum, same

from mbtl.errors import InvalidInput
from mbtl.trainers import CountingTrainer, SB3Trainer
from mbtl.trainers.sb3_learning import _can_be_copied

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


def by_episodes(algorithm, **changes):
    falls = {**(PPO if algorithm == "PPO" else DQN), "learning_rate": lambda left: 1e-3 * left}
    one = trainer(algorithm=algorithm, **changes)
    return replace(one, timesteps=None, episodes=25, hyperparameters=falls)


@pytest.mark.parametrize(
    ("one", "contexts"),
    [
        (trainer(n_envs=2, normalize_reward=True), [POLE]),
        (trainer(algorithm="DQN"), [{"length": x} for x in (0.3, 0.5, 1.0)]),
        (trainer(pendulum, "SAC", 80), [MASS]),
        (by_episodes("PPO", n_envs=2), [POLE]),
        (by_episodes("DQN", normalize_reward=True), [POLE]),
    ],
    ids=["PPO", "DQN", "SAC", "PPO by episodes", "DQN by episodes"],
)
def test_a_training_extended_twice_is_the_whole_one(one, contexts, tmp_path):
    """Also on several contexts, and where a rate falls with the episodes."""
    assert isinstance(one, CountingTrainer)
    assert one.takes == {"sets", "start", "length", "state"}
    whole = one.train(contexts, seed=3).policy
    file, told, total = tmp_path / "training", [], one.whole
    reached = [
        one.train(contexts, 3, length=n / total, state=file, on_progress=told.append)
        for n in (total // 3, total // 2, total)
    ]
    steps = [r.steps for r in reached]
    assert steps == sorted(set(steps))
    begun = one.n_envs if one.counts == "episodes" else 0  # of an episode that is too many
    assert steps[-1] in (whole.num_timesteps, whole.num_timesteps - begun)
    assert same(reached[-1].policy, whole)
    assert not same(reached[0].policy, whole)
    assert {p.unit for p in told} == {"steps"}
    assert told[-1].step == steps[-1]


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
        one.train([{}], 0, length=64 / one.whole, state=file)
        ways.append(one.train([{}], 0, length=1.0, state=file))
    assert same(ways[0].policy, ways[1].policy)  # the same wherever it goes on, ...
    assert ways[0].steps == 384
    whole = one.train([{}], seed=0).policy
    assert not same(ways[0].policy, whole)  # ... and not the undisturbed one


LIVE = []


class Elsewhere(Guess):
    """As one of SUMO or of any library in C: what a copy of it knows is not the simulation."""

    def reset(self, **how):
        LIVE[:] = [self]
        return super().reset(**how)

    def step(self, action):
        LIVE[0]  # none is open once it was closed
        return super().step(action)

    def close(self):
        LIVE.clear()


def test_environments_whose_simulation_lives_elsewhere_begin_a_new_episode(tmp_path):
    one, file = trainer(Elsewhere), tmp_path / "training"
    one.train([{}], 0, length=64 / one.whole, state=file)
    assert not LIVE
    assert one.train([{}], 0, length=1.0, state=file).steps == 384


@pytest.mark.parametrize(
    ("one", "context"),
    [(trainer(normalize_reward=True), POLE), (trainer(pendulum, "SAC", 64), MASS)],
    ids=["PPO", "SAC"],
)
def test_a_training_that_begins_from_another_model_acts_as_that_until_it_learns(one, context):
    first = one.train([context], 0, length=1.0).policy
    frozen = replace(one, hyperparameters={**one.hyperparameters, "learning_rate": 0.0})
    other = {name: 2.0 * x for name, x in context.items()}
    warm = frozen.train([other], 1, length=64 / frozen.whole, start=first)
    space = first.observation_space
    seen = np.random.default_rng(0).normal(0.0, 2.0, (50, *space.shape)).astype(space.dtype)
    expected, _ = first.predict(seen, deterministic=True)
    assert np.array_equal(warm.policy.predict(seen, deterministic=True)[0], expected)


@pytest.mark.parametrize(
    ("algorithm", "unit", "count"), [("DQN", "timesteps", 1), ("PPO", "episodes", 2)]
)
def test_a_training_may_become_longer_than_a_unit(algorithm, unit, count, tmp_path):
    one, contexts = trainer(algorithm=algorithm), [POLE, {"length": 1.0}][:count]
    if unit == "episodes":
        one = replace(one, timesteps=None, episodes=12)
    file = tmp_path / "training"
    first, second = (one.train(contexts, 3, length=each, state=file) for each in (1.0, 1.5))
    straight = one.train(contexts, 3, length=1.5)
    assert first.steps < second.steps
    assert not same(first.policy, second.policy)
    if unit == "timesteps":
        assert second.steps == straight.steps == 1.5 * one.whole


@pytest.mark.parametrize(("algorithm", "unit"), [("PPO", "timesteps"), ("DQN", "episodes")])
def test_without_its_state_a_training_goes_on_from_its_latest_policy(algorithm, unit):
    left, told = [], []
    one = trainer(algorithm=algorithm)
    falls = {**one.hyperparameters, "learning_rate": lambda share: left.append(share) or 1e-3}
    total = {"timesteps": 384, "episodes": None} if unit == "timesteps" else {"episodes": 20}
    one = replace(one, hyperparameters=falls, **{"timesteps": None, **total})
    half = one.train([POLE], 3, length=0.5)
    left.clear()
    asked = {"start": half.policy, "done": 0.5, "length": 1.0}
    rest = one.train([POLE], 3, on_progress=told.append, **asked)
    assert rest.steps == (384 if unit == "timesteps" else None)
    assert not same(rest.policy, half.policy)
    assert 0 < max(share for share in left if share < 1.0) <= 0.55  # it follows the whole
    assert same(one.train([POLE], 3, **{**asked, "length": 0.5}).policy, half.policy)


def test_a_model_of_another_kind_is_refused():
    with pytest.raises(InvalidInput, match="model of its own algorithm and network, got DQN"):
        trainer().train([POLE], 0, start=trainer(algorithm="DQN").train([POLE], 0).policy)


def test_episodes_of_evaluations_are_counted():
    one = trainer()
    policy = one.train([POLE], 0, length=64 / one.whole).policy
    returns, steps = one.evaluate_steps(policy, [POLE, {"length": 1.0}], [5, 6])
    assert np.array_equal(returns, one.evaluate(policy, [POLE, {"length": 1.0}], [5, 6]))
    assert np.array_equal(returns, steps)  # a point per step
