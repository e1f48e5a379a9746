"""Studies with tuned copies in Stable-Baselines3: what is interrupted ends as what is not."""

import numpy as np
from training_envs import cartpole, same

import mbtl
from flat import created, ran
from mbtl.trainers import SB3Trainer
from warm import Stops, Warm

SPACE = mbtl.ContextSpace.grid({mbtl.Linear("length", 0.3, 1.0): 5})
PPO = {"n_steps": 64, "batch_size": 32, "n_epochs": 2, "learning_rate": lambda left: 1e-3 * left}


def opened(folder=None):
    trainer = SB3Trainer(cartpole, timesteps=256, hyperparameters=PPO, eval_episodes=1)
    return created(
        SPACE, budget=8, trainer=trainer, bounds=(0.0, 200.0), strategy=Warm(), seed=4,
        load_if_exists=True, storage=None if folder is None else folder / "study.db",
    )  # fmt: skip


def policies(study):
    return [
        study.policies[i] if row.policy is None else study.trainer.load(
            study.artifacts.read(row.policy, row.sha256)
        )
        for i, row in enumerate(study.state.rows)
    ]  # fmt: skip


def test_interrupted_a_tuned_copy_is_bit_for_bit_the_undisturbed_one(tmp_path):
    calm, stops, interrupts = opened(), Stops(), 0
    ran(calm, report=False)
    while not (study := opened(tmp_path)).is_finished:
        try:
            ran(study, report=False, callbacks=[stops])
            break
        except KeyboardInterrupt:
            interrupts += 1
    assert interrupts == 2
    assert [row.goes_on for row in study.state.rows] == [False, False, True]
    undisturbed, disturbed = policies(calm), policies(study)
    assert all(same(a, b) for a, b in zip(undisturbed, disturbed, strict=True))
    for one, other in zip(calm.state.rows, study.state.rows, strict=True):
        np.testing.assert_array_equal(one.returns, other.returns)
    tuned, context = study.pick(1), [study.space.context(0)]
    start = undisturbed[0]
    alone = calm.trainer.train(context, tuned.seed, length=0.5, start=start).policy
    assert same(alone, disturbed[1])
    assert not same(calm.trainer.train(context, tuned.seed, length=0.5).policy, alone)
