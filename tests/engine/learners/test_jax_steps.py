"""Trainings that pause and go on are those of the whole length; every step is counted."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

pytest.importorskip("jax", reason="the jax extra is not installed")
pytest.importorskip("gymnasium", reason="the envs extra is not installed")

import mbtl.engine.learners as engine
from mbtl.engine import WorldTrainer
from mbtl.errors import InvalidInput
from mbtl.problems import get_cmdp
from mbtl.seeds import evaluation_seeds
from mbtl.trainers import SB3Trainer
from mbtl.trainers.contract import CountingTrainer, refusal
from mbtl.zoo.worlds import CartPole

SMALL = {"n_envs": 2, "n_steps": 64, "batch_size": 64}
CARTPOLE = get_cmdp("cartpole-length", engine="jax").trainer_for(
    "quick", timesteps=2_000, hyperparameters=SMALL, eval_episodes=3, checkpoint_episodes=2,
    checkpoint_every=200,
)  # fmt: skip
PENDULUM = get_cmdp("pendulum-length", engine="jax").trainer_for(
    "quick", timesteps=2_000, hyperparameters={**SMALL, "anneal": True}, eval_episodes=2
)
POLE = {"length": 0.5}


def same(one, other):
    return all(np.array_equal(a, b) for a, b in zip(one.weights, other.weights, strict=True))


def apart(one, other):
    return max(abs(a - b).max() for a, b in zip(one.weights, other.weights, strict=True))


OFF_POLICY = {"n_envs": 2, "buffer_size": 512, "batch_size": 16, "learning_starts": 64}


@pytest.mark.parametrize(
    "trainer",
    [replace(CARTPOLE, algorithm="DQN", hyperparameters=OFF_POLICY), PENDULUM],
    ids=["checked-DQN", "unchecked-PPO"],
)
def test_a_training_extended_twice_is_the_whole_one(trainer, tmp_path):
    assert isinstance(trainer, CountingTrainer)
    whole = replace(trainer, checkpoint="final").train([POLE], seed=3).policy
    file = tmp_path / "training.npz"
    first = trainer.train([POLE], 3, length=300 / trainer.whole, state=file)
    second = trainer.train([POLE], 3, length=1_000 / trainer.whole, state=file)
    last = trainer.train([POLE], 3, length=1.0, state=file)
    assert first.steps < second.steps < last.steps == trainer.whole
    assert not same(first.policy, second.policy)
    assert same(last.policy, whole)
    again = trainer.train([POLE], 3, length=1.0)
    assert (again.steps, again.checks) == (last.steps, last.checks)


def test_a_training_goes_on_from_any_of_its_files_after_a_kill(tmp_path, monkeypatch):
    monkeypatch.setattr("mbtl.engine.learners.saving._SECONDS", 0.0)
    undisturbed = CARTPOLE.train([POLE], 1, length=1_500 / CARTPOLE.whole)

    class Killed(Exception):
        pass

    def kill(progress):
        if progress.step >= 800:
            raise Killed

    file = tmp_path / "training.npz"
    with pytest.raises(Killed):
        CARTPOLE.train([POLE], 1, length=1_500 / CARTPOLE.whole, state=file, on_progress=kill)
    resumed = CARTPOLE.train([POLE], 1, length=1_500 / CARTPOLE.whole, state=file)
    assert same(resumed.policy, undisturbed.policy)
    assert resumed.checks == undisturbed.checks > 0
    # killed after the last saving
    twice = CARTPOLE.train([POLE], 1, length=1_500 / CARTPOLE.whole, state=file)
    assert (twice.steps, twice.checks) == (resumed.steps, resumed.checks)


def test_what_is_charged_is_what_ran(monkeypatch):
    """Against a count of the updates and of the episodes that were really played."""
    ran = {"updates": 0, "checks": 0.0}
    from mbtl.engine.learners import loop

    updates, scores = loop._updates, loop.own_scores

    def updating(*given):
        ran["updates"] += int(given[5])
        return updates(*given)

    def scoring(*given):
        found = scores(*given)
        ran["checks"] += float(found.sum())
        return found

    monkeypatch.setattr(loop, "_updates", updating)
    monkeypatch.setattr(loop, "own_scores", scoring)
    reached = CARTPOLE.train([POLE], 2, length=1_000 / CARTPOLE.whole)
    assert reached.steps == ran["updates"] * CARTPOLE.update_length
    assert reached.checks == ran["checks"] > 0
    ran["checks"] = 0.0
    assert PENDULUM.train([POLE], 2, length=500 / PENDULUM.whole).checks == ran["checks"] == 0.0


def test_a_training_with_nothing_left_to_gain_ends():
    easy = replace(
        CARTPOLE, timesteps=60_000, hyperparameters={}, checkpoint_episodes=1, checkpoint_every=None
    )
    reached = easy.train([POLE], 0, length=1.0)
    assert reached.ended
    assert reached.steps < easy.whole
    assert reached.checks <= reached.steps / 20
    assert np.all(easy.evaluate(reached.policy, [POLE], [3]) > 100)


def test_a_training_begins_from_another_policy():
    policy = PENDULUM.train([POLE], 0, length=1_000 / PENDULUM.whole).policy
    warm = PENDULUM.train([{"length": 1.0}], 1, length=128 / PENDULUM.whole, start=policy).policy
    cold = PENDULUM.train([{"length": 1.0}], 1, length=128 / PENDULUM.whole).policy

    def moved(to):
        return max(abs(a - b).max() for a, b in zip(policy.weights, to.weights, strict=True))

    assert 0 < moved(warm) < 0.1 < moved(cold)
    wide = replace(PENDULUM, hyperparameters={**PENDULUM.hyperparameters, "hidden": (32, 32)})
    with pytest.raises(InvalidInput, match="weights to begin from must have the shapes"):
        wide.train([POLE], 0, length=128 / wide.whole, start=policy)


def test_without_its_state_a_training_goes_on_from_its_latest_policy():
    told = []
    half = PENDULUM.train([POLE], 3, length=0.5)
    rest = PENDULUM.train(
        [POLE], 3, start=half.policy, done=0.5, length=1.0, on_progress=told.append
    )
    assert told[0].step > half.steps
    assert rest.steps == PENDULUM.whole
    exact = PENDULUM.train([POLE], 3, length=1.0).policy
    assert 0 < apart(rest.policy, exact) < 0.2 < apart(rest.policy, PENDULUM.untrained(POLE))
    same_again = PENDULUM.train([POLE], 3, start=half.policy, done=0.5, length=0.5)
    assert apart(same_again.policy, half.policy) == 0.0


@pytest.mark.parametrize("trainer", [CARTPOLE, PENDULUM], ids=["cartpole", "pendulum"])
def test_episodes_are_counted_as_gymnasium_plays_them(trainer):
    policy = trainer.train([POLE], 0, length=500 / trainer.whole).policy
    contexts = [{"length": 0.3}, {"length": 0.9}]
    seeds = evaluation_seeds(0, 0, range(2))
    returns, steps = trainer.evaluate_steps(policy, contexts, seeds)
    peer = SB3Trainer(trainer.problem.make_env, timesteps=1, eval_episodes=trainer.eval_episodes)
    expected, counted = peer.evaluate_steps(policy, contexts, seeds)
    np.testing.assert_allclose(returns, expected, rtol=1e-3)
    assert np.array_equal(steps, counted)


def test_where_an_environment_does_not_say_its_episodes_are_counted_once_more():
    policy = CARTPOLE.train([POLE], 0, length=500 / CARTPOLE.whole).policy
    silent = WorldTrainer(_Silent(CARTPOLE.problem), timesteps=2_000, eval_episodes=3)
    returns, steps = silent.evaluate_steps(policy, [POLE], [5])
    assert np.array_equal(returns, 2 * steps)


@dataclass(frozen=True)
class _Double(CartPole):
    """Two points per step, and no word of how long episodes are."""

    lasts = None

    def step(self, state, action, params):
        moved = super().step(state, action, params)
        return moved._replace(reward=2 * moved.reward)


@dataclass(frozen=True)
class _Silent:
    problem: object

    def __call__(self, contexts):
        return engine.Solo(_Double()), self.problem(contexts)[1]


RING = get_cmdp("ring-acc", engine="jax").trainer_for(
    "quick", episodes=12, eval_episodes=2, hyperparameters={"hidden": (8,)}
)
HOLD = {"hold": 40.0}
"""Ten decisions in an episode of 400 s."""


def test_a_training_of_episodes_extended_twice_is_the_whole_one(tmp_path):
    own = {"hidden": (8,), "rows": 16, "minibatches": 4, "n_episodes": 2}
    trainer = replace(RING, algorithm="PPO", recipe_name="fast", hyperparameters=own)
    assert (trainer.whole, trainer.counts) == (12, "episodes")
    whole = replace(trainer, checkpoint="final").train([HOLD], seed=3).policy
    file, told = tmp_path / "training.npz", []
    reached = [
        trainer.train(
            [HOLD], 3, length=episodes / trainer.whole, state=file, on_progress=told.append
        )
        for episodes in (2, 5, 12)
    ]
    unit = trainer.update_length
    assert [r.steps for r in reached] == [10 * -(-n // unit) * unit for n in (2, 5, 12)]
    assert [r.checks for r in reached] == [0, 0, 0]
    assert not same(reached[0].policy, reached[1].policy)
    assert same(reached[-1].policy, whole)
    assert {(p.unit, p.total) for p in told} == {("steps", 120)}
    assert told[-1].step == 120
    warm = trainer.train([{"hold": 38.0}], 1, length=2 / trainer.whole, start=whole).policy
    cold = trainer.train([{"hold": 38.0}], 1, length=2 / trainer.whole).policy
    assert 0 < apart(warm, whole) < 0.2 < apart(cold, whole)
    returns, steps = trainer.evaluate_steps(whole, [HOLD, {"hold": 8.0}], [5, 6])
    assert np.array_equal(returns, trainer.evaluate(whole, [HOLD, {"hold": 8.0}], [5, 6]))
    assert steps.tolist() == [[10.0, 10.0], [50.0, 50.0]]


HOLDS = [{"hold": hold} for hold in (8.0, 20.0, 40.0)]
"""50, 20 and 10 decisions in an episode."""


def test_a_training_on_holds_extended_twice_is_the_whole_one_and_costs_what_was_played(tmp_path):
    marks, file, told = (4 / 12, 1.0), tmp_path / "training.npz", []
    whole = RING.train(HOLDS, 3, length=12 / RING.whole, marks=marks)
    reached = [
        RING.train(
            HOLDS, 3, length=episodes / RING.whole, marks=marks, state=file, on_progress=told.append
        )
        for episodes in (4, 7, 12)
    ]
    assert same(reached[-1].policy, whole.policy)
    assert not same(reached[1].policy, whole.policy)
    assert reached[0].steps < reached[1].steps < reached[2].steps == whole.steps
    world, params = RING.problem(HOLDS)
    lived = engine.train_multitask(world, RING.learner, [3], params, 12, judging=False)
    baseline = engine.export_policies(world, lived.state.weights, RING.learner.activation)[0]
    assert same(whole.policy, baseline)
    assert told[-1].step == told[-1].total == whole.steps


def test_the_episodes_of_a_training_on_holds_are_counted_hold_by_hold():
    met = engine.episodes_met(3, 5, 3, 4)
    assert met.sum() == 5 * 4
    assert met.min() >= 5  # of four episodes in three holds each has one at least
    four = replace(RING, hyperparameters={"hidden": (8,), "n_episodes": 4})
    assert four.train(HOLDS, 3, length=20 / four.whole).steps == met @ [50, 20, 10]


def test_a_world_that_lives_in_one_process_hands_out_no_state():
    from mbtl.engine import SceneProblem

    trainer = WorldTrainer(SceneProblem(lambda context: None), episodes=4)
    assert trainer.takes == {"sets", "start", "length"}
    assert "live in one process; choose another --engine" in refusal(trainer, "state")
    assert refusal(CARTPOLE, "state") is None
