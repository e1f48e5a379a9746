import pytest

from mbtl.problems import check_cmdp, cmdp_ids, get_cmdp
from mbtl.testing.cmdps import CMDPContract
from mbtl.zoo.cmdps.families import TRAFFIC_VARIANTS

IDS = [id for id in cmdp_ids() if id not in TRAFFIC_VARIANTS]


def marked(id):
    """Programs take long to compile; other tests train pendulums and robots."""
    return id if id == "cartpole-masscart" else pytest.param(id, marks=pytest.mark.long)


class TestOurs(CMDPContract):
    smoke = {"timesteps": 64, "eval_episodes": 2, "hyperparameters": {"n_steps": 64}}  # noqa: RUF012
    steps = 100

    @pytest.fixture(params=IDS)
    def cmdp(self, request):
        return get_cmdp(request.param)

    def test_passes_the_check(self, cmdp):
        check_cmdp(cmdp, steps=100).raise_if_failed()

    @pytest.mark.parametrize("cmdp", [marked(id) for id in IDS], indirect=True)
    def test_trains_and_transfers(self, cmdp):
        super().test_trains_and_transfers(cmdp)
