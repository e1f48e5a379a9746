"""Films say clock, speed and score, and stand beside unguided traffic."""

import numpy as np
import pytest

pytest.importorskip("PIL")

from PIL import Image

from mbtl.zoo.cli.film import Watched, caption, save_film


class Road:
    """Decisions of 5 s on a road that gets faster; `render` is a picture of one grey."""

    SCORE = "m/s"
    LEGEND = (((20, 90, 220), "controlled"),)

    def __init__(self, last=3, shape=(40, 50), seen=True, seconds=5.0):
        self.last, self.shape, self.seen, self.seconds = last, shape, seen, seconds

    def reset(self, seed=None):
        self.steps = 0
        return self._look(), {}

    def step(self, action):
        self.steps += 1
        info = {"final_score": 7.0, "throughput": 120.0}
        return self._look(), 2.0, False, self.steps == self.last, info

    def render(self):
        return np.full((*self.shape, 3), 40 * (self.steps % 6), np.uint8)

    def _look(self):
        self.sight = (100.0 + self.seconds * self.steps, 1.0 * self.steps) if self.seen else None
        return 0.0


def watched(steps=3, **kwargs):
    metrics = {"throughput": "cars/h", "absent": "of what is not told"}
    take = Watched(Road(steps, **kwargs), filming=True, metrics=metrics)
    take.reset(seed=0)
    for _ in range(steps):
        take.step(0)
    take.scores = [3.25]
    return take


def words(take, moment):
    return [word for line in caption(take, moment) for word in line.split("   ") if word]


def test_words_say_the_clock_the_speed_and_at_the_end_the_score_with_what_stands_beside_it():
    take = watched()
    assert words(take, 0.0) == ["0 s", "mean speed now 0.0 m/s"]
    assert words(take, 12.0) == ["12 s", "mean speed now 2.0 m/s"]
    last = ["mean speed now 3.0 m/s", "score 3.25 m/s", "120 cars/h"]
    assert words(take, 15.0) == ["15 s", *last]
    assert words(take, 20.0) == ["ended at 15 s", *last]


def test_a_simulator_without_cars_says_the_return_so_far():
    take = watched(seen=False)
    assert not take.has_clock
    assert words(take, 2.0) == ["return so far 4"]
    take.env.SCORE = "return"
    assert words(take, 3.0)[:2] == ["return so far 6", "return 3.25"]


@pytest.mark.long
def test_a_long_episode_is_a_film_of_thirty_seconds(tmp_path):
    take, told = watched(2000, shape=(4, 5)), []
    assert len(take.pictures) < 600  # as many as that are never held
    assert (take.pictures[0].when, take.pictures[-1].when) == (0.0, 10_000.0)
    assert (
        save_film(tmp_path / "long.gif", "road", {"guided": take}, lambda *k: told.append(k)) == 300
    )
    assert told[-1] == (300, 300)
    with Image.open(tmp_path / "long.gif") as film:
        assert film.n_frames * film.info["duration"] <= 30_000


@pytest.mark.parametrize(("shape", "across"), [((400, 420), True), ((50, 500), False)])
def test_two_takes_stand_beside_each_other_or_if_they_are_wide_below(tmp_path, shape, across):
    longer, shorter = watched(shape=shape), watched(shape=shape)
    del shorter.pictures[2:]
    assert save_film(tmp_path / "road.gif", "road", {"guided": longer, "unguided": shorter}) == 4
    with Image.open(tmp_path / "road.gif") as film:
        assert film.n_frames == 4
        assert (film.width > 2 * shape[1]) == across
        assert (film.height > 2 * shape[0]) != across
        legend = film.convert("RGB").crop((0, film.height - 30, 40, film.height))
        assert ((np.asarray(legend) == (20, 90, 220)).all(axis=2)).any()


LONG = [
    pytest.param(id, marks=pytest.mark.long)
    for id in ("pendulum-length", "walker-gravity", "cheetah-gravity")
]


@pytest.mark.parametrize("id", ["cartpole-length", *LONG])
def test_every_family_that_is_drawn_makes_a_film(mbtl_command, tmp_path, id):
    pytest.importorskip("gymnasium", reason="the envs extra is not installed")
    pytest.importorskip("Box2D", reason="the envs extra is not installed")
    pytest.importorskip("mujoco", reason="the envs extra is not installed")
    out = mbtl_command.done("play", id, "--film", tmp_path / "film.gif")
    with Image.open(tmp_path / "film.gif") as film:
        assert 5 < film.n_frames <= int(out.split(" pictures")[0].split()[-1])
        first = np.asarray(film.convert("RGB"))
        film.seek(film.n_frames - 1)
        assert not np.array_equal(first, np.asarray(film.convert("RGB")))


def test_what_is_played_are_the_episodes_in_which_a_study_evaluates(mbtl_command, tmp_path):
    pytest.importorskip("stable_baselines3")
    from mbtl.portfolio import load_portfolio

    few = ("--budget", "1", "--timesteps", "64", "--eval-episodes", "2", "--eval-targets", "10")
    run = ("run", "pendulum-length", "--engine", "gymnasium", *few, "--no-report", "--study", "a")
    mbtl_command.done(*run, "--seed", "3")
    folder = tmp_path / "a" / "portfolio"
    portfolio = load_portfolio(folder, trust=True)
    place = int(np.flatnonzero(np.isfinite(portfolio.returns[0]))[0])
    at = f"length={portfolio.space.context(place)['length']!r}"
    play = ("play", folder, "--trust", "--at", at, "--episodes", "2", "--seed")
    same, other = (np.mean(mbtl_command.document(*play, seed)["scores"]) for seed in "34")
    assert same == pytest.approx(portfolio.returns[0, place], rel=1e-5)
    assert other != pytest.approx(portfolio.returns[0, place], rel=1e-4)
