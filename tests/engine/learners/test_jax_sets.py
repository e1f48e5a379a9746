"""Trainings on several contexts in jax pause and go on, and are then those of the whole length."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("jax", reason="the jax extra is not installed")
pytest.importorskip("gymnasium", reason="the envs extra is not installed")


import mbtl.engine.learners as engine
from mbtl.errors import InvalidInput
from mbtl.problems import get_cmdp

UNIT = 12_800
TRAINER = get_cmdp("cartpole-length", engine="jax").trainer_for("quick", eval_episodes=2)
CONTEXTS = [{"length": length} for length in (0.2, 0.5, 1.0, 1.5)]


def same(one, other):
    return all(np.array_equal(a, b) for a, b in zip(one.weights, other.weights, strict=True))


def to(steps, marks, saved=None, **more):
    marks = [mark / TRAINER.whole for mark in marks]
    return TRAINER.train(
        CONTEXTS, 3, length=steps / TRAINER.whole, marks=marks, state=saved, **more
    )


@pytest.mark.parametrize(
    "marks", [(4 * UNIT,), (UNIT, 2 * UNIT, 4 * UNIT)], ids=["one stage", "stages"]
)
def test_a_training_extended_twice_is_the_whole_one(marks, tmp_path):
    assert TRAINER.takes == {"sets", "start", "length", "state", "resume"}
    whole = to(4 * UNIT, marks)
    file = tmp_path / "training.npz"
    reached = [to(steps, marks, file) for steps in (UNIT, 2 * UNIT + 1, 4 * UNIT)]
    assert [r.steps for r in reached] == [UNIT, 3 * UNIT, 4 * UNIT]
    assert same(reached[-1].policy, whole.policy)
    assert not same(reached[1].policy, whole.policy)


def test_without_marks_each_length_asked_for_is_one(tmp_path):
    file, marks = tmp_path / "training.npz", (UNIT, 2 * UNIT, 4 * UNIT)
    reached = [to(length, (), file) for length in marks]
    assert [r.steps for r in reached] == list(marks)
    for r, length in zip(reached, marks, strict=True):
        assert same(r.policy, to(length, marks).policy)
    lost = {"start": reached[0].policy, "done": UNIT / TRAINER.whole}
    assert same(to(2 * UNIT, (), **lost).policy, to(2 * UNIT, marks, **lost).policy)


def test_of_one_stage_it_is_the_multi_task_baseline():
    world, params = TRAINER.problem(CONTEXTS)
    recipe = engine.multitask_recipe("ppo", "CartPole")
    training = engine.train_multitask(world, recipe, [3], params, 3 * UNIT)
    baseline = engine.export_policies(world, training.state.weights, recipe.activation)[0]
    assert same(to(3 * UNIT, (3 * UNIT,)).policy, baseline)


def test_the_learning_rate_falls_to_zero_at_each_mark():
    early, late = to(2 * UNIT, (2 * UNIT, 4 * UNIT)), to(2 * UNIT, (4 * UNIT,))
    alone = to(2 * UNIT, (2 * UNIT,))
    assert same(early.policy, alone.policy)
    assert not same(late.policy, alone.policy)


def test_it_goes_on_from_a_policy_where_its_state_is_lost(tmp_path):
    marks = (UNIT, 2 * UNIT, 4 * UNIT)
    first, file = to(2 * UNIT, marks), tmp_path / "training.npz"
    lost = {"start": first.policy, "done": 2 * UNIT / TRAINER.whole}
    third = to(3 * UNIT, marks, file, **lost)
    assert third.steps == 3 * UNIT
    assert same(to(4 * UNIT, marks, file).policy, to(4 * UNIT, marks, **lost).policy)


def test_marks_within_one_update_are_one():
    reached = to(UNIT, (UNIT // 4, UNIT // 2, UNIT))
    assert reached.steps == UNIT
    assert same(reached.policy, to(UNIT, (UNIT,)).policy)


def test_a_training_goes_on_from_its_file_after_a_kill(tmp_path, monkeypatch):
    monkeypatch.setattr("mbtl.engine.learners.saving._SECONDS", 0.0)
    marks = (2 * UNIT, 6 * UNIT)

    class Killed(Exception):
        pass

    told = []

    def kill(progress):
        told.append((progress.step, progress.total))
        if progress.step >= 4 * UNIT:
            raise Killed

    with pytest.raises(Killed):
        to(6 * UNIT, marks, tmp_path / "training.npz", on_progress=kill)
    assert told[-1] == (4 * UNIT, 6 * UNIT)
    resumed = to(6 * UNIT, marks, tmp_path / "training.npz")
    assert same(resumed.policy, to(6 * UNIT, marks).policy)


def test_what_cannot_be_trained_on_a_set_is_refused():
    other = replace(TRAINER, algorithm="DQN")
    assert "sets" not in other.takes
    with pytest.raises(InvalidInput, match="learn by PPO, got a recipe of DQN"):
        other.train(CONTEXTS, 3)
