"""`mbtl run` on traffic as a user starts it, only shorter; and `mbtl play` of what it left."""

from dataclasses import replace

import numpy as np
import pytest

from mbtl.envs import rollout
from mbtl.envs.rollout import Actor, Job
from mbtl.portfolio import load_portfolio
from mbtl.problems import get_cmdp
from mbtl.zoo.cli.film import Watched

TINY = ("--preset", "quick", "--strategy", "mbtl", "--budget", "1", "--eval-episodes", "1")


@pytest.mark.long
def test_a_ring_is_run_in_the_twin_and_its_policy_played_in_sumo(mbtl_command, tmp_path):
    run = ("run", "ring-acc", *TINY, "--episodes", "10", "--study", "a")
    assert "The study is finished" in mbtl_command.done(*run)
    ring = tmp_path / "a" / "portfolio"
    portfolio = load_portfolio(ring)
    assert np.isfinite(portfolio.returns).all()
    assert 0.0 < portfolio.value < 1.0
    play = ("play", ring, "--at", "hold=40")
    told = mbtl_command.document(*play, "--episodes", "2", "--film", "films/ring.gif")
    assert told["context"] == {"hold": 40.0}
    assert "hold = 20 s" in told["policy"]
    assert len(set(told["scores"])) == 2
    assert all(0.5 < score < 4.5 for score in told["scores"])
    from PIL import Image

    with Image.open(tmp_path / "films" / "ring.gif") as film:
        assert 8 < film.n_frames <= 11  # of the first episode; equal pictures are stored once
        assert film.width > 1.5 * film.height  # unguided traffic beside it
    assert mbtl_command.document(*play)["scores"] == told["scores"][:1]
    assert mbtl_command.document(*play, "--seed", "7")["scores"] != told["scores"][:1]


@pytest.mark.long
@pytest.mark.parametrize(
    ("id", "more"), [("signal-inflow", ("--engine", "sumo")), ("eco-green", ())]
)
def test_other_traffic_is_run_in_sumo_and_in_the_twin(mbtl_command, tmp_path, id, more):
    few = (*TINY, "--episodes", "1", "--eval-targets", "2", "--no-report", "--study", "b")
    assert "The study is finished" in mbtl_command.done("run", id, *more, *few)
    returns = load_portfolio(tmp_path / "b" / "portfolio").returns
    told = returns[np.isfinite(returns)]
    assert (len(told), (told <= 0.0).all()) == (2, id.startswith("signal"))


def test_an_episode_whose_score_is_known_is_watched_to_its_end():
    class Jam:
        def reset(self, seed):
            self.steps = 0
            return 0.0, {}

        def step(self, action):
            self.steps += 1
            return 0.0, 0.0, False, self.steps == 5, {"final_score": -100.0, "score": -7.0}

    watched = Watched(Jam(), filming=False)

    class Waits:
        def predict(self, observation, deterministic=True):
            return [0] * len(observation), None

    whole = replace(get_cmdp("signal-inflow").score, foretold=None, strata=None)
    jobs = [Job(lambda: watched, [0], whole)]
    (scores,) = rollout.play(jobs, Actor(Waits()), max_envs=1, keep_open=True)
    assert (scores.tolist(), watched.env.steps) == ([-7.0], 5)


def test_a_film_without_decisions_has_its_first_picture(mbtl_command, tmp_path):
    nobody = ("--at", "inflow=40", "--seed", "6", "--film", "empty.gif")  # no controlled car comes
    mbtl_command.done("play", "eco-inflow", *nobody)
    from PIL import Image

    with Image.open(tmp_path / "empty.gif") as film:
        assert film.n_frames == 1


def test_without_policies_choices_are_drawn(mbtl_command):
    said = mbtl_command.done("play", "signal-inflow", "--at", "inflow=50")
    assert "inflow = 50 cars; choices at random" in said


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["cartpole-length", "--gui"], "for traffic"),
        (["nothing"], "neither"),
        (["ring-acc", "--at", "hold"], "NAME=VALUE"),
        (["ring-acc", "--at", "hald=3"], "Did you mean 'hold'"),
        (["ring-acc", "--at", "hold=41"], "[1, 40] s"),
        (["ring-acc", "--episodes", "0"], "must be >= 1"),
        (["ring-acc", "--film", "ring.txt"], "end it with .gif"),
        (["ring-acc", "--gui"], "needs a screen"),
    ],
)
def test_wrong_usage_costs_one_line(mbtl_command, monkeypatch, arguments, words):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    assert words in mbtl_command.refusal("play", *arguments)
