"""A context is shown beside what any environment shows."""

import pickle

import gymnasium
import numpy as np
import pytest

from mbtl.contexts import Categorical, ContextSpace, Linear, Log
from mbtl.envs.references import ways_of
from mbtl.errors import ContextMismatch, InvalidInput
from mbtl.problems import CMDP, check_cmdp
from mbtl.problems.shown import ShowContext, Showing
from mbtl.zoo.cmdps.pendulum import Pendulum

SPACE = ContextSpace.grid({Log("mass", 0.1, 10.0, "kg"): [0.1, 1.0, 10.0]})


def pendulum(context):
    return Pendulum(context, visibility="hidden")


def test_observations_end_with_the_coordinates():
    bare, shown = pendulum({"mass": 1.0}), Showing(pendulum, SPACE)({"mass": 1.0})
    assert shown.observation_space.shape == (4,)
    seen = zip(bare.reset(seed=3)[:1], shown.reset(seed=3)[:1], strict=True)
    for want, got in [*seen, (bare.step([1.0])[0], shown.step([1.0])[0])]:
        np.testing.assert_array_equal(got, [*want, np.float32(0.5)])
        assert shown.observation_space.contains(got)


def test_every_number_of_a_context_is_shown():
    space = ContextSpace.grid(
        {Linear("x", 0.0, 4.0): [1.0, 4.0], Categorical("road", ("dry", "wet", "ice")): ["wet"]}
    )
    env = ShowContext(pendulum({}), {"x": 1.0, "road": "wet"}, space)
    np.testing.assert_allclose(env.coordinates, space.encode({"x": 1.0, "road": "wet"}))
    assert env.coordinates.dtype == np.float32


def test_a_problem_from_an_environment_can_show_its_context():
    cmdp = CMDP.from_env("mine", SPACE, make_env=pendulum, show_context=True, timesteps=50)
    assert cmdp.settings["visibility"] == "cube"
    assert cmdp.trainer.make_env is cmdp.make_env
    assert pickle.loads(pickle.dumps(cmdp.make_env)) == cmdp.make_env
    check_cmdp(cmdp, steps=20).raise_if_failed()


class ByItself(Pendulum):
    ways = ("rest",)

    def drive(self):
        return super().step([1.0])

    def follow(self, way):
        assert way == "rest"
        return super().step([0.0])


def test_what_goes_by_itself_does_so_with_its_context_shown():
    bare = Showing(lambda context: gymnasium.make("Pendulum-v1"), SPACE)({"mass": 1.0})
    assert ways_of(bare) == ()
    make = Showing(lambda context: ByItself(context, visibility="hidden"), SPACE)
    one, other = make({"mass": 1.0}), make({"mass": 1.0})
    assert ways_of(one) == ("unguided", "rest")
    for torque, go in ((1.0, one.drive), (0.0, lambda: one.follow("rest"))):
        one.reset(seed=3)
        other.reset(seed=3)
        np.testing.assert_array_equal(go()[0], other.step([torque])[0])


def test_what_cannot_be_shown_is_refused():
    with pytest.raises(InvalidInput, match="FlattenObservation"):
        ShowContext(gymnasium.make("FrozenLake-v1"), {"mass": 1.0}, SPACE)
    with pytest.raises(ContextMismatch):
        Showing(pendulum, SPACE)({"mass": 20.0})
