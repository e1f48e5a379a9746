"""The contract of CMDPs, for one of each traffic family in each of its engines."""

import pkgutil

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from pettingzoo.test import parallel_api_test

from mbtl.envs.recording import draw_actions
from mbtl.envs.slots import as_one
from mbtl.errors import ContextMismatch, InvalidInput, UnknownName
from mbtl.problems import check_cmdp, get_cmdp
from mbtl.testing.cmdps import CMDPContract
from mbtl.trainers import reference_rows
from mbtl.zoo.cmdps import gym_id
from mbtl.zoo.cmdps.families import TRAFFIC_VARIANTS
from mbtl.zoo.cmdps.traffic.eco import Eco
from mbtl.zoo.cmdps.traffic.ramp import Ramp, RampVel
from mbtl.zoo.cmdps.traffic.ring import Ring, RingVel
from mbtl.zoo.cmdps.traffic.signal import Signal

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
def test_a_seeded_rollout_is_the_same_again_and_another_in_another_context(id):
    space, rollouts = get_cmdp(id).space, []
    for place in (0, 0, 4 if space.axes[0].name == "hold" else -1):
        env = as_one(
            get_cmdp(id, engine="sumo", visibility="hidden").make_env(space.contexts[place])
        )
        seen = [env.reset(seed=0)[0]]
        seen += [env.step(action)[0] for action in draw_actions(env.action_space, 12, seed=0)]
        rollouts.append(np.array(seen))
        env.close()
    first, again, elsewhere = rollouts
    assert np.array_equal(first, again)
    assert not np.array_equal(first, elsewhere)


NAN = float("nan")


@pytest.mark.parametrize(
    ("kind", "context", "options", "error", "words"),
    [
        (Ring, {"hold": 0.25}, {}, ContextMismatch, r"0\.1 s"),
        (Ring, {"hold": 0}, {}, ContextMismatch, "> 0"),
        (Ring, None, {"obs": "old"}, UnknownName, "stale"),
        (Ring, None, {"start": "even"}, UnknownName, "uniform"),
        (RingVel, None, {"render_mode": "human"}, UnknownName, "render mode"),
        (Ramp, {"hold": 0.01}, {}, ContextMismatch, r"0\.1 s"),
        (Ramp, None, {"obs": "new"}, UnknownName, "fresh"),
        (Ramp, None, {"time_limit": "none"}, UnknownName, "time limit"),
        *((Eco, {"green": g}, {}, ContextMismatch, "at least 1 s") for g in (0, 0.5, -1.0, 10.2)),
        *((Eco, {"penetration": p}, {}, ContextMismatch, r"\(0, 1\]") for p in (0, 1.2, -0.1, NAN)),
        (Eco, {"inflow": 0}, {}, ContextMismatch, "inflow"),
        (Eco, {"penetrations": 0.3}, {}, UnknownName, "penetration"),
        (Eco, None, {"score": "all"}, UnknownName, "everyone, paper"),
        (Signal, {"length": 5}, {}, ContextMismatch, "hold a car"),
        (Signal, {"inflow": 10.5}, {}, ContextMismatch, "number of cars"),
        (Signal, {"speed": 0}, {}, ContextMismatch, "> 0"),
        *((Signal, None, {"jam": jam}, InvalidInput, "< 0") for jam in (0.0, NAN)),
    ],
)
def test_contexts_and_settings_that_make_no_sense_are_refused(kind, context, options, error, words):
    with pytest.raises(error, match=words):
        kind(context, **options)


@pytest.mark.parametrize(
    ("kind", "actions", "words"),
    [
        (RingVel, (-1, 10, 2.5), "0 to 9"),
        (RampVel, (10,), "0 to 9"),
        (Eco, ([NAN],), "finite"),
        (Signal, (-1, 4, 0.5), "0, 1, 2 or 3"),
    ],
)
def test_what_cannot_be_done_or_drawn_is_refused(opened, kind, actions, words):
    env = opened(kind(render_mode="rgb_array"))
    with pytest.raises(InvalidInput, match="reset"):
        env.render()
    env.reset(seed=0)
    for action in actions:
        with pytest.raises(InvalidInput, match=words):
            env.step(dict.fromkeys(env.agents, action) if hasattr(env, "agents") else action)
    with pytest.raises(InvalidInput, match="rgb_array"):
        opened(kind()).render()


@pytest.mark.parametrize(
    "id", [LONG["ring-acc"], LONG["ramp-vel"], "signal-length", LONG["eco-inflow"]]
)
@pytest.mark.filterwarnings("ignore:.*space (minimum|maximum) value is -?infinity")
@pytest.mark.filterwarnings("ignore:.*symmetric and normalized space")
def test_gymnasium_s_own_checker_agrees(opened, id):
    check_env(opened(gymnasium.make(gym_id(id), render_mode="rgb_array").unwrapped))


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
def test_the_parallel_interface_is_pettingzoos(opened, kind, context, options):
    parallel_api_test(opened(kind(context, **options)), num_cycles=12)
