"""highway-env as the page on own simulators has it; where the package is installed."""

import re
from functools import partial
from pathlib import Path

import gymnasium
import pytest
from gymnasium.wrappers import FlattenObservation

import mbtl

pytest.importorskip("highway_env")

PAGE = Path(__file__).parents[2] / "docs" / "own-simulator.md"
LINE = re.search(r"`(gym\.make\(\"highway.*?)` in a", PAGE.read_text(encoding="utf-8"))[1]


def road(line, context):
    return FlattenObservation(eval(line, {"gym": gymnasium, "context": context}))


def test_the_density_of_traffic_is_an_axis_that_acts():
    space = mbtl.ContextSpace.grid({mbtl.Linear("density", 0.5, 2.0): 3})
    problem = mbtl.CMDP.from_env("road", space, make_env=partial(road, LINE), timesteps=64)
    mbtl.check_cmdp(problem).raise_if_failed()
