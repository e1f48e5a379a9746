"""Trainings that pause and go on are those of the whole length; every step is counted."""

import numpy as np
import pytest
from poles import apart, same_policy

import mbtl.engine.learners as engine
from mbtl.engine import WorldTrainer
from mbtl.problems import get_cmdp
from mbtl.seeds import evaluation_seeds
from mbtl.trainers import SB3Trainer
from mbtl.trainers.contract import CountingTrainer, refusal

SMALL = {"n_envs": 2, "n_steps": 64, "batch_size": 64}
CARTPOLE = get_cmdp("cartpole-length", engine="jax").trainer_for(
    "quick", timesteps=2_000, hyperparameters=SMALL, eval_episodes=3, checkpoint_episodes=2,
    checkpoint_every=200,
)  # fmt: skip
PENDULUM = get_cmdp("pendulum-length", engine="jax").trainer_for(
    "quick", timesteps=2_000, hyperparameters={**SMALL, "anneal": True}, eval_episodes=2
)
POLE = {"length": 0.5}


def test_a_training_is_extended_exactly_and_pays_only_for_what_is_new(tmp_path):
    trainer = CARTPOLE
    assert isinstance(trainer, CountingTrainer)
    assert trainer.takes >= {"start", "length", "state", "resume"}
    file, unit = tmp_path / "training.npz", trainer.update_length
    lengths = (10 * unit / trainer.whole, 15 * unit / trainer.whole)
    first, second = (trainer.train([POLE], 3, length=each, state=file) for each in lengths)
    assert (first.steps, second.steps) == (10 * unit, 15 * unit)
    assert not same_policy(first.policy, second.policy)
    growing = trainer._growing([[POLE]], [3])
    trunk = growing.along(growing.start(), 8)  # eight updates, and a branch of two
    assert same_policy(first.policy, exported(growing, growing.end(trunk, 2)))
    trunk = growing.along(trunk, 12)  # four more, and a branch of one
    assert same_policy(second.policy, exported(growing, growing.end(trunk, 1)))


def exported(growing, weights):
    return growing.policies(weights)[0]


def test_the_rate_falls_slowly_on_the_trunk_and_to_zero_on_a_branch():
    from mbtl.engine.learners.clock import Pace, clock_at

    trunk = Pace.endless(100, slowing=10.0)
    rates = [float(clock_at(n, trunk).rate) for n in (0, 30, 80, 990)]
    assert rates == pytest.approx([1.0, 0.5, 1 / 3, 0.1])
    branch = trunk.branch(80, 84)
    rates = [3 * float(clock_at(n, branch).rate) for n in (80, 81, 83, 84)]
    assert rates == pytest.approx([1.0, 0.75, 0.25, 0.0])
    falling = [float(clock_at(n, Pace.falling(4)).rate) for n in range(4)]
    assert falling == pytest.approx([1.0, 0.75, 0.5, 0.25])


@pytest.mark.parametrize("when", [2, 700, 1_450], ids=["at once", "trunk", "branch"])
def test_a_training_goes_on_from_its_file_after_a_kill(when, tmp_path, monkeypatch):
    monkeypatch.setattr("mbtl.engine.learners.saving._SECONDS", 0.0)
    file, length = tmp_path / "training.npz", 1_500 / CARTPOLE.whole
    begun = CARTPOLE.train([POLE], 1, length=0.25, state=tmp_path / "other.npz")
    whole = CARTPOLE.train([POLE], 1, length=length, state=tmp_path / "other.npz")

    class Killed(Exception):
        pass

    def kill(progress):
        if progress.step >= begun.steps + (when if when < 1_000 else when - begun.steps):
            raise Killed

    CARTPOLE.train([POLE], 1, length=0.25, state=file)
    with pytest.raises(Killed):
        CARTPOLE.train([POLE], 1, length=length, state=file, on_progress=kill)
    assert same_policy(CARTPOLE.train([POLE], 1, length=length, state=file).policy, whole.policy)


def test_a_training_begins_from_another_policy():
    policy = CARTPOLE.train([POLE], 0, length=1_000 / CARTPOLE.whole).policy
    warm = CARTPOLE.train([{"length": 1.0}], 1, length=128 / CARTPOLE.whole, start=policy).policy
    cold = CARTPOLE.train([{"length": 1.0}], 1, length=128 / CARTPOLE.whole).policy
    assert 0 < apart(warm, policy) < 0.1 < apart(cold, policy)


def test_without_its_state_a_training_goes_on_from_its_latest_policy():
    told = []
    half = CARTPOLE.train([POLE], 3, length=0.5)
    rest = CARTPOLE.train(
        [POLE], 3, start=half.policy, done=0.5, length=1.0, on_progress=told.append
    )
    assert told[0].step > half.steps
    assert rest.steps == CARTPOLE.whole
    assert 0 < apart(rest.policy, half.policy) < apart(rest.policy, CARTPOLE.untrained(POLE))
    same_again = CARTPOLE.train([POLE], 3, start=half.policy, done=0.5, length=0.5)
    assert apart(same_again.policy, half.policy) == 0.0


@pytest.mark.parametrize("trainer", [CARTPOLE, PENDULUM], ids=["cartpole", "pendulum"])
def test_episodes_are_counted_as_gymnasium_plays_them(trainer):
    policy = trainer.untrained(POLE)
    contexts = [{"length": 0.3}, {"length": 0.9}]
    seeds = evaluation_seeds(0, 0, range(2))
    returns, steps = trainer.evaluate_steps(policy, contexts, seeds)
    peer = SB3Trainer(trainer.problem.make_env, timesteps=1, eval_episodes=trainer.eval_episodes)
    expected, counted = peer.evaluate_steps(policy, contexts, seeds)
    np.testing.assert_allclose(returns, expected, rtol=1e-3)
    assert np.array_equal(steps, counted)


BY_EPISODES = {
    "cartpole": (CARTPOLE.problem, [POLE, {"length": 1.0}], [500, 500]),
    "ring": (get_cmdp("ring-acc", engine="jax", visibility="multiplier").trainer.problem,
             [{"hold": 20.0}, {"hold": 40.0}], [20, 10]),  # of 400 s
}  # fmt: skip
"""World, contexts, and decisions of an episode in each."""


@pytest.mark.parametrize("name", ["cartpole", pytest.param("ring", marks=pytest.mark.long)])
def test_a_training_of_episodes_is_extended_and_counts_decisions(name, tmp_path):
    problem, contexts, decisions = BY_EPISODES[name]
    small = {"rows": 16, "minibatches": 4, "n_episodes": 2, "hidden": (8,)}
    trainer = WorldTrainer(
        problem, episodes=12, algorithm="PPO", recipe_name="fast", hyperparameters=small
    )
    assert (trainer.whole, trainer.counts) == (12, "episodes")
    file, told = tmp_path / "training.npz", []
    first, second = (
        trainer.train(contexts, 3, length=n / 12, state=file, on_progress=told.append)
        for n in (4, 12)
    )
    met = [engine.episodes_met(3, n // 2, 2, 2) for n in (4, 12)]
    assert [first.steps, second.steps] == [one @ decisions for one in met]
    world, _ = problem(contexts)
    assert first.policy.weights[0].shape[1] == world.n_features + 1  # it is told the context
    assert (told[-1].unit, told[-1].step, told[-1].total) == ("steps", *[second.steps] * 2)


def test_a_world_that_lives_in_one_process_hands_out_no_state():
    from mbtl.engine import SceneProblem

    trainer = WorldTrainer(SceneProblem(lambda context: None), episodes=4)
    assert trainer.takes == {"sets", "start", "length"}
    assert "live in one process; choose another --engine" in refusal(trainer, "state")
    assert refusal(CARTPOLE, "state") is None
