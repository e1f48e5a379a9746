import pytest

from mbtl.problems import cmdp_ids, get_cmdp
from mbtl.testing.cmdps import CMDPContract
from mbtl.zoo.cmdps.families import TRAFFIC_VARIANTS

IDS = [id for id in cmdp_ids() if id not in TRAFFIC_VARIANTS]
TRAINED = {"cartpole-masscart", "pendulum-length", "cheetah-gravity"}
"""One of a family; what a walker trains by takes a minute to compile."""


def marked(id):
    return id if id in TRAINED else pytest.param(id, marks=pytest.mark.long)


class TestOurs(CMDPContract):
    smoke = {"timesteps": 64, "eval_episodes": 2, "hyperparameters": {"n_steps": 64}}  # noqa: RUF012
    steps = 100

    @pytest.fixture(params=IDS)
    def cmdp(self, request):
        return get_cmdp(request.param)

    @pytest.mark.parametrize("cmdp", map(marked, IDS), indirect=True)
    def test_trains_and_transfers(self, cmdp):
        super().test_trains_and_transfers(cmdp)
