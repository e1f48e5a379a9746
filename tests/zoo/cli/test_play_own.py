"""`mbtl play` of a user's own problem: with its baselines, as a film and as a table."""

import csv
from typing import ClassVar

import gymnasium as gym
import numpy as np
import pytest
from PIL import Image

import mbtl


class Tank(gym.Env):
    observation_space = gym.spaces.Box(0.0, 1.0, (1,))
    action_space = gym.spaces.Discrete(2)
    metadata: ClassVar = {"render_modes": ["rgb_array"]}

    def __init__(self, context, render_mode=None):
        self.leak = 0.05 if context["pipe"] == "old" else 0.01
        self.last = list(range(99))[context["steps"]]  # whole, as an axis of whole numbers has it
        self.render_mode = render_mode

    def reset(self, *, seed=None, options=None):
        self.level, self.steps, self.water = 0.5, 0, 0.0
        return np.array([self.level], np.float32), {}

    def step(self, action):
        self.steps += 1
        self.level = float(np.clip(self.level + 0.1 * action - self.leak, 0.0, 1.0))
        self.water += 5.0 * float(action)
        info = {"gap": 100.0 * (1.0 - self.level), "water": self.water}
        return np.array([self.level], np.float32), self.level, False, self.steps == self.last, info

    def render(self):
        return np.full((30, 40, 3), int(255 * self.level), np.uint8)


SPACE = mbtl.ContextSpace.grid(
    {mbtl.Categorical("pipe", ("old", "new")): 2, mbtl.Integer("steps", 8, 9): 2}
)


def problem_of(make_env):
    return mbtl.CMDP.from_env(
        "tank", SPACE, make_env=make_env, timesteps=64, eval_episodes=2, budget=1,
        hyperparameters={"n_steps": 32, "batch_size": 32}, bounds=(0.0, 100.0),
        score=mbtl.Score("gap", unit="%", direction="minimize"), metrics={"water": "litres"},
        baselines={"full": lambda seen: 1, "at random": "random_actions"},
    )  # fmt: skip


class Undrawn(Tank):
    render = gym.Env.render


problem, blind = problem_of(Tank), problem_of(lambda context: Tank(context))
undrawn = problem_of(Undrawn)
TANK = f"{__file__}:problem"


def test_baselines_stand_beside_and_every_decision_is_in_a_table(mbtl_command):
    told = ["--at", "pipe=old", "--at", "steps=8", "--csv", "out/tank.csv", "--film", "tank.gif"]
    found = mbtl_command.document("play", TANK, *told)
    assert found["context"] == {"pipe": "old", "steps": 8}
    assert list(found["all"]) == ["choices at random", "full"]  # nothing twice
    assert found["all"]["full"] == [pytest.approx(100.0 * (1.0 - 0.9))]  # 8 steps of 0.1 - 0.05
    assert (found["unit"], found["measures"]["full"]["water"]) == ("%", 40.0)
    with open("out/tank.csv", encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["who"] == "full"]
    assert [float(row["seen 0"]) for row in rows[:2]] == pytest.approx([0.5, 0.55])
    assert [row["done 0"] for row in rows] == ["1.0"] * 8
    with Image.open("tank.gif") as film:
        assert film.n_frames > 4


def test_a_portfolio_is_played_in_the_problem_that_is_named(mbtl_command):
    mbtl_command.done("run", TANK, "--study", "s", "--no-report")
    play = ("play", "s/portfolio", "--trust")
    assert "add --problem my_file.py:problem" in mbtl_command.refusal(*play)
    played = mbtl_command.document(*play, "--problem", TANK, "--at", "pipe=new")
    assert list(played["all"]) == ["guided", "full", "at random"]


@pytest.mark.parametrize(
    ("target", "more", "words"),
    [
        (f"{__file__}:blind", ["--film", "a.gif"], "let make_env take render_mode=None"),
        (f"{__file__}:undrawn", ["--film", "a.gif"], "got one whose render draws nothing; let it"),
        (TANK, ["--gui"], "for traffic"),
        (TANK, ["--at", "pipe=odd"], "odd"),
    ],
)
def test_what_cannot_be_shown_says_what_would_help(mbtl_command, target, more, words):
    assert words in mbtl_command.refusal("play", target, *more)
