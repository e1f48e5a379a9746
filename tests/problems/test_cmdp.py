import gymnasium
import numpy as np
import pytest

import mbtl
from mbtl.contexts import ContextSpace, Linear
from mbtl.errors import ContextMismatch, InvalidInput, UnknownName
from mbtl.problems import CMDP, Preset
from mbtl.trainers import FunctionTrainer, SB3Trainer

SPACE = ContextSpace.grid({Linear("x", 0.0, 1.0): 5})


def train(context, seed):
    return context["x"] + seed


def evaluate(policy, contexts, seeds):
    return [policy - context["x"] for context in contexts]


def own(**record):
    return CMDP.from_functions("mine", SPACE, train=train, evaluate=evaluate, **record)


def pendulum(context):
    return gymnasium.make("mbtl/pendulum-mass-v0", context={"mass": 0.5 + context["x"]})


def test_two_functions_are_a_problem():
    cmdp = own(bounds=(0.0, 2.0), direction="minimize", description="toy")
    assert own(bounds=cmdp.normalisation).direction == "minimize"
    assert own(bounds=cmdp.normalisation).bounds == (0.0, 2.0)
    policy = cmdp.trainer.train([SPACE.context(1)], 3).policy
    np.testing.assert_allclose(
        cmdp.trainer.evaluate(policy, SPACE.contexts, range(SPACE.n)),
        3.25 - np.linspace(0.0, 1.0, 5),
    )
    assert (cmdp.id, cmdp.description, cmdp.make_env) == ("mine", "toy", None)
    assert cmdp.normalisation.normalise(0.0) == 1.0


def test_a_small_problem_gets_the_single_preset_default_and_a_budget_that_fits():
    cmdp = own()
    assert list(cmdp.presets) == ["default"]
    assert cmdp.preset().budget == 5
    assert own(budget=3).preset("default").budget == 3
    assert cmdp.trainer_for("default") is cmdp.trainer
    with pytest.raises(UnknownName, match="preset of 'mine'"):
        cmdp.trainer_for("quick")
    with pytest.raises(InvalidInput, match=r"own code, which takes no options, got timesteps"):
        cmdp.trainer_for(timesteps=10)


@pytest.mark.parametrize("budget", [mbtl.Steps(10, unit=5), mbtl.Cost(9.0), 2.5, "15"])
def test_steps_and_costs_are_budgets_of_a_study_not_of_a_problem(budget):
    words = r"usual number of trainings, got .*the study: problem\.study\(budget=mbtl\.Steps"
    with pytest.raises(InvalidInput, match=words):
        own(budget=budget)


def test_an_environment_and_an_algorithm_are_a_problem():
    cmdp = CMDP.from_env(
        "mine", SPACE, make_env=pendulum, timesteps=500, algorithm="SAC", horizon=200,
        hyperparameters={"gamma": 0.9}, trainer_options={"n_envs": 2}, nominal={"x": 0.5},
    )  # fmt: skip
    assert isinstance(cmdp.trainer, SB3Trainer)
    assert (cmdp.trainer.timesteps, cmdp.trainer.algorithm, cmdp.trainer.n_envs) == (500, "SAC", 2)
    assert cmdp.make_env is pendulum
    longer = cmdp.trainer_for(timesteps=900)
    assert (longer.timesteps, longer.hyperparameters) == (900, {"gamma": 0.9})
    with pytest.raises(UnknownName, match="Did you mean 'n_envs'"):
        CMDP.from_env("m", SPACE, make_env=pendulum, timesteps=9, trainer_options={"n_env": 2})
    with pytest.raises(UnknownName, match=r"CMDP\.from_env is called 'algoritm'.*mean 'algorithm'"):
        CMDP.from_env("m", SPACE, make_env=pendulum, timesteps=9, algoritm="SAC")


def test_one_metric_may_be_given_by_its_name():
    for metrics in ("fuel", ["fuel"], {"fuel": ""}):
        made = CMDP.from_functions("mine", SPACE, train=print, evaluate=print, metrics=metrics)
        assert made.metrics == {"fuel": ""}


def test_a_user_s_own_presets():
    presets = {"tiny": Preset(2, timesteps=10), "big": Preset(5, timesteps=99, algorithm="A2C")}
    cmdp = CMDP.from_env("mine", SPACE, make_env=pendulum, timesteps=50, presets=presets)
    assert cmdp.default_preset == "tiny"
    assert cmdp.trainer_for().timesteps == 10
    assert (cmdp.trainer_for("big").algorithm, cmdp.trainer_for("big").timesteps) == ("A2C", 99)


@pytest.mark.parametrize(
    ("record", "error", "match"),
    [
        ({"bounds": (1.0, 0.0)}, InvalidInput, "low < high"),
        ({"bounds": (0.0, float("inf"))}, InvalidInput, "finite"),
        ({"bounds": (0.0, 1.0, 2.0)}, InvalidInput, "two returns"),
        ({"bounds": 5}, InvalidInput, "two returns"),
        ({"baselines": [0.5]}, InvalidInput, r"baselines are a mapping by name, got \[0.5\]"),
        ({"bound": (0.0, 1.0)}, UnknownName, "from_functions is called 'bound'.*mean 'bounds'"),
        ({"budgt": 3}, UnknownName, "mean 'budget'"),
        ({"trainer": None}, UnknownName, "'trainer'"),
        ({"direction": "up"}, InvalidInput, "direction"),
        ({"theta": -1.0}, InvalidInput, "theta"),
        ({"version": -1}, InvalidInput, "version"),
        ({"horizon": 0}, InvalidInput, "horizon"),
        ({"nominal": {"x": 7.0}}, ContextMismatch, "x"),
        ({"nominal": {"y": 0.0}}, UnknownName, "axis"),
        ({"unit": {"y": 1.0}}, UnknownName, "axis"),
        ({"unit": {"x": 0.0}}, ContextMismatch, "> 0"),
        ({"budget": 0}, InvalidInput, "budget of a preset"),
        ({"budget": 6}, InvalidInput, "budget of a preset"),
    ],
)
def test_mistakes_in_the_record_are_named(record, error, match):
    with pytest.raises(error, match=match):
        own(**record)


def test_an_id_fit_for_no_file_name_and_contexts_that_are_no_space_are_refused():
    for id in ("", "a/b", "../up", ".hidden", "two words"):
        with pytest.raises(InvalidInput, match="file names"):
            CMDP(id, SPACE, FunctionTrainer(train, evaluate))
    with pytest.raises(InvalidInput, match="must be a ContextSpace, got list"):
        CMDP("mine", [1, 2], FunctionTrainer(train, evaluate))
    with pytest.raises(InvalidInput, match="must be a ContextSpace, got list"):
        CMDP.from_functions("mine", [1, 2], train=train, evaluate=evaluate)
