"""Policies bring along what stood between their model and its environments."""

import pickle
from functools import partial
from typing import ClassVar

import gymnasium
import numpy as np
import pytest
from gymnasium.spaces import Box, Discrete, MultiDiscrete
from gymnasium.wrappers import NormalizeObservation
from training_envs import GuessDict, cartpole, pendulum, same

from mbtl.envs import opening
from mbtl.errors import InvalidInput, Notice, TrainingFailed
from mbtl.portfolio import MLPPolicy
from mbtl.seeds import episode_seeds
from mbtl.study.job import rehearse
from mbtl.trainers import SB3Trainer, export_mlp, load_sb3
from mbtl.trainers.adapted import AdaptedPolicy

SHORT = {"n_steps": 64, "batch_size": 32, "n_epochs": 2}
MASS = {"mass": 1.0}


class Lane(gymnasium.Env):
    """Step left, stay or step right; every action is looked at."""

    observation_space = Box(-10.0, 10.0, (1,), np.float32)
    action_space = Discrete(3, start=-1)
    buffer: ClassVar = np.zeros(1, np.float32)
    heard: ClassVar[list] = []

    def __init__(self, context):
        pass

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.x, self.t = float(self.np_random.uniform(-1, 1)), 0
        return self.look(), {}

    def step(self, action):
        assert self.action_space.contains(action), action
        self.heard.append(np.array(action).tolist())
        self.x = float(np.clip(self.x + 0.2 * np.sum(action), -2.0, 2.0))
        self.t += 1
        return self.look(), -abs(self.x - 1.5), False, self.t >= 10, {}

    def look(self):
        return np.array([self.x], np.float32)


class Lanes(Lane):
    action_space = MultiDiscrete([3, 2], start=[-1, 4])

    def step(self, action):
        return super().step(np.asarray(action))


class Wheel(Lane):
    action_space = Box(-2, 2, (2,), np.int64)


class Shelf(Lane):
    observation_space = Discrete(41, start=-20)

    def look(self):
        return int(np.rint(10 * self.x))


class Far(Lane):
    def look(self):
        return np.array([1000.0 * self.x], np.float32)


class Endless(Lane):
    def step(self, action):
        return self.look(), 0.0, False, False, {}


class InPlace(Lane):
    """One buffer for all, changed in place."""

    def look(self):
        self.buffer[:] = self.x
        return self.buffer


def ppo(make_env, timesteps=128, **changes):
    return SB3Trainer(
        make_env, timesteps=timesteps, hyperparameters=SHORT, eval_episodes=3, **changes
    )


def by_hand(policy, env, seed):
    seen, _ = env.reset(seed=seed)
    total, ended = 0.0, False
    while not ended:
        action, _ = policy.predict(seen, deterministic=True)
        seen, reward, terminated, truncated, _ = env.step(action)
        total, ended = total + reward, terminated or truncated
    return total


@pytest.mark.parametrize("make_env", [Lane, Lanes, Wheel, Shelf])
def test_actions_and_observations_lie_in_their_spaces_wherever_a_policy_acts(make_env, tmp_path):
    trainer = ppo(make_env)
    make_env.heard.clear()
    policy = trainer.train([{}], 0).policy
    if make_env is Lane:
        assert set(make_env.heard) == {-1, 0, 1}  # those that it has, in training
    returns = trainer.evaluate(policy, [{}], [1])
    trainer.save(policy, tmp_path)
    read = load_sb3(tmp_path)
    assert np.array_equal(trainer.evaluate(read, [{}], [1]), returns)
    probe = make_env({})
    seen, _ = probe.reset(seed=0)
    assert probe.action_space.contains(np.asarray(read.predict(seen)[0])) or make_env is Lane
    if make_env is not Shelf:
        numpy_copy = MLPPolicy.load(tmp_path)
        assert np.array_equal(trainer.evaluate(numpy_copy, [{}], [1]), returns)
        assert np.array_equal(numpy_copy.predict(seen)[0], read.predict(seen)[0])


@pytest.mark.parametrize(
    ("make_env", "error", "words"),
    [
        (Far, InvalidInput, "not within -10 to 10, at moment 0"),
        (Endless, TrainingFailed, "TimeLimit"),
        (lambda context: NormalizeObservation(Lane(context)), InvalidInput, "observations=True"),
    ],
)
def test_what_nothing_can_be_learnt_in_is_refused_before_any_training(
    make_env, error, words, monkeypatch
):
    monkeypatch.setattr(opening, "LONGEST_EPISODE", 100)
    trouble = rehearse(ppo(make_env), [{}, {}], [0, 1])
    assert isinstance(trouble.error, error)
    assert words in trouble.reason


def test_a_buffer_that_is_changed_in_place_changes_nothing():
    one, other = (
        ppo(make, checkpoint="best", checkpoint_episodes=2, n_envs=2) for make in (Lane, InPlace)
    )
    a, b = one.train([{}], 3).policy, other.train([{}], 3).policy
    seeds = [0, 1]
    assert np.array_equal(one.evaluate(a, [{}] * 2, seeds), other.evaluate(b, [{}] * 2, seeds))
    assert same(a.model, b.model)


def test_what_is_reported_of_standardised_observations_is_what_the_policy_returns(tmp_path):
    trainer = ppo(pendulum, 192, normalize_observations=True)
    policy = trainer.train([MASS], 0).policy
    learnt = policy.statistics.rms
    assert learnt.count > 190
    assert learnt.var[2] > 1.0  # of the angular velocity, in rad^2/s^2
    (reported,) = trainer.evaluate(policy, [MASS], [5])
    ((seed, *_),) = episode_seeds([5], 1, 3)
    assert by_hand(policy, pendulum(MASS), seed) == pytest.approx(reported[0], rel=1e-3)
    trainer.save(pickle.loads(pickle.dumps(policy)), tmp_path)
    for again in (trainer.load(tmp_path), MLPPolicy.load(tmp_path)):
        assert np.array_equal(trainer.evaluate(again, [MASS], [5])[0], reported)
    seen = np.array([0.3, -0.9, 5.0], np.float32)
    shown = np.clip((seen - learnt.mean) / np.sqrt(learnt.var + 1e-8), -10, 10).astype(np.float32)
    expected, _ = policy.model.predict(shown, deterministic=True)
    assert policy.predict(seen)[0] == pytest.approx(expected)
    assert export_mlp(policy).predict(seen)[0] == pytest.approx(expected, abs=1e-4)


def test_standardised_dictionaries_and_the_best_checkpoint():
    trainer = ppo(
        GuessDict, policy="MultiInputPolicy", normalize_observations=True, checkpoint="best",
        checkpoint_every=64, checkpoint_episodes=2,
    )  # fmt: skip
    policy = trainer.train([{}], 0).policy
    assert set(policy.statistics.rms) == {"number", "two"}
    assert trainer.evaluate(policy, [{}], [0]).shape == (1, 3)


def all_of(policy):
    """Whatever decides its actions."""
    statistics = [np.asarray(value) for value in vars(policy.statistics.rms).values()]
    return [*statistics, *(part.numpy() for part in policy.model.policy.state_dict().values())]


def test_a_standardised_training_that_goes_on_is_the_whole_one_and_begins_as_its_parent(tmp_path):
    trainer = ppo(cartpole, timesteps=192, normalize_observations=True)
    context, state = {"length": 0.5}, tmp_path / "state"
    whole = trainer.train([context], 0, length=1.0).policy
    parent = trainer.train([context], 0, length=1 / 3, state=state).policy
    for length, known in ((1 / 3, parent), (1.0, whole)):
        resumed = trainer.train([context], 0, length=length, state=state).policy
        assert all(map(np.array_equal, all_of(resumed), all_of(known)))
    assert not all(map(np.array_equal, all_of(parent), all_of(whole)))
    tuned = trainer.train([context], 1, length=1 / 3, start=whole).policy
    assert tuned.statistics.rms.count == pytest.approx(192 + 64, abs=4)
    with pytest.raises(InvalidInput, match="use the trainer that made it"):
        ppo(cartpole).train([context], 1, start=whole)


def test_only_boxes_are_standardised():
    with pytest.raises(ValueError, match="only supports `gym"):
        ppo(Shelf, normalize_observations=True).train([{}], 0)


def test_a_policy_that_needs_nothing_is_the_librarys_own():
    assert not isinstance(ppo(cartpole).train([{"length": 0.5}], 0).policy, AdaptedPolicy)


def test_simulators_of_which_a_process_has_one_are_evaluated_in_processes():
    opening._known.clear()
    trainer = ppo(partial(Only))
    with pytest.warns(Notice, match="there is one already"):
        returns = trainer.evaluate(RightOn(), [{}, {}], [0, 1])
    assert np.array_equal(returns, ppo(Lane).evaluate(RightOn(), [{}, {}], [0, 1]))


class Only(Lane):
    """There can be one at a time."""

    alive: ClassVar[list] = []

    def __init__(self, context):
        if self.alive:
            raise RuntimeError("there is one already")
        self.alive.append(self)

    def close(self):
        self.alive.clear()


class RightOn:
    """Always goes right."""

    def predict(self, observation, deterministic=True):
        return np.ones(len(observation), int), None
