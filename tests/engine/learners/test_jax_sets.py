"""Trainings on several contexts in jax, and many at once."""

from dataclasses import replace

import numpy as np
import pytest
from poles import apart, assert_same, same, same_policy

import mbtl.engine.learners as engine
from mbtl.engine.learners import recipes
from mbtl.errors import InvalidInput
from mbtl.problems import get_cmdp

SMALL = {"n_envs": 4, "n_steps": 64, "batch_size": 64}
UNIT = 256
TRAINER = get_cmdp("cartpole-length", engine="jax").trainer_for(
    "quick", timesteps=2_560, hyperparameters=SMALL, eval_episodes=2
)
CONTEXTS = [{"length": length} for length in (0.2, 0.5, 1.0, 1.5)]


@pytest.fixture(autouse=True)
def recipe_of_sets(monkeypatch):
    """CartPole's own one has a hundred copies."""
    small = replace(recipes.MULTI_TASK["CartPole"], **SMALL)
    monkeypatch.setattr(recipes, "MULTI_TASK", {"CartPole": small})


def to(updates, saved=None, **more):
    return TRAINER.train(CONTEXTS, 3, length=updates * UNIT / TRAINER.whole, state=saved, **more)


def test_a_training_on_a_set_is_extended_and_is_whole_of_one_unit(tmp_path):
    file = tmp_path / "training.npz"
    first, second = to(2, file), to(4, file)
    assert (first.steps, second.steps) == (2 * UNIT, 4 * UNIT)
    assert not same_policy(first.policy, second.policy)
    small = replace(TRAINER, timesteps=2 * UNIT)
    assert same_policy(small.train(CONTEXTS, 3).policy, small.train(CONTEXTS, 3, length=1.0).policy)


def test_many_are_trained_at_once_as_each_of_them_alone():
    """Up to the rounding of another program."""
    unit, seeds = UNIT / TRAINER.whole, [3, 4]
    sets = [CONTEXTS, CONTEXTS[::-1]]
    (first, policies, _), (second, _, trunk) = TRAINER.grow_many(sets, seeds, [2 * unit, 4 * unit])
    assert (first, second) == (2 * unit, 4 * unit)
    for own, seed, policy in zip(sets, seeds, policies, strict=True):
        alone = TRAINER.train(own, seed, length=2 * unit).policy
        for a, b in zip(policy.weights, alone.weights, strict=True):
            np.testing.assert_allclose(a, b, atol=1e-3)
    assert int(trunk.updates) == 4  # a branch of a fifth of two updates is none
    growing = TRAINER._growing([[CONTEXTS[0]], [CONTEXTS[3]]], [5, 6])
    begun = engine.taking_over(growing.start(), trunk, [1, 0]).state  # of copies
    for mine, theirs in zip(begun.weights.actor, trunk.state.weights.actor, strict=True):
        np.testing.assert_array_equal(mine[0], np.asarray(theirs[0])[[1, 0]])
    assert float(np.abs(np.asarray(begun.optimizer[1].nu)).sum()) > 0


@pytest.mark.parametrize(("own", "width"), [(True, 64), (False, 128)], ids=["its own", "wide"])
def test_a_copy_inherits_what_its_parent_had_learnt_beside_the_policy(
    own, width, tmp_path, monkeypatch
):
    """Its state is a file; the copy is the one of `grow_many`, up to rounding.

    Layers are twice as wide on several contexts, where CartPole had no recipe of its own.
    """
    if not own:
        monkeypatch.setattr(recipes, "MULTI_TASK", {})
    unit, file = UNIT / TRAINER.whole, tmp_path / "parent.npz"
    parent = TRAINER.train(CONTEXTS, 3, length=5 * unit, state=file).policy
    assert [len(bias) for bias in parent.biases] == [width, width, 2]
    (*_, (_, _, trunk)) = TRAINER.grow_many([CONTEXTS], [3], [5 * unit])
    some = {"parents": trunk, "which": [0]}
    ((_, (wanted,), _),) = TRAINER.grow_many([CONTEXTS[:1]], [5], [unit], **some)
    given = {"start": parent, "length": unit}
    inherited = TRAINER.train(CONTEXTS[:1], 5, state=file, **given).policy
    without = TRAINER.train(CONTEXTS[:1], 5, **given).policy

    assert "inherit" in TRAINER.takes
    assert apart(inherited, wanted) < 1e-3 < apart(without, wanted)
    again = TRAINER.train(CONTEXTS[:1], 5, state=file, **given).policy  # the file is the copy's now
    assert same_policy(again, inherited)
    whole = TRAINER.train(CONTEXTS[:1], 5, start=parent).policy  # as the recipe of one context says
    assert [len(bias) for bias in whole.biases] == [width, width, 2]


def test_a_copy_goes_on_at_its_parents_rate_also_where_its_own_updates_are_shorter(
    tmp_path, monkeypatch
):
    longer = replace(recipes.MULTI_TASK["CartPole"], n_envs=8)
    monkeypatch.setattr(recipes, "MULTI_TASK", {"CartPole": longer})
    paces, along = [], engine.Growing.along
    monkeypatch.setattr(
        engine.Growing, "along", lambda self, *given: paces.append(self) or along(self, *given)
    )
    file, unit = tmp_path / "training.npz", UNIT / TRAINER.whole
    parent = TRAINER.train(CONTEXTS, 3, state=file, length=1.0)  # 4 updates of 512 steps, and one
    TRAINER.train(CONTEXTS[:1], 5, start=parent.policy, length=unit, state=file)
    (_, _, trunk), *_ = TRAINER.grow_many([CONTEXTS], [3], [1.0])
    of = {"parents": trunk, "which": [0], "parents_on": len(CONTEXTS)}
    list(TRAINER.grow_many([CONTEXTS[:1]], [5], [unit], **of))
    assert [(one.whole, one.before) for one in paces] == [(5, 0), (10, 8)] * 2


def test_a_policy_with_layers_of_other_widths_is_no_beginning():
    other = replace(TRAINER, hyperparameters={**SMALL, "hidden": (48, 48)})
    policy = other.untrained(CONTEXTS[0])
    for length in (None, UNIT / TRAINER.whole):
        with pytest.raises(InvalidInput, match="must have the shapes of this recipe"):
            TRAINER.train(CONTEXTS[:1], 5, start=policy, length=length)


@pytest.mark.parametrize(
    ("algorithm", "own"),
    [
        ("A2C", {"n_envs": 1, "n_steps": 128}),
        ("DQN", {"n_envs": 1, "train_freq": 128, "buffer_size": 1024, "learning_starts": 0}),
    ],
)
def test_other_algorithms_learn_on_sets_too_go_on_and_are_copied(algorithm, own, tmp_path):
    """With a copy of the world per context, so an update for four is twice as long as for one."""
    other = replace(TRAINER, algorithm=algorithm, recipe_name="fast", hyperparameters=own)
    other = replace(other, checkpoint="final")
    assert "sets" in other.takes
    file, unit = tmp_path / "training.npz", 2 * other.update_length / other.whole
    first, longer = (other.train(CONTEXTS, 3, length=k * unit, state=file) for k in (2, 4))
    assert (first.steps, longer.steps) == (4 * other.update_length, 8 * other.update_length)
    assert not same_policy(first.policy, longer.policy)
    assert [len(bias) for bias in first.policy.biases] == [128, 128, 2]
    (_, (wanted,), _), (_, _, trunk) = other.grow_many([CONTEXTS], [3], [2 * unit, 4 * unit])
    assert apart(first.policy, wanted) < 1e-3
    of = {"parents": trunk, "which": [0], "parents_on": len(CONTEXTS)}
    ((_, (wanted,), _),) = other.grow_many([CONTEXTS[:1]], [5], [unit], **of)
    copy = other.train(CONTEXTS[:1], 5, start=longer.policy, length=unit, state=file).policy
    assert 10.0 * apart(copy, wanted) < apart(copy, longer.policy)


def test_copies_begin_from_the_best_of_evaluations_where_those_were_kept(tmp_path):
    own = {"n_envs": 4, "buffer_size": 1024, "learning_starts": 0, "learning_rate": 1e-2}
    other = replace(TRAINER, algorithm="DQN", recipe_name="fast", hyperparameters=own)
    file, unit = tmp_path / "training.npz", other.update_length / other.whole
    parent = other.train(CONTEXTS, 3, length=5 * unit, state=file).policy
    ((_, _, trunk),) = other.grow_many([CONTEXTS], [3], [5 * unit])
    best, latest = trunk.best.actor, trunk.state.weights.actor
    growing = other._growing([CONTEXTS[:1]], [5])
    growing = growing._replace(recipe=engine.as_wide_as(growing.recipe, trunk.best))
    begun = engine.taking_over(growing.start(), trunk, [0]).state
    assert_same((begun.weights.actor, begun.target), (best, best))
    assert not same(best, latest)
    saved = engine.SavedTraining(file).inherited(growing.start(), best=True)[0].state
    assert_same(saved.weights.actor, best)
    given = {"start": parent, "length": unit}
    copy = other.train(CONTEXTS[:1], 5, state=file, **given).policy
    ((_, (wanted,), _),) = other.grow_many(
        [CONTEXTS[:1]], [5], [unit], parents=trunk, which=[0], parents_on=len(CONTEXTS)
    )
    assert apart(copy, wanted) < 1e-3


def test_a_training_whose_state_is_lost_goes_on_with_an_empty_ring_at_its_rate(monkeypatch):
    own = {"n_envs": 4, "buffer_size": 1024, "learning_starts": 0}
    other = replace(TRAINER, algorithm="DQN", recipe_name="fast", hyperparameters=own)
    unit, begun, along = other.update_length / other.whole, [], engine.Growing.along

    def noting(self, trunk, until, on_block=None):
        begun.append((self.before, int(trunk.updates), until))
        return along(self, trunk, until, on_block)

    monkeypatch.setattr(engine.Growing, "along", noting)
    policy = other.train(CONTEXTS, 3, length=5 * unit).policy
    other.train(CONTEXTS, 3, start=policy, done=5 * unit, length=10 * unit)
    # four updates on the trunk and one on a branch, as often as it went on
    assert begun == [(0, 0, 4), (4, 0, 4)]
    begun.clear()
    TRAINER.train(CONTEXTS, 3, start=to(5).policy, done=5 * UNIT / TRAINER.whole, length=1.0)
    assert begun == [(0, 0, 4), (0, 4, 8)]  # else the contexts would begin anew


def test_a_copy_begins_from_the_policy_that_its_parent_was(tmp_path):
    for checkpoint in ("best", "final"):
        parent = replace(TRAINER, checkpoint=checkpoint, checkpoint_every=UNIT)
        file = tmp_path / f"{checkpoint}.npz"
        policy = parent.train(CONTEXTS[:1], 3, state=file).policy
        growing = parent._growing([CONTEXTS[1:2]], [5])
        begun, _ = engine.SavedTraining(file).inherited(
            growing.start(), best=parent.checkpoint == "best"
        )
        assert same_policy(growing.policies(begun.state.weights)[0], policy)


def test_dqn_has_a_copy_per_context_whose_steps_fill_the_ring_and_a2c_sixteen():
    one = engine.DQNRecipe(n_envs=8, train_freq=4, gradient_steps=2, buffer_size=1280)
    found = [engine.of_several(one, None, n) for n in (3, 8, 20, 100)]
    assert [(x.n_envs, x.gradient_steps) for x in found] == [(8, 2), (8, 2), (32, 8), (128, 32)]
    assert [x.buffer_size for x in found] == [1280, 1280, 1280, 1536]
    assert {x.hidden for x in found} == {(128, 128)}
    fewer, more = engine.A2CRecipe(n_envs=1), engine.A2CRecipe(n_envs=32)
    assert [engine.of_several(fewer, None, n).n_envs for n in (4, 100)] == [4, 16]
    assert engine.of_several(more, None, 100).n_envs == 32


def test_the_best_of_its_evaluations_is_the_policy_and_they_do_not_disturb_it():
    plain, seen = TRAINER._growing([CONTEXTS], [3]), []
    judged = plain._replace(judged=1)

    def on_block(block):
        (policy,) = judged.policies(block.training.state.weights)
        seen.append((float(block.training.latest_return[0]), policy))

    trunk = judged.along(judged.start(), 3, on_block)
    (found,) = judged.policies(judged.end(trunk, 2, on_block))
    assert len(seen) == 5
    assert same_policy(found, max(seen, key=lambda one: one[0])[1])  # the earliest of equals
    alone = plain.along(plain.start(), 3)
    assert same_policy(*(plain.policies(one.state.weights)[0] for one in (alone, trunk)))


def test_only_recipes_by_episodes_and_dqn_that_keep_the_best_judge_what_may_go_on():
    ring = get_cmdp("ring-acc", engine="jax").trainer_for("paper")
    for sets, episodes in (([{"hold": 5.0}, {"hold": 10.0}], 2), ([{"hold": 5.0}], 10)):
        growing = ring._growing([sets], [0])
        assert growing.judged == -(-growing.whole // 20)
        assert growing.episodes == episodes
        assert replace(ring, checkpoint="final")._growing([sets], [0]).judged == 0
    assert TRAINER._growing([CONTEXTS], [0]).judged == 0
    assert replace(TRAINER, algorithm="DQN", hyperparameters={})._growing([CONTEXTS], [0]).judged
