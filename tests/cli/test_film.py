"""Films say clock, speed and score, and stand beside unguided traffic."""

import math

import numpy as np
import pytest

pytest.importorskip("PIL")

from PIL import Image

from mbtl.cli.film import Watched, caption, save_film


class Road:
    """Three decisions of 5 s on a road that gets faster; `render` is a picture of one grey."""

    SCORE = "m/s"

    def __init__(self, shape=(40, 50), seen=True):
        self.shape, self.seen = shape, seen

    def reset(self, seed=None):
        self.steps = 0
        return self._look(), {}

    def step(self, action):
        self.steps += 1
        return self._look(), 2.0, False, self.steps == 3, {"final_score": 7.0}

    def render(self):
        return np.full((*self.shape, 3), 40 * self.steps, np.uint8)

    def _look(self):
        self.sight = (100.0 + 5.0 * self.steps, 1.0 * self.steps) if self.seen else None
        return 0.0


def watched(**kwargs):
    take = Watched(Road(**kwargs), filming=True)
    take.reset(seed=0)
    for _ in range(3):
        assert "final_score" not in take.step(0)[-1]
    take.scores = [3.25]
    return take


def test_words_say_the_clock_the_speed_and_at_the_end_the_score_with_its_unit():
    take = watched()
    assert caption(take, 0).split("    ") == ["0 s", "mean speed now 0.0 m/s"]
    assert caption(take, 3).split("    ") == ["15 s", "mean speed now 3.0 m/s", "score 3.25 m/s"]


def test_a_simulator_without_cars_says_the_return_so_far():
    take = watched(seen=False)
    assert math.isnan(take.pictures[1].clock)
    assert caption(take, 2) == "return so far 4"


def test_a_score_that_is_the_return_is_called_so():
    take = watched(seen=False)
    take.env.SCORE = "return"
    assert caption(take, 3).split("    ") == ["return so far 6", "return 3.25"]


@pytest.mark.parametrize(("shape", "across"), [((400, 420), True), ((50, 500), False)])
def test_two_takes_stand_beside_each_other_or_if_they_are_wide_below(tmp_path, shape, across):
    longer, shorter = watched(shape=shape), watched(shape=shape)
    del shorter.pictures[2:]
    assert save_film(tmp_path / "road.gif", "road", {"guided": longer, "unguided": shorter}) == 4
    with Image.open(tmp_path / "road.gif") as film:
        assert film.n_frames == 4
        assert (film.width > 2 * shape[1]) == across
        assert (film.height > 2 * shape[0]) != across


LONG = [
    pytest.param(id, marks=pytest.mark.long)
    for id in ("pendulum-length", "walker-gravity", "cheetah-gravity")
]


@pytest.mark.parametrize("id", ["cartpole-length", *LONG])
def test_every_family_that_is_drawn_makes_a_film(mbtl_command, tmp_path, id):
    pytest.importorskip("gymnasium", reason="the envs extra is not installed")
    pytest.importorskip("Box2D", reason="the envs extra is not installed")
    pytest.importorskip("mujoco", reason="the envs extra is not installed")
    code, out, err = mbtl_command("play", id, "--film", tmp_path / "film.gif")
    assert code == 0, err
    with Image.open(tmp_path / "film.gif") as film:
        assert 5 < film.n_frames <= int(out.split(" pictures")[0].split()[-1])
        first = np.asarray(film.convert("RGB"))
        film.seek(film.n_frames - 1)
        assert not np.array_equal(first, np.asarray(film.convert("RGB")))


def test_whoever_waits_for_a_film_is_told_where_it_is():
    told = []
    take = Watched(Road(), True, told.append)
    for seed in range(2):
        take.reset(seed=seed)
        take.step(0)
    assert told == [f"episode {e}, decision {d}" for e in (1, 2) for d in (0, 1)]
