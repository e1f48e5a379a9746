"""Studies with tuned copies in the jax engine: what is interrupted ends as what is not."""

import shutil

import numpy as np
from poles import same_policy

from flat import created, ran
from mbtl.problems import get_cmdp
from warm import Stops, Warm

SMALL = {
    "timesteps": 1_024, "hyperparameters": {"n_envs": 2, "n_steps": 64, "batch_size": 64},
    "eval_episodes": 1, "checkpoint_episodes": 1,
}  # fmt: skip
PROBLEM = get_cmdp("pendulum-length", engine="jax", visibility="hidden")


def opened(folder):
    trainer = PROBLEM.trainer_for("quick", **SMALL)
    return created(
        PROBLEM, budget=8, trainer=trainer, strategy=Warm(), seed=4, load_if_exists=True,
        storage=folder / "study.db",
    )  # fmt: skip


def policies(study):
    return [
        study.policies[i] if row.policy is None else study.trainer.load(
            study.artifacts.read(row.policy, row.sha256)
        )
        for i, row in enumerate(study.state.rows)
    ]  # fmt: skip


def test_interrupted_a_tuned_copy_is_bit_for_bit_the_undisturbed_one(tmp_path):
    calm, stops, interrupts = opened(tmp_path / "calm"), Stops(), 0
    ran(calm, report=False)
    while not (study := opened(tmp_path / "disturbed")).is_finished:
        try:
            ran(study, report=False, callbacks=[stops])
            break
        except KeyboardInterrupt:
            interrupts += 1
    assert interrupts == 2
    assert [row.goes_on for row in study.state.rows] == [False, False, True]
    undisturbed, disturbed = policies(calm), policies(study)
    assert all(same_policy(a, b) for a, b in zip(undisturbed, disturbed, strict=True))
    for one, other in zip(calm.state.rows, study.state.rows, strict=True):
        np.testing.assert_array_equal(one.returns, other.returns)
    tuned, context = study.pick(1), [study.space.context(0)]
    start = undisturbed[0]
    parent, file = study.state.rows[0], tmp_path / "inherited"
    shutil.copy(study.artifacts.read(parent.state, parent.state_sha256) / "state", file)
    alone = calm.trainer.train(context, tuned.seed, length=0.5, start=start, state=file).policy
    assert same_policy(alone, disturbed[1])
    assert not same_policy(calm.trainer.train(context, tuned.seed, length=0.5).policy, alone)
