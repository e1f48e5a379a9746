import numpy as np
import pytest

pytest.importorskip("libsumo")
pytest.importorskip("pettingzoo")

from mbtl.errors import InvalidInput, UnknownName
from mbtl.zoo.cmdps.drawing import Window
from mbtl.zoo.cmdps.traffic.drawing import draw
from mbtl.zoo.cmdps.traffic.ramp import RampVel
from mbtl.zoo.cmdps.traffic.ring import RingVel
from mbtl.zoo.cmdps.traffic.signal import Signal


class Road:
    """An eastbound lane of 100 m with one car and a light at its end; enough for `draw`."""

    def __init__(self, front=50.0, light="r"):
        self.front, self.shown = front, light
        self.lane = self.junction = self.vehicle = self.trafficlight = self

    def getIDList(self):
        return self.ids

    def __getattribute__(self, name):
        domains = {"lane": ["lane"], "junction": [], "vehicle": ["car"], "trafficlight": ["light"]}
        if name in domains:
            domain = object.__new__(type(self))
            domain.__dict__.update(self.__dict__, ids=domains[name], domain=name)
            return domain
        return object.__getattribute__(self, name)

    def getShape(self, id):
        return [(0.0, 0.0), (100.0, 0.0)]

    def getWidth(self, id):
        return {"lane": 4.0, "vehicle": 2.0}[self.domain]

    def getPosition(self, id):
        return self.front, 0.0

    def getAngle(self, id):
        return 90.0

    def getLength(self, id):
        return 5.0

    def getSpeed(self, id):
        return 0.0

    def getControlledLinks(self, id):
        return [[("lane", "out", "via")]]

    def getRedYellowGreenState(self, id):
        return self.shown


WINDOW = Window(0.0, -10.0, 100.0, 10.0)  # 8 pixels per metre


def reddish(image):
    return (image[..., 0] > 150) & (image[..., 1] < 80)


def test_lane_car_and_light_are_where_they_are():
    image = draw(Road(), WINDOW)
    assert image.shape == (160, 800, 3)
    assert image.dtype == np.uint8
    road = (image == (92, 96, 102)).all(axis=-1)
    assert np.flatnonzero(road[:, 200]).tolist() == list(range(64, 96))  # 4 m
    red = reddish(image)
    assert np.flatnonzero(red[:, 380]).tolist() == list(range(72, 88))  # 2 m
    row = np.flatnonzero(red[80])
    assert row[row < 600].tolist() == list(range(360, 400))  # 5 m behind 50 m
    assert row[row > 600].min() == 796  # the light, half a metre on either side of the end


@pytest.mark.parametrize(("letter", "colour"), [("G", (40, 170, 70)), ("y", (245, 170, 20))])
def test_the_light_has_its_colour(letter, colour):
    image = draw(Road(light=letter), WINDOW)
    assert tuple(image[80, 797]) == colour


def test_a_car_that_moves_changes_the_image_and_only_where_it_was_and_is():
    before, after = draw(Road(50.0), WINDOW), draw(Road(70.0), WINDOW)
    changed = np.flatnonzero((before != after).any(axis=(0, 2)))
    assert changed.tolist() == [*range(360, 400), *range(520, 560)]


def test_a_window_without_area_is_refused():
    with pytest.raises(InvalidInput, match="left < right"):
        draw(Road(), Window(0.0, 0.0, 0.0, 10.0))


# ---- the environments --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("make", "action", "steps"),
    [(RingVel, 5, 1), (RampVel, {}, 1), (Signal, 0, 30)],
    ids=["ring", "ramp", "signal"],
)
def test_every_scenario_has_a_picture_that_changes_as_cars_move(make, action, steps):
    env = make(render_mode="rgb_array")
    env.reset(seed=0)
    pictures = [env.render()]
    np.testing.assert_array_equal(env.render(), pictures[0])
    for _ in range(steps):
        env.step(action)
    pictures.append(env.render())
    env.close()
    for picture in pictures:
        assert picture.dtype == np.uint8
        assert picture.shape == pictures[0].shape
        assert picture.shape[2] == 3
    assert (pictures[0] != pictures[1]).any()


def test_the_end_of_an_episode_can_still_be_seen():
    env = RingVel({"hold": 40.0}, horizon=1, render_mode="rgb_array")
    env.reset(seed=0)
    before = env.render()
    env.step(5)
    assert env.simulation.running is None
    assert (env.render() != before).any()
    np.testing.assert_array_equal(env.render(), env.render())


def test_what_cannot_be_rendered_says_why():
    with pytest.raises(InvalidInput, match="rgb_array"):
        RingVel().render()
    with pytest.raises(InvalidInput, match="reset"):
        RingVel(render_mode="rgb_array").render()
    with pytest.raises(UnknownName, match="render mode"):
        RingVel(render_mode="human")


def test_a_controlled_car_is_blue_with_a_white_edge():
    plain, marked = draw(Road(), WINDOW), draw(Road(), WINDOW, {"car"})
    blue = (marked[..., 2].astype(int) > 180) & (marked[..., 0] < 60)
    assert blue.sum() > 100
    assert not ((plain[..., 2].astype(int) > 180) & (plain[..., 0] < 60)).any()
    assert (marked == 255).all(axis=2).sum() > (plain == 255).all(axis=2).sum()
