"""The contract of CMDPs, for one of each traffic family in each of its engines."""

import pkgutil

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from pettingzoo.test import parallel_api_test

from mbtl.envs.recording import draw_actions
from mbtl.envs.slots import as_one
from mbtl.problems import check_cmdp, get_cmdp
from mbtl.testing.cmdps import CMDPContract
from mbtl.trainers import reference_rows
from mbtl.zoo.cmdps import gym_id
from mbtl.zoo.cmdps.families import TRAFFIC_VARIANTS
from mbtl.zoo.cmdps.traffic.eco import Eco
from mbtl.zoo.cmdps.traffic.ramp import RampVel

ONE = {"episodes": 1, "eval_episodes": 1, "checkpoint_episodes": 1}
HERE = {**ONE, "processes": False}  # as a test of the command starts them, they are in others
SMALL = {"policy_kwargs": {"net_arch": [8]}}
SUMO = {
    "ring-acc": {**HERE, "hyperparameters": SMALL},
    "ramp-vel": {**HERE, "hyperparameters": SMALL},
    "signal-length": {**HERE, "hyperparameters": {"gradient_steps": 2}},
    "eco-inflow": {**HERE, "hyperparameters": {"n_epochs": 1, **SMALL}},
}
LONG = {id: pytest.param(id, marks=pytest.mark.long) for id in SUMO}


class TestTraffic(CMDPContract):
    steps = 5

    @pytest.fixture(params=SUMO)
    def cmdp(self, request):
        self.smoke = SUMO[request.param]
        return get_cmdp(request.param, engine="sumo")

    @pytest.mark.parametrize(
        "cmdp", [LONG["ring-acc"], LONG["ramp-vel"], "signal-length", "eco-inflow"], indirect=True
    )
    def test_passes_the_check(self, cmdp):
        holds = cmdp.space.axes[0].name == "hold"  # where a step is up to 40 s of simulation
        check_cmdp(cmdp, steps=2 if holds else 8).raise_if_failed()

    @pytest.mark.parametrize("cmdp", {**LONG, "ring-acc": "ring-acc"}.values(), indirect=True)
    def test_trains_and_transfers(self, cmdp):
        super().test_trains_and_transfers(cmdp)


@pytest.mark.long
class TestTwins(CMDPContract):
    steps, smoke = 12, ONE

    @pytest.fixture(params=["ring-vel", "eco-green"])
    def cmdp(self, request):
        pytest.importorskip("jax", reason="the jax extra is not installed")
        return get_cmdp(request.param, engine="jax")


@pytest.mark.long
@pytest.mark.parametrize(
    ("id", "context"),
    [
        ("ring-acc", {"hold": 40.0}),
        ("ramp-acc", {"hold": 40.0}),
        *(("eco-green", {"green": green}) for green in (5.0, 35.0)),
        ("eco-inflow", {"inflow": 1600.0}),
    ],
)
def test_unguided_traffic_flows_as_in_sumo(id, context):
    sumo, ours = (
        reference_rows(get_cmdp(id, engine=engine).trainer_for(eval_episodes=n), [context], [0])
        for engine, n in (("sumo", 8), ("jax", 100))
    )
    sumo, ours = sumo["unguided"][0], ours["unguided"][0]
    error = np.hypot(sumo.std(ddof=1) / 8**0.5, ours.std() / 10.0)
    assert abs(sumo.mean() - ours.mean()) <= 4.0 * error


@pytest.mark.parametrize("id", ["ring-vel", pytest.param("ramp-vel", marks=pytest.mark.long)])
def test_a_policy_of_the_twin_drives_in_sumo(id):
    hold = [{"hold": 40.0}]
    policy = get_cmdp(id, engine="jax").trainer_for("quick").untrained(hold[0])
    score = get_cmdp(id, engine="sumo").trainer_for(eval_episodes=1).evaluate(policy, hold, [0])
    assert score > 0.5


@pytest.mark.long
@pytest.mark.parametrize("id", sorted(TRAFFIC_VARIANTS))
def test_all_pass_the_check_in_full(id):
    check_cmdp(get_cmdp(id, engine="sumo")).raise_if_failed()


@pytest.mark.parametrize("id", TRAFFIC_VARIANTS)
def test_a_class_shows_of_its_context_what_the_cmdp_shows(id):
    cmdp = get_cmdp(id)
    kind = pkgutil.resolve_name(cmdp.make_env.entry_point)
    assert len(kind(cmdp.nominal).visible) == len(cmdp.make_env(cmdp.nominal).visible)


@pytest.mark.parametrize("id", TRAFFIC_VARIANTS)
def test_the_context_changes_a_seeded_rollout(id):
    space, rollouts = get_cmdp(id).space, []
    for place in (0, 4 if space.axes[0].name == "hold" else -1):
        env = as_one(
            get_cmdp(id, engine="sumo", visibility="hidden").make_env(space.contexts[place])
        )
        seen = [env.reset(seed=0)[0]]
        seen += [env.step(action)[0] for action in draw_actions(env.action_space, 12, seed=0)]
        rollouts.append(np.array(seen))
        env.close()
    assert not np.array_equal(*rollouts)


@pytest.mark.parametrize(
    "id", [LONG["ring-acc"], LONG["ramp-vel"], "signal-length", LONG["eco-inflow"]]
)
@pytest.mark.filterwarnings("ignore:.*space (minimum|maximum) value is -?infinity")
@pytest.mark.filterwarnings("ignore:.*symmetric and normalized space")
def test_gymnasium_s_own_checker_agrees(id):
    env = gymnasium.make(gym_id(id), render_mode="rgb_array").unwrapped
    check_env(env)
    env.close()


# it also expects every possible agent to have lived; the last ones never enter
@pytest.mark.filterwarnings("ignore:No agents present")
@pytest.mark.parametrize(
    ("kind", "context", "options"),
    [
        pytest.param(RampVel, {"hold": 40.0}, {}, marks=pytest.mark.long),
        # many cars, so that no episode is without agents: the test has no notion of that
        (Eco, {"penetration": 1.0, "inflow": 1000.0}, {"horizon": 20}),
    ],
)
def test_the_parallel_interface_is_pettingzoos(kind, context, options):
    env = kind(context, **options)
    parallel_api_test(env, num_cycles=12)
    env.close()
