"""The contract of CMDPs, for one of each traffic family in each of its engines."""

import pkgutil

import pytest

pytest.importorskip("libsumo", reason="the traffic extra is not installed")
pytest.importorskip("pettingzoo", reason="the traffic extra is not installed")
pytest.importorskip("stable_baselines3", reason="the train extra is not installed")

import gymnasium
from gymnasium.utils.env_checker import check_env

from mbtl.problems import check_cmdp, get_cmdp
from mbtl.testing.cmdps import CMDPContract
from mbtl.zoo.cmdps import gym_id
from mbtl.zoo.cmdps.families import TRAFFIC_VARIANTS

ONE = {"episodes": 1, "eval_episodes": 1, "checkpoint_episodes": 1}
HERE = {**ONE, "processes": False}  # as a test of the command starts them, they are in others
SMALL = {"policy_kwargs": {"net_arch": [8]}}
SUMO = {
    "ring-acc": {**HERE, "hyperparameters": SMALL},
    "ramp-vel": {**HERE, "hyperparameters": SMALL},
    "signal-length": {**HERE, "hyperparameters": {"gradient_steps": 2}},
    "eco-inflow": {**HERE, "hyperparameters": {"n_epochs": 1, **SMALL}},
}
LONG_RING, LONG_RAMP = (pytest.param(id, marks=pytest.mark.long) for id in ("ring-acc", "ramp-vel"))
"""One of the two with holds is enough for what takes long."""
LONG_SIGNAL = pytest.param("signal-length", marks=pytest.mark.long)
OTHERS = ("ramp-vel", "signal-length", "eco-inflow")


class TestTraffic(CMDPContract):
    steps = 12

    @pytest.fixture(params=SUMO)
    def cmdp(self, request):
        self.smoke = SUMO[request.param]
        return get_cmdp(request.param, engine="sumo")

    @pytest.mark.parametrize("cmdp", [LONG_RING, *OTHERS], indirect=True)
    def test_passes_the_check(self, cmdp):
        holds = cmdp.space.axes[0].name == "hold"  # where a step is up to 40 s of simulation
        check_cmdp(cmdp, steps=2 if holds else 8).raise_if_failed()

    @pytest.mark.parametrize(
        "cmdp", ["ring-acc", LONG_RAMP, LONG_SIGNAL, "eco-inflow"], indirect=True
    )
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
@pytest.mark.parametrize("id", sorted(TRAFFIC_VARIANTS))
def test_all_pass_the_check_in_full(id):
    check_cmdp(get_cmdp(id, engine="sumo")).raise_if_failed()


@pytest.mark.parametrize("id", TRAFFIC_VARIANTS)
def test_a_class_shows_of_its_context_what_the_cmdp_shows(id):
    cmdp = get_cmdp(id)
    kind = pkgutil.resolve_name(cmdp.make_env.entry_point)
    assert len(kind(cmdp.nominal).visible) == len(cmdp.make_env(cmdp.nominal).visible)


@pytest.mark.parametrize(
    "id",
    [
        pytest.param("ring-vel", marks=pytest.mark.long),
        pytest.param("ramp-acc", marks=pytest.mark.long),
        "signal-length",
        "eco-green",
    ],
)
@pytest.mark.filterwarnings("ignore:.*space (minimum|maximum) value is -?infinity")
@pytest.mark.filterwarnings("ignore:.*symmetric and normalized space")
def test_gymnasium_s_own_checker_agrees(id):
    env = gymnasium.make(gym_id(id), render_mode="rgb_array").unwrapped
    check_env(env)
    env.close()
