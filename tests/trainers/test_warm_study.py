"""Studies with tuned copies: what is interrupted ends as what is not, whoever trains."""

import shutil

import numpy as np
import pytest
from training_envs import cartpole, same

import mbtl
from flat import created, ran
from mbtl.problems import get_cmdp
from mbtl.trainers import SB3Trainer
from warm import WARM, Stops

SPACE = mbtl.ContextSpace.grid({mbtl.Linear("length", 0.3, 1.0): 5})
PPO = {"n_steps": 64, "batch_size": 32, "n_epochs": 2, "learning_rate": lambda left: 1e-3 * left}
SMALL = {
    "timesteps": 1_024, "hyperparameters": {"n_envs": 2, "n_steps": 64, "batch_size": 64},
    "eval_episodes": 1, "checkpoint_episodes": 1,
}  # fmt: skip


def opened(engine, folder):
    if engine == "jax":
        pytest.importorskip("jax", reason="the jax extra is not installed")
        problem = get_cmdp("pendulum-length", engine="jax", visibility="hidden")
        options = {"trainer": problem.trainer_for("quick", **SMALL)}
    else:
        problem = SPACE
        trainer = SB3Trainer(cartpole, timesteps=256, hyperparameters=PPO, eval_episodes=1)
        options = {"trainer": trainer, "bounds": (0.0, 200.0)}
    return created(
        problem, budget=8, strategy=WARM, seed=4, load_if_exists=True,
        storage=folder / "study.db", **options,
    )  # fmt: skip


def policies(study):
    return [
        study.policies[i] if row.policy is None else study.trainer.load(
            study.artifacts.read(row.policy, row.sha256)
        )
        for i, row in enumerate(study.state.rows)
    ]  # fmt: skip


def alike(one, other):
    """Bit for bit."""
    if hasattr(one, "weights"):
        return all(map(np.array_equal, one.weights, other.weights))
    return same(one, other)


@pytest.mark.parametrize("engine", ["sb3", "jax"])
def test_interrupted_a_tuned_copy_is_bit_for_bit_the_undisturbed_one(engine, tmp_path):
    calm, stops, interrupts = opened(engine, tmp_path / "calm"), Stops(), 0
    ran(calm, report=False)
    while not (study := opened(engine, tmp_path / "disturbed")).is_finished:
        try:
            ran(study, report=False, callbacks=[stops])
            break
        except KeyboardInterrupt:
            interrupts += 1
    assert interrupts == 2
    assert [row.done > 0 for row in study.state.rows] == [False, False, True]
    undisturbed, disturbed = policies(calm), policies(study)
    assert all(map(alike, undisturbed, disturbed))
    for one, other in zip(calm.state.rows, study.state.rows, strict=True):
        np.testing.assert_array_equal(one.returns, other.returns)
    tuned, context = study.pick(1), [study.space.context(0)]
    asked = {"start": undisturbed[0], "state": tmp_path / "inherited"}
    if "inherit" in calm.trainer.takes:
        parent = study.state.rows[0]
        folder = study.artifacts.read(parent.state, parent.state_sha256)
        shutil.copy(folder / "state", asked["state"])
    alone = calm.trainer.train(context, tuned.seed, length=0.5, **asked).policy
    assert alike(alone, disturbed[1])
    assert not alike(calm.trainer.train(context, tuned.seed, length=0.5).policy, alone)
