"""A simulator that dies in the middle of a study costs one training, which can be done again."""

import os
from functools import partial

import pytest

from flat import created, ran

pytest.importorskip("libsumo")
pytest.importorskip("stable_baselines3")

from doomed import DoomedRing

import mbtl
from mbtl.errors import TrainingFailed
from mbtl.problems import get_cmdp
from mbtl.trainers import SB3Trainer


@pytest.mark.long
def test_a_study_goes_on_after_a_simulator_was_killed_in_training(tmp_path):
    cmdp = get_cmdp("ring-acc", engine="sumo")
    make_env = partial(DoomedRing, marker=tmp_path / "died", home=os.getpid(), visibility="hidden")
    trainer = SB3Trainer(
        make_env, episodes=1, algorithm="PPO", eval_episodes=1, processes=True, n_eval_envs=1,
        hyperparameters={"n_steps": 10, "batch_size": 10, "n_epochs": 1},
    )  # fmt: skip
    space = mbtl.ContextSpace.points(cmdp.space.axes, [{"hold": h} for h in (10.0, 20.0, 40.0)])
    study = created(
        space, budget=3, strategy="random", bounds=cmdp.bounds, storage=tmp_path / "study"
    )
    with pytest.raises(TrainingFailed, match="end of a process"):  # nothing has succeeded yet
        study.run(trainer=trainer)
    assert (tmp_path / "died").exists()
    again = mbtl.load_study(tmp_path / "study")
    assert len(again.state.failures) == 1
    ran(again, trainer=trainer, retry_failed=True)
    assert (len(again.state.failures), len(again.history.sources)) == (0, 3)
