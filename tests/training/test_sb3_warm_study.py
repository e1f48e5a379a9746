"""Studies with warm starts in Stable-Baselines3: what is interrupted ends as what is not."""

import numpy as np
import pytest
from training_envs import cartpole
from warm_strategy import Warm

import mbtl
from mbtl.actions import Policy
from mbtl.seeds import training_seed
from mbtl.study.steps.callbacks import StepCallback
from mbtl.training import SB3Trainer

SPACE = mbtl.ContextSpace.grid({mbtl.Linear("length", 0.3, 1.0): 5})
PPO = {"n_steps": 64, "batch_size": 32, "n_epochs": 2, "learning_rate": lambda left: 1e-3 * left}


WARM = Warm()


def opened(folder=None, strategy=WARM):
    trainer = SB3Trainer(cartpole, timesteps=512, hyperparameters=PPO, eval_episodes=1)
    return mbtl.create_study(
        SPACE, cost="steps", budget=2_600, trainer=trainer, lengths=(128, 256, 512), episodes=1,
        horizon=200, bounds=(0.0, 200.0), strategy=strategy, seed=4,
        load_if_exists=True, storage=None if folder is None else folder / "study.db",
    )  # fmt: skip


class Interrupt(KeyboardInterrupt):
    pass


class Stops(StepCallback):
    """After the first mark of a warm-started training."""

    def on_trained(self, study, training):
        if training == 1 and len(study.state.trainings[1].marks) == 1:
            raise Interrupt


def model_of(study, training, mark):
    place = study.state.trainings[training].marks[mark].place
    if place is None:
        return study.policies[training, mark]
    return study.trainer.load(study.artifacts.read(place))


def same(one, other):
    pairs = zip(one.policy.parameters(), other.policy.parameters(), strict=True)
    return all(bool((a == b).all()) for a, b in pairs)


def test_interrupted_a_warm_started_training_is_bit_for_bit_the_undisturbed_one(tmp_path):
    calm = opened()
    calm.run(progress=False, report=False)
    with pytest.raises(Interrupt):
        opened(tmp_path).run(progress=False, report=False, callbacks=[Stops()])
    study = opened(tmp_path)
    assert list(study.state.trainings[1].marks) == [0]
    study.run(progress=False, report=False)
    starts = [t.start for t in study.state.trainings]
    assert starts[:2] == [None, Policy(0, 2)]
    assert len(starts) == len(calm.state.trainings) > 2
    for policy in calm.state.policies:
        one, other = (model_of(s, policy.training, policy.length) for s in (calm, study))
        assert same(one, other)
    np.testing.assert_array_equal(calm.state.returns, study.state.returns)
    second = calm.state.trainings[1]
    seed = training_seed(4, 0, second.source, 0)
    context = SPACE.context(second.source)
    parent = model_of(calm, 0, 2)
    alone = calm.trainer.train([context], seed, length=0.5, start=parent).policy
    assert same(alone, model_of(calm, 1, 1))
    assert not same(calm.trainer.train([context], seed, length=0.5).policy, alone)
