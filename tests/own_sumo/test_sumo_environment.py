"""An episode measures what SUMO writes, and the policy keeps the light's own yellow."""

import itertools
import os
import pickle
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

import mbtl
from mbtl import sumo
from mbtl.envs.references import ways_of
from mbtl.errors import InvalidInput, UnknownName
from mbtl.report import summarise_study
from mbtl.sumo.installed import program
from mbtl.sumo.scenario import Scenario

CHANGES = {"demand": sumo.Demand()}
SPACE = mbtl.ContextSpace.grid({mbtl.Linear("demand", 0.5, 2.0, unit="times"): [0.5, 2.0]})


@pytest.fixture
def make(own, opened):
    def make(demand=1.0, config=own, **settings):
        scenario = Scenario.read(config, CHANGES)
        return opened(sumo.ScenarioEnv({"demand": demand}, scenario, **settings))

    return make


def play(env, step, seed=5):
    """The observations and the last `info` of an episode."""
    seen, ended = [env.reset(seed=seed)[0]], False
    while not ended:
        observation, _, terminated, ended, info = step()
        assert not terminated
        assert env.observation_space.contains(observation)
        assert bool(info) is ended
        seen.append(observation)
    return np.array(seen), info


# ---- what is measured ----------------------------------------------------------------------------


def alone(config, folder, *words):
    """What SUMO's own program writes about a scenario."""
    shutil.copytree(config.parent, folder, dirs_exist_ok=True)
    (folder / "out").mkdir()
    outputs = {
        "tripinfo-output": "trips.xml",
        "tripinfo-output.write-undeparted": "true",
        "tripinfo-output.write-unfinished": "true",
        "statistic-output": "statistics.xml",
        "summary-output": "summary.xml",
        "device.emissions.probability": "1",
    }
    asked = [word for name, value in outputs.items() for word in (f"--{name}", value)]
    command = [program("sumo"), "-c", config.name, *asked, *words]
    subprocess.run(command, check=True, capture_output=True, cwd=folder)
    return [ElementTree.parse(folder / f"{one}.xml") for one in ("summary", "statistics", "trips")]


def test_metrics_are_those_of_sumos_own_outputs(own, tmp_path, make):
    """With vehicles that are on their way, and that wait to enter, when time is over."""
    env = make(4.0, seconds=200)
    _, info = play(env, env.drive)
    env.reset(seed=5)
    with env.simulation.guard() as api:
        seed = api.simulation.getOption("seed")
    env.close()
    asked = ["--seed", seed, "--end", "200", "--scale", "4"]
    summary, statistics, trips = alone(own, tmp_path, *asked)
    steps, vehicles = list(summary.iter("step")), statistics.find("vehicles").attrib
    assert int(vehicles["running"]) > 20
    assert int(vehicles["waiting"]) > 20
    mean = statistics.find("vehicleTripStatistics").attrib
    lost = int(vehicles["inserted"]) * float(mean["timeLoss"]) + float(mean["totalDepartDelay"])
    assert info["delay"] == pytest.approx(lost / int(vehicles["loaded"]), rel=1e-3)
    stand = [int(one.get("halting")) + int(one.get("waiting")) for one in steps]
    assert info["queue"] == pytest.approx(np.mean(stand), rel=0.02)
    assert info["throughput"] == int(steps[-1].get("arrived")) * 3600 / 200
    milligrams = sum(float(one.get("CO2_abs")) for one in trips.iter("emissions"))
    assert info["co2"] == pytest.approx(milligrams / 1e6 * 3600 / 200)
    assert {*info} == {*sumo.METRICS}


def test_teleports_are_counted(own, tmp_path, make):
    """Of vehicles that stand for ten seconds, where the configuration wants that."""
    config = own.with_name("teleporting.sumocfg")
    config.write_text(own.read_text().replace("<time>", '<time-to-teleport value="10"/><time>'))
    env = make(2.0, config=config)
    _, info = play(env, lambda: env.step(0))
    config.unlink()
    assert info["teleports"] > 0
    env = make(2.0)  # SUMO's own 300 s
    assert play(env, lambda: env.step(0))[1]["teleports"] == 0


# ---- what a policy does --------------------------------------------------------------------------


def shown(env, action):
    """(state, seconds) of the light, one after another."""
    env.reset(seed=0)
    states, ended = [], False
    while not ended:
        ended = env.step(action)[3]
        if not ended:
            with env.simulation.guard() as api:
                states.append(api.trafficlight.getRedYellowGreenState("A0"))
    return [(state, len(list(some))) for state, some in itertools.groupby(states)]


def test_going_on_keeps_the_least_green_and_the_lights_own_yellow(make):
    env = make(decision=1.0, seconds=100)
    assert env.control.lights["A0"].phases == 4
    phases = shown(env, 1)[1:-1]  # of the first and the last not all is seen
    assert {seconds for state, seconds in phases if "y" in state} == {3}
    assert {seconds for state, seconds in phases if "y" not in state} == {10}
    order = ["GGggrrrrGGggrrrr", "yyyyrrrryyyyrrrr", "rrrrGGggrrrrGGgg", "rrrryyyyrrrryyyy"]
    start = order.index(phases[0][0])
    cycle = itertools.islice(itertools.cycle(order), start, start + len(phases))
    assert [state for state, _ in phases] == [*cycle]
    assert len(phases) > 5


def test_keeping_the_green_keeps_it(make):
    assert len(shown(make(decision=1.0, seconds=100), 0)) == 1


def test_the_policy_sees_lanes_phase_and_whether_it_may_go_on(make):
    env = make(decision=1.0, seconds=60)
    seen, _ = play(env, lambda: env.step(1))
    lanes, phase, ready = seen[:, :8], seen[:, 8:12], seen[:, 12]
    assert env.control.lanes == ["bottom0A0_0", "left0A0_0", "right0A0_0", "top0A0_0"]
    assert (lanes[:, 3] == 0.0).all()  # nobody comes from there
    assert (lanes[:, :3].max(axis=0) > 0.0).all()
    assert (lanes[:, 4:] <= lanes[:, :4]).all()  # who halts is there
    assert (phase.sum(axis=1) == 1.0).all()
    ended = phase[:-1][ready[:-1] == 1.0].argmax(axis=1)  # 60 s: four greens of 10 s, yellows of 3
    assert ended.tolist() == [0, 2, 0, 2]


def test_controllers_of_sumos_own_stand_beside_policies(make):
    env = make()
    assert ways_of(env) == ("unguided", "fixed time", "actuated")
    itself = play(env, env.drive)[1]
    fixed, actuated = (play(env, lambda way=way: env.follow(way))[1] for way in env.ways)
    assert fixed == itself  # the file's programme is one of fixed times
    assert actuated["delay"] < 0.8 * fixed["delay"]
    with pytest.raises(UnknownName, match="Did you mean 'actuated'"):
        env.follow("actuatd")


def test_environments_of_one_process_have_simulations_of_their_own(make):
    one, other = make(seconds=60), make(seconds=60)
    one.reset(seed=5)
    told = play(other, lambda: other.step(1))
    other.reset(seed=1)
    assert (one.simulation.running, other.simulation.running) == ("libsumo", "traci")
    one.close()
    other.close()
    again = play(one, lambda: one.step(1))
    assert told[1] == again[1]
    np.testing.assert_array_equal(told[0], again[0])
    with pytest.raises(InvalidInput, match="reset"):
        one.step(0)


class Calm(sumo.KeepOrGoOn):
    """A user's own: less is seen, and something else is rewarded."""

    def __init__(self, scenario, lights=()):
        super().__init__(scenario, lights, min_green=5.0)
        from gymnasium.spaces import Box

        self.observation_space = Box(0.0, np.inf, (1,))

    def observe(self, sumo):
        return super().observe(sumo)[-1:]

    def reward(self, sumo):
        return -len(sumo.vehicle.getIDList())


def test_what_a_policy_sees_and_earns_may_be_a_users_own(own, opened):
    settings = {"lights": ["A0"], "control": Calm, "seconds": 60, "timesteps": 100}
    problem = sumo.from_sumocfg("own", own, SPACE, CHANGES, **settings)
    env = opened(pickle.loads(pickle.dumps(problem.make_env))({"demand": 2.0}))
    seen, _ = env.reset(seed=0)
    assert seen.shape == (1,)
    assert sum(env.step(1)[1] for _ in range(6)) < -10.0
    assert problem.horizon == 12


def test_pictures_are_those_of_the_network(make):
    env = make(seconds=60, render_mode="rgb_array")
    assert env.render() is None
    env.reset(seed=0)
    before = env.render()
    for _ in range(12):
        env.step(1)
    after = env.render()  # the simulation has ended
    assert before.shape == after.shape
    assert before.dtype == np.uint8
    assert (before != after).any()


# ---- whole studies, and networks of others -------------------------------------------------------


@pytest.mark.parametrize("strategy", ["mbtl", "auto"])
def test_a_study_of_two_trainings_runs_to_its_end_with_all_metrics(strategy, own):
    """`auto` goes on with trainings that were frozen in the middle of an episode."""
    pytest.importorskip("stable_baselines3")
    problem = sumo.from_sumocfg(
        "own", own, SPACE, CHANGES, seconds=100, timesteps=500, eval_episodes=1, budget=2,
        hyperparameters={"n_steps": 250, "batch_size": 50},
    )  # fmt: skip
    result = problem.study(strategy=strategy).run()
    assert {training.state for training in result.trainings} == {"done"}
    assert sum(training.length for training in result.trainings) >= 2.0
    summary = summarise_study(result.study)
    ways = ["unguided", "fixed time", "actuated"]
    assert [one.name for one in summary.baselines] == ways
    assert {*summary.metrics} == {"policies", *ways}
    for told in summary.metrics.values():
        assert {*told} == {"queue", "throughput", "co2", "teleports"}
        assert told["throughput"] > 0.0
    assert summary.score[1] == "s/veh"
    assert problem.direction == "minimize"


def test_a_scenario_keeps_the_contract(own):
    pytest.importorskip("stable_baselines3")
    problem = sumo.from_sumocfg("own", own, SPACE, CHANGES, seconds=100, timesteps=500)
    report = mbtl.check_cmdp(problem, steps=8)
    assert not report.failures, report.failures


GAME = Path(find_spec("sumo").submodule_search_locations[0], "tools", "game")


@pytest.mark.parametrize(("name", "lights"), [("cross", 1), ("square", 12), ("ramp", 1)])
def test_networks_that_come_with_sumo(name, lights, opened):
    config = GAME / f"{name}.sumocfg"
    if not config.exists():
        pytest.skip("this SUMO comes without its games")
    before = {*GAME.rglob("*")}
    problem = sumo.from_sumocfg(name, config, SPACE, CHANGES, seconds=60, timesteps=100)
    co2 = []
    for demand in (0.5, 2.0):
        env = opened(problem.make_env({"demand": demand}))
        env.action_space.seed(0)
        co2.append(play(env, lambda env=env: env.step(env.action_space.sample()))[1]["co2"])
        assert len(env.control.lights) == lights
    assert co2[1] > co2[0] > 0.0
    assert {*GAME.rglob("*")} == before


# ---- sumo-rl -------------------------------------------------------------------------------------


@pytest.mark.skipif(not find_spec("sumo_rl"), reason="sumo-rl is not installed")
@pytest.mark.parametrize("inside", ["", "LIBSUMO_AS_TRACI"])
def test_an_environment_of_sumo_rl_has_axes_and_metrics(inside, tmp_path):
    """In a process of its own, as sumo-rl decides by the environment when it is imported."""
    code = tmp_path / "own.py"
    code.write_text(SUMO_RL)
    variables = {**os.environ, **({inside: "1"} if inside else {})}
    done = subprocess.run(
        [sys.executable, code], env=variables, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == "fine"


SUMO_RL = """
from importlib.util import find_spec
from pathlib import Path
import mbtl
from mbtl import sumo

net = Path(find_spec("sumo_rl").submodule_search_locations[0], "nets", "single-intersection")
files = [str(net / f"single-intersection.{kind}.xml") for kind in ("net", "rou")]
flow = sumo.Attribute("single-intersection.rou.xml", "flow[@id='flow_ns']", "probability")
changes = {"demand": sumo.Demand(), "limit": sumo.SpeedLimit(), "ns": flow}
axes = [mbtl.Linear(name, 0.2, 1.0, unit="1") for name in changes]
space = mbtl.ContextSpace.grid({axis: 2 for axis in axes})
problem = sumo.from_sumo_rl(
    "rl", *files, space, changes, {"num_seconds": 100, "sumo_warnings": False}, timesteps=100
)

def play(**context):
    env = problem.make_env({**dict.fromkeys(changes, 1.0), **context})
    env.reset(seed=3)
    ended, k = False, 0
    while not ended:
        _, _, _, ended, info = env.step(k // 4 % 2)
        k += 1
    again, _ = env.reset()
    env.close()
    assert k == 20
    assert info["step"] == 100.0
    return {name: info[name] for name in sumo.METRICS}

first = play()
assert first == play()
assert first["co2"] > 0.0 and first["throughput"] > 0.0
for name in changes:
    assert play(**{name: 0.2}) != first, name
print("fine")
"""
