"""What an environment gives without a policy: random actions, and no control at all."""

import copy
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("stable_baselines3", reason="the train extra is not installed")

import gymnasium
from gymnasium import spaces

from mbtl.envs.references import ByItself, RandomActions
from mbtl.errors import UnknownName
from mbtl.problems import get_cmdp
from mbtl.score import Score
from mbtl.trainers import SB3Trainer, reference_rows


class Gauge(gymnasium.Env):
    """Four steps; a step is worth its action times the context, without control 10."""

    observation_space = spaces.Box(-1, 1, (1,), np.float32)
    action_space = spaces.Box(0.0, 1.0, (1,), np.float32)

    def __init__(self, context):
        self.scale = context["x"]

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.left = 4
        return np.zeros(1, np.float32), {}

    def step(self, action):
        return self._gain(self.scale * float(action[0]))

    def _gain(self, reward):
        self.left -= 1
        return np.zeros(1, np.float32), reward, False, self.left == 0, {}


class Guided(Gauge):
    def drive(self):
        return self._gain(10.0)


CONTEXTS = [{"x": 1.0}, {"x": 3.0}]


class Crowd(Guided):
    """Cars at its end: ten times what was earned, and 100 more in crowds, which come one in four.

    The score is known after the second step.
    """

    strata = (0.75, 0.25)

    def reset(self, *, seed=None, options=None):
        self.earned, self.more = 0.0, 100.0 * options["stratum"]
        return super().reset(seed=seed)

    def _gain(self, reward):
        self.earned += reward
        seen, _, _, ended, _ = super()._gain(reward)
        info = {"cars": 10.0 * self.earned + self.more} if ended else {}
        if self.left <= 2:
            info |= {"known": self.earned, "score": self.earned}
        return seen, reward, False, ended, info


class Full:
    def __init__(self, action):
        self.action = action

    def predict(self, observations, deterministic):
        return np.full((len(observations), 1), self.action), None


def test_measures_are_of_whole_episodes_of_every_kind_of_luck():
    score = Score("score", foretold="known", strata="strata")
    trainer = SB3Trainer(Crowd, timesteps=1, eval_episodes=2, score=score)
    found = trainer.measure(Full(0.5), CONTEXTS, [1, 2], ("cars", "absent"))
    assert found["score"].tolist() == [[2.0, 2.0], [6.0, 6.0]]
    assert found["cars"].tolist() == [[45.0, 45.0], [85.0, 85.0]]  # and 25 of crowds
    assert np.isnan(found["absent"]).all()
    np.testing.assert_array_equal(
        trainer.evaluate(Full(0.5), CONTEXTS, [1, 2]), [[1.0] * 2, [3.0] * 2]
    )
    alone = trainer.measure("unguided", CONTEXTS, [1, 2], ("cars",))
    assert alone["cars"].tolist() == [[425.0, 425.0], [425.0, 425.0]]


def test_a_function_of_an_observation_is_a_controller_and_a_wrong_way_is_refused():
    trainer = SB3Trainer(Guided, timesteps=1, eval_episodes=1)
    found = trainer.measure(lambda seen: np.full(1, 0.25 + seen[0]), CONTEXTS, [1, 2])
    assert found["score"].tolist() == [[1.0], [3.0]]
    assert trainer.ways(CONTEXTS) == ("random_actions", "unguided")
    with pytest.raises(UnknownName, match="way"):
        trainer.measure("unguidet", CONTEXTS, [1, 2])


def test_random_actions_are_any_and_those_of_an_episode_the_same_everywhere():
    trainer = SB3Trainer(Gauge, timesteps=1, eval_episodes=40)
    rows = reference_rows(trainer, CONTEXTS, [0, 0])
    assert list(rows) == ["random_actions"]
    assert rows["random_actions"].shape == (2, 40)
    assert rows["random_actions"][1] == pytest.approx(3.0 * rows["random_actions"][0])
    assert rows["random_actions"][0].mean() == pytest.approx(2.0, abs=0.3)
    again = reference_rows(replace(trainer, n_eval_envs=1), CONTEXTS, [0, 0])
    np.testing.assert_array_equal(again["random_actions"], rows["random_actions"])


@pytest.mark.parametrize(
    "space",
    [spaces.Discrete(3, start=2), spaces.MultiDiscrete([2, 3]), spaces.Box(-np.inf, 1.0, (2,))],
)
def test_actions_of_any_space_are_within_it(space):
    actions, _ = RandomActions(space).predict(np.zeros((50, 1)), False, np.random.default_rng(0))
    assert all(space.contains(action) for action in actions)
    assert len({str(action) for action in actions}) > 2


def test_a_pendulum_hangs_and_swings_without_torque_in_both_engines():
    pytest.importorskip("jax", reason="the jax extra is not installed")
    contexts = [{"length": 0.3}, {"length": 2.0}]
    rows = {}
    for engine in ("gymnasium", "jax"):
        trainer = get_cmdp("pendulum-length", engine=engine).trainer_for(eval_episodes=3)
        rows[engine] = reference_rows(trainer, contexts, range(len(contexts)))
    assert rows["jax"]["unguided"] == pytest.approx(rows["gymnasium"]["unguided"], rel=1e-2)
    assert rows["jax"]["random_actions"].shape == (2, 3)
    assert set(rows["gymnasium"]) == {"random_actions", "unguided"}


def test_an_environment_that_goes_by_itself_can_be_copied():
    env = ByItself(gymnasium.make("CartPole-v1"))
    assert copy.copy(env).action_space == env.action_space
    env.close()
