"""Spaces: what is outside is found, what algorithms cannot take is adapted or refused."""

import gymnasium
import numpy as np
import pytest
from gymnasium.spaces import Box, Dict, Discrete, MultiBinary, MultiDiscrete, Tuple

from mbtl.envs.spaces import Plain, check_taken, outside
from mbtl.errors import InvalidInput

UNIT = Box(-1.0, 1.0, (2,), np.float32)


@pytest.mark.parametrize(
    ("space", "value"),
    [
        (UNIT, np.array([1.0, -1.0 - 1e-6], np.float32)),  # rounding
        (UNIT, np.array([0.5, 0.5])),  # float64
        (Discrete(3, start=-1), np.int64(-1)),
        (MultiDiscrete([2, 3], start=[5, -1]), np.array([6, 1])),
        (MultiBinary(2), np.array([True, False])),
        (Box(-np.inf, np.inf, (1,)), np.array([1e30])),
        (Dict({"a": UNIT, "b": Discrete(2)}), {"a": np.zeros(2), "b": 1}),
    ],
)
def test_what_lies_in_its_space(space, value):
    assert outside(space, value) is None


@pytest.mark.parametrize(
    ("space", "value", "said", "far"),
    [
        (UNIT, np.array([0.0, 1.5]), "1.5 at 1, not within -1 to 1", False),
        (UNIT, np.array([100.0, 0.0]), "100 at 0", True),
        (UNIT, np.zeros((2, 1)), "shape (2, 1) instead of (2,)", True),
        (Box(0.0, np.inf, (1,)), np.array([-0.5]), "-0.5", False),
        (Box(0.0, np.inf, (1,)), np.array([-2.0]), "-2", True),
        (Box(0, 255, (1,), np.uint8), np.array([300]), "300", True),
        (Box(0, 255, (1,), np.uint8), np.array([3.5]), "3.5 where the space has whole", True),
        (Discrete(3, start=-1), 2, "2, not within -1 to 1", True),
        (Discrete(2), None, "None, which is no array of numbers", True),
        (Dict({"a": UNIT}), {"b": np.zeros(2)}, "keys", True),
        (Dict({"a": UNIT, "b": Discrete(2)}), {"a": np.array([1.5, 0]), "b": 2}, "'b': 2", True),
    ],
)
def test_what_does_not(space, value, said, far):
    found = outside(space, value)
    assert said in found.said
    assert found.far is far


class Echo(gymnasium.Env):
    """Shows one value, and keeps what it was told."""

    def __init__(self, observed, acted, value):
        self.observation_space, self.action_space, self.value = observed, acted, value

    def reset(self, *, seed=None, options=None):
        return self.value, {}

    def step(self, action):
        self.told = action
        assert self.action_space.contains(action)
        return self.value, 0.0, False, False, {}


@pytest.mark.parametrize(
    ("observed", "value", "seen"),
    [
        (Discrete(4, start=3), 5, 2),
        (MultiDiscrete([3, 3], start=[1, -1]), np.array([2, 1]), [1, 2]),
        (UNIT, np.array([0.5, 0.25], np.float32), [0.5, 0.25]),
        (Dict({"a": Discrete(4, start=3), "b": UNIT}), {"a": 3, "b": np.zeros(2)}, None),
    ],
)
@pytest.mark.parametrize(
    ("acted", "told", "heard"),
    [
        (Discrete(3, start=-1), 0, -1),
        (MultiDiscrete([2, 3], start=[5, -1]), np.array([1, 0]), [6, -1]),
        (Box(-2, 2, (2,), np.int32), np.array([1.4, -1.6], np.float32), [1, -2]),
        (Discrete(3), 2, 2),
    ],
)
def test_an_algorithm_counts_from_zero_and_gives_real_numbers(
    observed, value, seen, acted, told, heard
):
    env = Echo(observed, acted, value)
    plain = Plain(env)
    assert plain.action_space.contains(told)
    plain.step(told)
    assert np.array_equal(env.told, heard)
    shown, _ = plain.reset()
    assert plain.observation_space.contains(
        {k: np.asarray(v, np.float32) if k == "b" else v for k, v in shown.items()}
        if isinstance(shown, dict)
        else shown
    )
    if seen is not None:
        assert np.array_equal(shown, seen)


@pytest.mark.parametrize(
    ("observed", "acted", "said"),
    [
        (Tuple([UNIT]), Discrete(2), "FlattenObservation"),
        (Dict({"a": Dict({"b": UNIT})}), Discrete(2), "FlattenObservation"),
        (UNIT, Tuple([Discrete(2)]), "one vector"),
        (UNIT, Box(0.0, np.inf, (1,)), "finite bounds"),
    ],
)
def test_what_no_algorithm_takes_is_refused(observed, acted, said):
    with pytest.raises(InvalidInput, match=said):
        check_taken(observed, acted)
