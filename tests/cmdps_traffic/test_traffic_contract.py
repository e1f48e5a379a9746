"""The contract of CMDPs, for one of each traffic family in each of its engines."""

import pkgutil

import pytest

pytest.importorskip("libsumo", reason="the traffic extra is not installed")
pytest.importorskip("pettingzoo", reason="the traffic extra is not installed")
pytest.importorskip("stable_baselines3", reason="the train extra is not installed")

import gymnasium
from gymnasium.utils.env_checker import check_env

from mbtl.cmdps import check_cmdp, get_cmdp, gym_id
from mbtl.cmdps.traffic_families import TRAFFIC_VARIANTS
from mbtl.testing.cmdps import CMDPContract

ONE = {"episodes": 1, "eval_episodes": 1, "checkpoint_episodes": 1}
CASES = {
    ("ring-acc", "sumo"): ONE,
    ("ring-vel", "jax"): ONE,
    ("ramp-vel", "sumo"): ONE,
    ("signal-length", "sumo"): {**ONE, "hyperparameters": {"gradient_steps": 2}},
    ("eco-inflow", "sumo"): {**ONE, "hyperparameters": {"n_epochs": 1}},
    ("eco-green", "jax"): ONE,
}


@pytest.mark.slow
class TestTraffic(CMDPContract):
    steps = 12

    @pytest.fixture(params=CASES, ids="-".join)
    def cmdp(self, request):
        id, engine = request.param
        self.smoke = CASES[request.param]
        if engine == "jax":
            pytest.importorskip("jax", reason="the jax extra is not installed")
        return get_cmdp(id, engine=engine)


@pytest.mark.slow
@pytest.mark.parametrize(
    "id", sorted(set(TRAFFIC_VARIANTS) - {id for id, engine in CASES if engine == "sumo"})
)
def test_the_others_pass_the_check(id):
    check_cmdp(get_cmdp(id, engine="sumo")).raise_if_failed()


@pytest.mark.parametrize("id", TRAFFIC_VARIANTS)
def test_a_class_shows_of_its_context_what_the_cmdp_shows(id):
    cmdp = get_cmdp(id)
    kind = pkgutil.resolve_name(cmdp.make_env.entry_point)
    assert len(kind(cmdp.nominal).visible) == len(cmdp.make_env(cmdp.nominal).visible)


@pytest.mark.parametrize("id", ["ring-vel", "ramp-acc", "signal-length", "eco-green"])
@pytest.mark.filterwarnings("ignore:.*space (minimum|maximum) value is -?infinity")
@pytest.mark.filterwarnings("ignore:.*symmetric and normalized space")
def test_gymnasium_s_own_checker_agrees(id):
    env = gymnasium.make(gym_id(id), render_mode="rgb_array").unwrapped
    check_env(env)
    env.close()
