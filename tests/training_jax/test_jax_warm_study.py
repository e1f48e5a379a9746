"""Studies with warm starts in the jax engine: what is interrupted ends as what is not."""

import numpy as np
import pytest
from warm_strategy import Warm

pytest.importorskip("jax", reason="the jax extra is not installed")
pytest.importorskip("gymnasium", reason="the envs extra is not installed")

import mbtl
from mbtl.actions import Policy
from mbtl.cmdps import get_cmdp
from mbtl.seeds import training_seed
from mbtl.study.steps.callbacks import StepCallback

SMALL = {"n_envs": 2, "n_steps": 64, "batch_size": 64}
PROBLEM = get_cmdp("pendulum-length", engine="jax", visibility="hidden")
LENGTHS = (256, 512, 1_024)


class Interrupt(KeyboardInterrupt):
    pass


class Stops(StepCallback):
    """After the first mark of a warm-started training, and before another one begins."""

    def __init__(self):
        self.left = 2

    def on_training(self, study, training, source, to):
        if training == 2 and self.left == 1:
            self.left = 0
            raise Interrupt

    def on_trained(self, study, training):
        if training == 1 and self.left == 2:
            self.left = 1
            raise Interrupt


WARM = Warm()


def opened(folder=None, strategy=WARM):
    trainer = PROBLEM.trainer_for("quick", timesteps=1_024, hyperparameters=SMALL)
    return mbtl.create_study(
        PROBLEM, cost="steps", budget=16_000, trainer=trainer, lengths=LENGTHS, episodes=1,
        strategy=strategy, seed=4, load_if_exists=True,
        storage=None if folder is None else folder / "study.db",
    )  # fmt: skip


def weights(study, policy):
    trainer = study.trainer
    place = study.state.trainings[policy.training].marks[policy.length].place
    if place is None:
        return study.policies[policy.training, policy.length].weights
    return trainer.load(study.artifacts.read(place)).weights


def same(ones, others):
    return all(np.array_equal(a, b) for a, b in zip(ones, others, strict=True))


def test_interrupted_a_warm_started_training_is_bit_for_bit_the_undisturbed_one(tmp_path):
    calm = opened()
    calm.run(progress=False, report=False)
    stops, interrupts = Stops(), 0
    while True:
        study = opened(tmp_path)
        try:
            study.run(progress=False, report=False, callbacks=[stops])
            break
        except Interrupt:
            interrupts += 1
    assert interrupts == 2
    starts = [t.start for t in study.state.trainings]
    assert starts[:2] == [None, Policy(0, 2)]
    assert starts == [t.start for t in calm.state.trainings]
    for policy in calm.state.policies:
        assert same(weights(calm, policy), weights(study, policy))
    np.testing.assert_array_equal(calm.state.returns, study.state.returns)
    assert calm.state.spent == study.state.spent


def test_it_is_what_the_trainer_makes_of_that_start():
    study = opened()
    study.run(progress=False, report=False)
    second = study.state.trainings[1]
    parent = study.policies[0, 2]
    context = study.space.context(second.source)
    seed = training_seed(4, 0, second.source, 0)
    expected = study.trainer.train([context], seed, length=0.5, start=parent).policy
    scratch = study.trainer.train([context], seed, length=0.5).policy
    assert same(study.policies[1, 1].weights, expected.weights)
    assert not same(scratch.weights, expected.weights)
