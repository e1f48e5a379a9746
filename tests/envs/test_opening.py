"""What is believed of an environment: little, and nothing about the one beside it."""

import os
import sys
from types import SimpleNamespace

import gymnasium
import numpy as np
import pytest
from gymnasium.wrappers import NormalizeObservation, NormalizeReward
from singletons import Guarded, Normalised, Shared, Walk, only_one

from mbtl.envs import opening
from mbtl.envs.opening import Once, once_per_process, refuse_running_statistics, watched_episode
from mbtl.envs.recording import difference, draw_actions, roll
from mbtl.envs.remote import remote
from mbtl.errors import InvalidInput, Notice, TrainingFailed

CONTEXTS = [{"gain": 0.5}, {"gain": 2.0}]


@pytest.fixture(autouse=True)
def nothing_known(monkeypatch):
    monkeypatch.setattr(opening, "_known", {})


def test_what_lives_once_per_process_is_named_with_what_it_says_or_by_what_it_does():
    assert once_per_process(Walk, CONTEXTS) is None
    with pytest.warns(Notice, match="every environment gets a process of its own"):
        found = once_per_process(Guarded, CONTEXTS)
    refused = "(AssertionError: there should be only one engine in one process)"
    assert found == Once(f"singletons {refused}")
    with pytest.warns(Notice):
        assert once_per_process(Shared, CONTEXTS) == Once("singletons", silent=True)
    with pytest.raises(InvalidInput, match="same instance twice; build it inside"):
        once_per_process(only_one, CONTEXTS)


def test_a_context_that_fails_alone_is_no_reason_for_processes():
    def make_env(context):
        if context == CONTEXTS[-1]:
            raise ValueError("gain beyond the solver's range")
        return Walk(context)

    assert once_per_process(make_env, CONTEXTS) is None


def test_libsumo_is_known_before_a_second_is_opened(monkeypatch):
    made = []

    class Sumo(Walk):
        def __init__(self, context):
            super().__init__(context)
            made.append(self)

    monkeypatch.setitem(sys.modules, "libsumo", SimpleNamespace(isLoaded=lambda: True))
    monkeypatch.setattr(opening, "shared_well", {})
    with pytest.warns(Notice, match="libsumo lives once per process"):
        assert once_per_process(Sumo, CONTEXTS) == Once("libsumo")
    assert len(made) == 1


@pytest.mark.parametrize(
    ("wrapped", "said"),
    [
        (NormalizeObservation, r"NormalizeObservation \(its obs_rms\).*observations=True"),
        (NormalizeReward, r"NormalizeReward \(its return_rms\).*normalize_reward=True"),
        (lambda env: Normalised({"gain": 1.0}), r"Normalised \(its running_mean\)"),
    ],
)
def test_running_statistics_are_refused_by_name(wrapped, said):
    env = gymnasium.wrappers.TimeLimit(wrapped(Walk({"gain": 1.0})), 5)
    with pytest.raises(InvalidInput, match=said):
        refuse_running_statistics(env)


def test_statistics_that_do_not_run_are_nobodys_concern():
    env = NormalizeObservation(Walk({"gain": 1.0}))
    env.update_running_mean = False
    refuse_running_statistics(env)


def test_an_endless_episode_is_said_to_be_long_and_then_refused(monkeypatch):
    class Endless(Walk):
        def step(self, action):
            return np.zeros(1), 0.0, False, False, {}

    monkeypatch.setattr(opening, "LONGEST_EPISODE", 50)
    monkeypatch.setattr(opening, "_TELLING", 20)
    said = []
    with pytest.raises(TrainingFailed, match="TimeLimit"):
        watched_episode(Endless({"gain": 1.0}), 0, say=said.append)
    assert said == ["no episode has ended within 20 steps of random actions; looking on until 50"]


def test_an_environment_in_another_process_is_the_same_and_its_process_serves_again():
    env = remote(Guarded, CONTEXTS[1])
    beside = remote(Guarded, CONTEXTS[0])
    actions = draw_actions(env.action_space, 25, 0)
    assert difference(roll(env, actions, 3), roll(Walk(CONTEXTS[1]), actions, 3)) is None
    assert len({os.getpid(), env.process, beside.process}) == 3
    assert (env.double(3, more=1), env.get_wrapper_attr("strata")) == (7, (0.25, 0.75))
    assert not hasattr(env, "possible_agents")
    with pytest.raises(AttributeError):
        env.nothing  # noqa: B018
    process = env.process
    env.close()
    beside.close()
    with pytest.raises(InvalidInput, match="closed"):
        env.step(0)
    again = [remote(Walk, CONTEXTS[0]) for _ in range(2)]
    assert process in {one.process for one in again}
    for one in again:
        one.close()
