"""The check must find each defect, in an environment that is right in every other way."""

from functools import partial
from typing import ClassVar

import gymnasium
import numpy as np
import pytest
from gymnasium.spaces import Box, Dict, Discrete, Tuple
from gymnasium.wrappers import NormalizeObservation

from mbtl.contexts import Categorical, ContextSpace, Linear
from mbtl.errors import CheckFailed, ContextMismatch, InvalidInput
from mbtl.problems import CMDP, check_cmdp, get_cmdp

SPACE = ContextSpace.grid({Linear("gain", 0.5, 2.0, "1"): 4, Linear("drag", 0.0, 0.5, "1/s"): 4})


@pytest.fixture(autouse=True)
def _short(monkeypatch):
    """More than two episodes, and the last one is cut short."""
    monkeypatch.setattr("mbtl.problems.check.STEPS", 70)


class Sound(gymnasium.Env):
    """A point pushed left or right: position += gain (action - 1/2) - drag position."""

    observation_space = Box(-np.inf, np.inf, (2,), np.float64)
    action_space = Discrete(2)
    horizon = 30

    def __init__(self, context):
        self.gain, self.drag = context["gain"], context["drag"]

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.x, self.t = self.np_random.normal(), 0
        return self.observe(), {}

    def step(self, action):
        self.x += self.gain * (action - 0.5) - self.drag * self.x
        self.t += 1
        return self.observe(), -(self.x**2), False, self.t >= self.horizon, {}

    def observe(self):
        return np.array([self.x, self.gain])


class DeadAxis(Sound):
    """`gain` is shown and does nothing."""

    def step(self, action):
        self.x += action - 0.5 - self.drag * self.x
        self.t += 1
        return self.observe(), -(self.x**2), False, self.t >= self.horizon, {}


class OnlyTheRewardReacts(DeadAxis):
    def step(self, action):
        observation, reward, *rest = super().step(action)
        return observation, self.gain * reward, *rest


class LastOneWins(Sound):
    """Physics kept on the class: the newest instance changes the older ones."""

    physics: ClassVar[dict] = {}

    def __init__(self, context):
        super().__init__(context)
        self.physics.update(gain=self.gain)

    def step(self, action):
        self.gain = self.physics["gain"]
        return super().step(action)


class Remembers(Sound):
    """What was largest so far stays for all later instances."""

    largest: ClassVar[list] = [0.0]

    def __init__(self, context):
        super().__init__(context)
        self.largest[0] = max(self.largest[0], self.gain)
        self.gain += 0.1 * self.largest[0]


class RandomReset(Sound):
    def reset(self, *, seed=None, options=None):
        return super().reset(seed=None)


class Frozen(Sound):
    """What is drawn was drawn once for all."""

    def reset(self, *, seed=None, options=None):
        return super().reset(seed=0)


class DeadAxisAndRandomReset(DeadAxis):
    def reset(self, *, seed=None, options=None):
        return super().reset(seed=None)


class ForgetsToReset(Sound):
    """The clock of the first episode goes on."""

    t = 0

    def reset(self, *, seed=None, options=None):
        t = self.t
        result = super().reset(seed=seed)
        self.t = t % self.horizon
        return result


class NanAtCorner(Sound):
    def observe(self):
        return np.array([np.nan if self.gain == 2.0 and self.drag == 0.5 else self.x, self.gain])


class SpaceFollowsContext(Sound):
    def __init__(self, context):
        super().__init__(context)
        self.observation_space = Box(-self.gain, self.gain, (2,), np.float64)


class ListOfActions(Sound):
    action_space: ClassVar[list] = [Sound.action_space]


class RaisesAtCorner(Sound):
    def step(self, action):
        if self.gain == 2.0 and self.t == 25:  # later than two are tried side by side
            raise ZeroDivisionError("singular matrix")
        return super().step(action)


class OldInterface(Sound):
    def step(self, action):
        observation, reward, *_ = super().step(action)
        return observation, reward, False, {}


class Endless(Sound):
    horizon = 10**9


class OutOfItsSpace(Sound):
    observation_space = Box(-0.1, 0.1, (2,), np.float64)


class ManyWheels(Sound):
    """What no algorithm of Stable-Baselines3 takes."""

    action_space = Tuple([Discrete(2)])

    def step(self, action):
        return super().step(action[0])


class RefusesASecond(Sound):
    """There is one engine in a process."""

    owner: ClassVar[list] = []

    def reset(self, **given):
        if self.owner and self.owner[0] is not self:
            raise AssertionError("one engine per process")
        self.owner[:] = [self]
        return super().reset(**given)

    def close(self):
        self.owner.clear()


def failures(make_env, space=SPACE, **options):
    return {check.name: check.detail for check in check_cmdp(make_env, space, **options).failures}


def test_a_sound_environment_passes():
    report = check_cmdp(Sound, SPACE)
    assert report.ok
    assert {check.outcome for check in report.checks} == {"passed"}
    report.raise_if_failed()


@pytest.mark.parametrize(
    ("doubtful", "name", "detail"),
    [
        (Frozen, "reset is deterministic", "another seed gives the same rollout"),
        (DeadAxisAndRandomReset, "axis 'gain' acts on the dynamics", "cannot be decided"),
        (RandomReset, "contexts do not leak", "cannot be decided"),
    ],
)
def test_what_cannot_be_decided_is_a_warning(doubtful, name, detail):
    found = {check.name: check for check in check_cmdp(doubtful, SPACE).checks}[name]
    assert found.outcome == "warning"
    assert detail in found.detail


@pytest.mark.parametrize(
    ("broken", "name", "detail"),
    [
        (DeadAxis, "axis 'gain' acts on the dynamics", "only a constant part"),
        (LastOneWins, "contexts do not leak", "while another context is simulated"),
        (Remembers, "contexts do not leak", "after other contexts were simulated"),
        (RandomReset, "reset is deterministic", "same instance"),
        (ForgetsToReset, "reset is deterministic", "end of the episode"),
        (NanAtCorner, "runs and stays finite at the corners", "nan"),
        (SpaceFollowsContext, "same spaces in every context", "is -0.5 to 0.5 in place (0,)"),
        (ListOfActions, "runs at the nominal context", "make those of several agents one vector"),
        (RaisesAtCorner, "runs and stays finite at the corners", "singular matrix"),
        (RaisesAtCorner, "runs and stays finite at the corners", "matrix, in the context {'"),
        (OldInterface, "runs at the nominal context", "must return (observation, reward, term"),
    ],
)
def test_each_defect_is_found(broken, name, detail):
    found = failures(broken)
    assert detail in found[name]
    assert len(found) == 1 or broken not in (DeadAxis, LastOneWins)


ONLY = Sound({"gain": 1.0, "drag": 0.1})


@pytest.mark.parametrize(
    ("broken", "detail"),
    [
        (lambda context: ONLY, "same instance twice"),
        (lambda context: NormalizeObservation(Sound(context)), "got NormalizeObservation"),
    ],
)
def test_an_environment_that_is_not_new_is_the_only_failure_as_all_else_rests_on_it(broken, detail):
    ((name, said),) = failures(broken).items()
    assert (name, detail in said) == ("environments are new and live side by side", True)


def test_values_outside_their_spaces_and_spaces_that_are_not_taken_fail():
    name = "observations and actions lie in their spaces"
    assert "not within -0.1 to 0.1" in failures(OutOfItsSpace)[name]
    cmdp = CMDP.from_env("wheels", SPACE, make_env=ManyWheels, timesteps=1)
    assert "make them one vector" in failures(cmdp, None)[name]


@pytest.mark.long  # it starts processes, as the trainer's own test of this does
def test_an_engine_that_is_alone_in_its_process_is_named_and_checked_in_processes():
    report = check_cmdp(RefusesASecond, SPACE, steps=20)
    assert report.ok
    (warning,) = [check for check in report.checks if check.outcome == "warning"]
    assert "one engine per process) lives once per process" in warning.detail


def test_a_named_score_is_looked_for_at_the_end_of_an_episode():
    cmdp = CMDP.from_env("mine", SPACE, make_env=Sound, timesteps=1, score="delay")
    assert "must hold the score 'delay'" in failures(cmdp, None)["episodes end"]


def test_each_check_is_said_as_it_begins():
    said = []
    report = check_cmdp(Sound, SPACE, on_check=said.append)
    names = [check.name for check in report.checks[1:]]  # units need no environment
    assert said == names


def test_a_context_that_changes_only_the_reward_acts():
    assert failures(OnlyTheRewardReacts) == {}


@pytest.mark.parametrize("visibility", ["hidden", "raw"])
def test_cart_mass_is_dead_in_the_reference_physics_seen_or_unseen(visibility):
    cmdp = get_cmdp("cartpole-masscart", physics="reference", visibility=visibility)
    assert list(failures(cmdp, None)) == ["axis 'masscart' acts on the dynamics"]
    assert check_cmdp(get_cmdp("cartpole-length", physics="reference", visibility=visibility)).ok
    with pytest.raises(CheckFailed, match=r"cartpole-masscart failed 1 of .*masscart"):
        check_cmdp(cmdp).raise_if_failed()


def test_an_environment_without_time_limit_is_a_warning_or_a_failure_against_the_record():
    [warning] = [c for c in check_cmdp(Endless, SPACE).checks if c.outcome == "warning"]
    assert (warning.name, warning.ok) == ("episodes end", True)
    cmdp = CMDP.from_env("endless", SPACE, make_env=Endless, timesteps=1, horizon=50)
    assert "declared horizon of 50" in failures(cmdp, None)["episodes end"]


def test_what_the_record_leaves_open_is_a_warning():
    space = ContextSpace.grid({Linear("gain", 0.5, 2.0): 4, Linear("drag", 0.0, 0.5): 4})
    report = check_cmdp(CMDP.from_env("mine", space, make_env=Sound, timesteps=1))
    warnings = [check.name for check in report.checks if check.outcome == "warning"]
    assert warnings == ["units", "bounds", "nominal context"]
    assert report.ok


def test_functions_cannot_be_looked_into_and_the_report_says_so():
    cmdp = CMDP.from_functions("mine", SPACE, train=print, evaluate=print)
    last = check_cmdp(cmdp).checks[-1]
    assert (last.name, last.outcome) == ("environment", "warning")


class Kinds(Sound):
    """A categorical context and a dictionary of observations."""

    observation_space = Dict({"x": Box(-np.inf, np.inf, (1,)), "sign": Discrete(2)})

    def __init__(self, context):
        super().__init__({"gain": {"ice": 1.0, "mud": 0.2}[context["ground"]], "drag": 0.0})

    def observe(self):
        return {"x": np.array([self.x], dtype=np.float32), "sign": int(self.x > 0)}


def test_categories_and_composed_observations():
    axis = Categorical("ground", ("ice", "mud"))
    assert failures(Kinds, ContextSpace.grid({axis: 2})) == {}


def test_a_list_of_points_is_never_recombined_at_the_corners():
    pairs = [(0.5, 0.0), (1.0, 0.2), (2.0, 0.1)]
    space = ContextSpace.points(SPACE.axes, [{"gain": g, "drag": d} for g, d in pairs])
    assert failures(NanAtCorner, space) == {}


def test_the_report_is_data():
    report = check_cmdp(partial(DeadAxis), SPACE, nominal={"gain": 1.1, "drag": 0.3}, steps=40)
    record = report.to_json()
    assert record["ok"] is False
    assert {"name", "outcome", "detail"} == set(record["checks"][0])
    assert "40 steps" in str(record)


def test_wrong_calls_are_named():
    with pytest.raises(InvalidInput, match="give a ContextSpace"):
        check_cmdp(Sound)
    with pytest.raises(InvalidInput, match="steps >= 1"):
        check_cmdp(Sound, SPACE, steps=0)
    with pytest.raises(ContextMismatch):
        check_cmdp(Sound, SPACE, nominal={"gain": 99.0, "drag": 0.0})
