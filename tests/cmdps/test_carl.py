"""CARL's environments as ours, on a stand-in of CARL's interface (CARL itself pins old Gymnasium).

docs/carl.md is made with the real one.
"""

import sys
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("gymnasium", reason="the envs extra is not installed")

import gymnasium

from mbtl.cmdps import check_cmdp
from mbtl.cmdps.carl import CarlFactory, carl_cmdp, carl_features, carl_space
from mbtl.errors import InvalidInput, MissingExtra, UnknownName


class CARLSlide(gymnasium.Env):
    """As CARL's: contexts by id, observations with the context beside; `wind` reaches nothing."""

    action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,), np.float32)
    observation_space = gymnasium.spaces.Dict(
        obs=gymnasium.spaces.Box(-np.inf, np.inf, (2,), np.float32),
        context=gymnasium.spaces.Dict(),
    )

    def __init__(self, contexts, obs_context_features):
        assert obs_context_features == []
        self.context = {"GRAVITY_Y": -10.0, "wind": 0.0} | contexts[0]
        if self.context["GRAVITY_Y"] == -7.0:
            raise KeyError("seven")

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.state, self.steps = self.np_random.uniform(-1, 1, 2), 0
        return self._seen(), {}

    def step(self, action):
        self.state = 0.9 * self.state + 0.01 * self.context["GRAVITY_Y"] + 0.1 * float(action[0])
        self.steps += 1
        return self._seen(), float(self.state.sum()), False, self.steps >= 20, {}

    def _seen(self):
        return {"obs": self.state.astype(np.float32), "context": {}}

    @staticmethod
    def get_context_features():
        return {
            "GRAVITY_Y": SimpleNamespace(lower=-20.0, upper=-0.01, default_value=-10.0),
            "wind": SimpleNamespace(lower=-np.inf, upper=np.inf, default_value=0.0),
            "kind": SimpleNamespace(choices=("a", "b"), default_value="a"),
        }


@pytest.fixture
def carl(monkeypatch):
    package, envs = ModuleType("carl"), ModuleType("carl.envs")
    package.envs, envs.CARLSlide = envs, CARLSlide
    monkeypatch.setitem(sys.modules, "carl", package)
    monkeypatch.setitem(sys.modules, "carl.envs", envs)


def test_features_are_axes_within_their_ranges(carl):
    assert carl_features("CARLSlide")["GRAVITY_Y"] == (-20.0, -0.01, -10.0)
    space = carl_space("CARLSlide", {"GRAVITY_Y": [-12.0, -6.0], "wind": [0.0, 1.0, 2.0]})
    assert space.n == 6
    assert space.contexts[1] == {"GRAVITY_Y": -12.0, "wind": 1.0}
    with pytest.raises(InvalidInput, match=r"'GRAVITY_Y' of CARLSlide must be from -20 to -0.01"):
        carl_space("CARLSlide", {"GRAVITY_Y": [-30.0, -6.0]})
    with pytest.raises(UnknownName, match="GRAVITY_Y"):
        carl_space("CARLSlide", {"GRAVITY": [-10.0]})
    with pytest.raises(UnknownName, match="environment of CARL"):
        carl_space("CARLSlider", {"GRAVITY_Y": [-10.0]})


def test_policies_see_the_observation_and_dead_features_are_found(carl):
    make = CarlFactory("CARLSlide")
    env = make({"GRAVITY_Y": -5.0})
    assert env.observation_space.shape == (2,)
    assert env.reset(seed=1)[0].shape == (2,)
    for name, values, acts in [("GRAVITY_Y", [-9.0, -5.0], True), ("wind", [0.0, 9.0], False)]:
        report = check_cmdp(make, carl_space("CARLSlide", {name: values}), steps=50)
        assert [check.name for check in report.failures] == (
            [] if acts else [f"axis {name!r} acts on the dynamics"]
        )
    with pytest.raises(InvalidInput, match=r"must take the context .*KeyError"):
        make({"GRAVITY_Y": -7.0})


def test_a_problem_of_it(carl):
    pytest.importorskip("stable_baselines3", reason="the train extra is not installed")
    problem = carl_cmdp("CARLSlide", {"GRAVITY_Y": [-12.0, -6.0]}, timesteps=100)
    assert (problem.id, problem.nominal) == ("carl-slide-gravity-y", {"GRAVITY_Y": -10.0})
    assert problem.space.n == 2
    other = carl_cmdp("CARLSlide", {"GRAVITY_Y": [-6.0, -5.0]}, timesteps=100, id="light")
    assert (other.id, other.nominal) == ("light", None)


def test_without_carl_the_page_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "carl", None)
    with pytest.raises(MissingExtra, match=r"carl-bench in an environment of its own.*carl\.md"):
        carl_features("CARLCartPole")
