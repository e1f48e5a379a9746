"""One policy for all contexts of a twin: shorter episodes within a program, and whole trainings."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("jax", reason="the jax extra is not installed")
pytest.importorskip("gymnasium", reason="the envs extra is not installed")

import mbtl.training.jax as engine  # isort: skip  # before jax: it sets jax's flags
import jax
import jax.numpy as jnp

from mbtl.cmdps import get_cmdp
from mbtl.errors import InvalidInput
from mbtl.training.jax import saving
from mbtl.training.jax.episodic import multitask, trpo
from mbtl.training.jax.episodic.episodes import actor_of, record
from mbtl.training.jax.episodic.recipes import TRPORecipe
from mbtl.training.multitask import train_on_all

HOLDS = [{"hold": 20.0}, {"hold": 28.0}, {"hold": 40.0}]
RECIPE = TRPORecipe(n_episodes=2, hidden=(8,), normalize_reward=False)


def ring(contexts=HOLDS):
    trainer = get_cmdp("ring-vel", engine="jax", visibility="multiplier").trainer_for("quick")
    world, params = trainer.problem(contexts)
    return world, [engine.context_of(params, i) for i in range(len(contexts))]


def test_an_episode_within_a_longer_program_is_the_same_and_teaches_the_same():
    twin, (_, _, params) = ring()
    state = engine.start(twin, RECIPE, [5], params).state
    actor, seeds = actor_of(state.weights), np.array([[1, 2]], np.uint32)
    played = jax.jit(record, static_argnums=(0, 1, 2))
    own = played(twin, "tanh", 10, actor, seeds, params)
    within = played(twin, "tanh", 13, actor, seeds, params, jnp.int32(10))
    assert not within.acting[:, :3].any()
    assert within.acting[:, 3:].all()
    np.testing.assert_allclose(within.obs[0][within.row[0, 3:]], own.obs[0][own.row[0]], atol=1e-5)
    for name in ("outputs", "action", "value", "reward"):
        np.testing.assert_allclose(getattr(within, name)[:, 3:], getattr(own, name), atol=1e-5)
    np.testing.assert_allclose(within.score, own.score, atol=1e-5)
    learn = jax.jit(trpo.learn, static_argnums=(0, 1))
    taught = [
        learn(twin.action, RECIPE, *jax.tree.map(lambda x: x[0], (*state[:2], lived)), 0)[0]
        for lived in (own, within)
    ]
    before = jax.tree.leaves(jax.tree.map(lambda x: x[0], state.weights))
    for old, a, b in zip(before, *map(jax.tree.leaves, taught), strict=True):
        np.testing.assert_allclose(a, b, atol=2e-4)
        assert old.size == 0 or not np.array_equal(old, a)


def test_contexts_are_drawn_for_every_episode_and_a_training_goes_on_where_it_was(monkeypatch):
    twin, params = ring()
    met, lived = [], multitask._lived

    def watched(*arguments):
        met.append(int(arguments[-1]))
        return lived(*arguments)

    monkeypatch.setattr(multitask, "_lived", watched)
    saved = []

    def keep(block):
        saved.append(engine.to_arrays(block.training))

    options = {"checkpoints": 2, "checkpoint_episodes": 1}
    whole = multitask.train_on_all(twin, RECIPE, 7, params, 40, on_block=keep, **options)
    assert set(met) == {20, 15, 10}  # decisions of the three holds
    assert all(a != b for a, b in zip(met[::2], met[1::2], strict=True))  # two in each update
    template = engine.start(twin, RECIPE, [7], params[0])
    halfway = engine.from_arrays(template, saved[0])
    rest = multitask.train_on_all(twin, RECIPE, 7, params, 40, resume=halfway, **options)
    assert met[40:] == met[20:40]
    for a, b in zip(jax.tree.leaves(whole), jax.tree.leaves(rest), strict=True):
        np.testing.assert_array_equal(a, b)


def test_the_policy_is_told_the_context_and_a_file_cut_off_only_costs_time(tmp_path):
    cmdp = get_cmdp("ring-vel", engine="jax", visibility="multiplier")
    trainer = cmdp.trainer_for("quick", episodes=4, eval_episodes=2)
    heard, file = [], tmp_path / "training.npz"
    file.write_bytes(b"of another run, cut off")
    policy = train_on_all(trainer, HOLDS, 3, heard.append, partial=file)
    assert policy.weights[0].shape[1] == 3 + 1
    assert heard[-1].step == heard[-1].total == 4
    assert trainer.evaluate(policy, HOLDS, seed=1).shape == (3, 2)
    with pytest.raises(InvalidInput, match="at least one context"):
        train_on_all(trainer, [], 3)


@pytest.mark.long
def test_an_interrupted_trainer_goes_on_to_the_same_policy(tmp_path, monkeypatch):
    monkeypatch.setattr(saving, "_SECONDS", 0.0)
    cmdp = get_cmdp("ring-vel", engine="jax", visibility="multiplier")
    trainer = cmdp.trainer_for("quick", episodes=4)
    heard, file = [], tmp_path / "training.npz"

    def stop(progress):
        heard.append(progress.step)
        if len(heard) == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train_on_all(trainer, HOLDS[2:], 3, stop, partial=file)
    assert file.is_file()
    rest = train_on_all(trainer, HOLDS[2:], 3, stop, partial=file)
    assert heard == [1, 2, 3, 3, 4]  # it went on after the second, the last that was saved
    whole = train_on_all(trainer, HOLDS[2:], 3)
    for a, b in zip(whole.weights, rest.weights, strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.long
def test_one_policy_learns_to_calm_rings_of_several_holds():
    contexts = [{"hold": 1.0}, {"hold": 4.0}]
    trainer = get_cmdp("ring-vel", engine="jax", visibility="multiplier").trainer_for(
        "quick", episodes=360, hyperparameters={"n_episodes": 6}
    )
    policy = train_on_all(replace(trainer, eval_episodes=5), contexts, 0)
    assert trainer.evaluate(policy, contexts, seed=2).mean() > 3.5  # unguided: 3.15
