import pytest

from mbtl.problems import cmdp_ids, get_cmdp
from mbtl.testing.cmdps import CMDPContract
from mbtl.zoo.cmdps.families import TRAFFIC_VARIANTS

ELSEWHERE = {*TRAFFIC_VARIANTS, "walker-512"}


class TestOurs(CMDPContract):
    smoke = {"timesteps": 64, "eval_episodes": 2, "hyperparameters": {"n_steps": 64}}  # noqa: RUF012

    @pytest.fixture(params=[id for id in cmdp_ids() if id not in ELSEWHERE])
    def cmdp(self, request):
        return get_cmdp(request.param)


class TestOursWithOtherSwitches(TestOurs):
    """And walker-512: its programs take minutes to compile, and do what walker-gravity's do."""

    @pytest.mark.long
    def test_trains_and_transfers(self, cmdp):
        super().test_trains_and_transfers(cmdp)

    @pytest.fixture(
        params=[
            ("cartpole-length", {"visibility": "raw", "time_limit": "terminal"}),
            ("cartpole-masspole", {"visibility": "hidden", "physics": "reference"}),
            ("pendulum-timestep", {"visibility": "raw"}),
            ("walker-512", {}),
        ],
        ids=str,
    )
    def cmdp(self, request):
        id, switches = request.param
        return get_cmdp(id, **switches)
