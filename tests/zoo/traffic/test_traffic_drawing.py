import numpy as np
import pytest
from played import begun

from mbtl.zoo.cmdps.traffic.eco import Eco
from mbtl.zoo.cmdps.traffic.ramp import RampVel
from mbtl.zoo.cmdps.traffic.ring import RingVel
from mbtl.zoo.cmdps.traffic.signal import Signal


@pytest.mark.parametrize(
    ("make", "action", "steps"),
    [(RingVel, 5, 1), (RampVel, {}, 1), (Signal, 0, 30), (Eco, {}, 5)],
    ids=["ring", "ramp", "signal", "eco"],
)
def test_every_scenario_has_a_picture_that_changes_as_cars_move(opened, make, action, steps):
    env = begun(opened(make(render_mode="rgb_array")))
    pictures = [env.render()]
    np.testing.assert_array_equal(env.render(), pictures[0])
    for _ in range(steps):
        env.step(action)
    pictures.append(env.render())
    for picture in pictures:
        assert picture.dtype == np.uint8
        assert picture.shape == pictures[0].shape
        assert picture.shape[2] == 3
    assert (pictures[0] != pictures[1]).any()


def test_the_end_of_an_episode_can_still_be_seen():
    env = begun(RingVel({"hold": 40.0}, horizon=1, render_mode="rgb_array"))
    before = env.render()
    env.step(5)
    assert env.simulation.running is None
    assert (env.render() != before).any()
    np.testing.assert_array_equal(env.render(), env.render())
