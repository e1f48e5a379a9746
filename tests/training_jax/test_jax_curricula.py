"""A curriculum within a training: who is counted, who is next, and that nothing else changes."""

import json
from dataclasses import dataclass, replace

import numpy as np
import pytest

pytest.importorskip("jax", reason="the jax extra is not installed")
pytest.importorskip("gymnasium", reason="the envs extra is not installed")

import jax
import jax.numpy as jnp

import mbtl.training.jax as engine  # before jax: it sets jax's flags
from mbtl.cmdps import cartpole, get_cmdp
from mbtl.cmdps.taught import with_curriculum
from mbtl.curricula import Learnability, Outcomes, Regret
from mbtl.errors import InvalidInput, UnknownName
from mbtl.objective import Bounds
from mbtl.training.multitask_run import InJax
from mbtl.worlds import copies
from mbtl.worlds.taught import RECENT, Ended, Past, Taught, next_contexts, remembered, taught
from mbtl.worlds.world import Moved

PPO = engine.PPORecipe(n_envs=6, n_steps=64, batch_size=96, n_epochs=1, learning_rate=1e-3)
RECIPE = engine.MultiTaskRecipe("ppo", PPO)
WORLD = engine.Solo(engine.CartPole(horizon=40))
LENGTHS = (0.1, 0.5, 1.0, 5.0)
BOUNDS = Bounds(0.0, 40.0)


def params_of(lengths=LENGTHS):
    envs = [cartpole.CartPole({"length": length}) for length in lengths]
    return engine.stack_params(
        WORLD, [cartpole.derive(env.features) for env in envs], [env.visible for env in envs]
    )


def trained(world, updates=4, **options):
    steps = updates * PPO.update_length
    options = {"checkpoint_every": PPO.update_length, **options}
    return engine.train_multitask(world, RECIPE, [7, 8], params_of(), steps, **options)


def assert_same(one, other):
    for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        np.testing.assert_array_equal(a, b)


@dataclass(frozen=True)
class Fixed:
    """The same weights whatever happens."""

    given: tuple[float, ...]

    def weights(self, outcomes):
        """As given."""
        return jnp.array(self.given)


# ---- what is remembered --------------------------------------------------------------------------


def remembered_one_by_one(n_contexts, rollouts):
    """The same, an episode after the other."""
    scores, last, number = [[] for _ in range(n_contexts)], [0] * n_contexts, 0
    for done, context, score in rollouts:
        for t, e in np.ndindex(done.shape):
            if done[t, e]:
                number += 1
                scores[context[t, e]].insert(0, score[t, e])
                last[context[t, e]] = number
    return scores, last


@pytest.mark.parametrize("share", [0.02, 0.5, 1.0])
def test_the_latest_episodes_of_each_context_are_remembered(share):
    rng, n_contexts = np.random.default_rng(3), 5
    rollouts = [
        (
            rng.random((12, 7)) < share,
            rng.integers(0, n_contexts - 1, (12, 7)),  # the last one is never played
            rng.normal(size=(12, 7)).astype(np.float32),
        )
        for _ in range(4)
    ]
    past = Past.empty(n_contexts)
    for rollout in rollouts:
        past = jax.jit(remembered)(past, Ended(*map(jnp.asarray, rollout)))
    scores, last = remembered_one_by_one(n_contexts, rollouts)
    np.testing.assert_array_equal(past.played, [len(of_one) for of_one in scores])
    np.testing.assert_array_equal(past.last, last)
    for n, of_one in enumerate(scores):
        np.testing.assert_array_equal(past.recent[n, : len(of_one)], of_one[:RECENT])
        assert float(past.best[n]) == max(of_one, default=-np.inf)


def test_a_rule_is_told_means_bests_successes_and_ages():
    told = {}

    @dataclass(frozen=True)
    class Watching:
        def weights(self, outcomes):
            told["outcomes"] = outcomes
            return jnp.ones(2) / 2

    world = taught(WORLD, Watching(), Bounds(0.0, 80.0))
    ended = Ended(
        jnp.array([[True, True], [False, True], [True, False]]),
        jnp.array([[0, 0], [1, 1], [0, 0]]),
        jnp.array([[40.0, 20.0], [8.0, 16.0], [30.0, 4.0]]),
    )
    world.after(Past.empty(2), ended)
    outcomes = told["outcomes"]
    assert isinstance(outcomes, Outcomes)
    np.testing.assert_allclose(outcomes.performance, [30 / 80, 16 / 80])
    np.testing.assert_allclose(outcomes.best, [40 / 80, 16 / 80])
    np.testing.assert_allclose(outcomes.success, [1 / 3, 0.0])  # only 40 is a whole episode
    np.testing.assert_array_equal(outcomes.age, [0, 1])
    of_pendulum = taught(engine.Solo(engine.Pendulum()), Watching(), Bounds(-2200.0, -500.0))
    of_pendulum.after(Past.empty(2), ended)
    assert told["outcomes"].success is None
    smaller = taught(WORLD, Watching(), Bounds(0.0, 80.0, "minimize"))
    smaller.after(Past.empty(2), ended)
    np.testing.assert_allclose(told["outcomes"].performance, [50 / 80, 64 / 80])


def test_all_contexts_are_alike_until_each_was_played():
    world = taught(WORLD, Fixed((0.7, 0.1, 0.2)), BOUNDS)
    ended = Ended(jnp.array([[True, True]]), jnp.array([[0, 2]]), jnp.array([[1.0, 2.0]]))
    past = world.after(Past.empty(3), ended)
    np.testing.assert_allclose(past.weights, np.full(3, 1 / 3))
    past = world.after(past, ended._replace(context=jnp.array([[1, 2]])))
    np.testing.assert_allclose(past.weights, [0.7, 0.1, 0.2])


# ---- who is next ---------------------------------------------------------------------------------


def test_any_stretch_of_episodes_follows_the_weights():
    weights = jnp.array([0.5, 0.0, 0.3, 0.2])
    context, turn, found = jnp.zeros(5, jnp.int32), jnp.uint32(2**32 - 40), []
    done = jnp.array([True, False, True, True, True])
    for _ in range(50):
        context, turn = next_contexts(weights, context, turn, done)
        assert int(context[1]) == 0
        found += [int(n) for n in context[np.asarray(done)]]
    assert int(turn) == 160  # 2^32 is 0 again
    for first in range(0, 200, 50):
        counts = np.bincount(found[first : first + 50], minlength=4)
        np.testing.assert_allclose(counts, 50 * np.asarray(weights), atol=2.0)
        assert counts[1] == 0


def test_a_training_begins_its_episodes_where_the_weights_say():
    weights = (0.55, 0.05, 0.1, 0.3)
    world = taught(WORLD, Fixed(weights), BOUNDS)
    short, long = (trained(world, n, judging=False).state.copies.past for n in (1, 9))
    played = np.asarray(long.played - short.played)
    assert played.shape == (2, 4)
    share = played / played.sum(axis=1, keepdims=True)
    np.testing.assert_allclose(share, [weights, weights], atol=0.04)
    assert (played.sum(axis=1) > 90).all()


def test_regret_and_learnability_make_weights_of_their_own():
    found = {}
    for rule in (Learnability(), Learnability(of_success=False), Regret()):
        copies = trained(taught(WORLD, rule, BOUNDS), 3, judging=False).state.copies
        assert copies.past.weights.shape == (2, 4)
        np.testing.assert_allclose(copies.past.weights.sum(axis=1), 1.0, rtol=1e-5)
        found[rule] = np.asarray(copies.past.weights)
        assert (found[rule].min(axis=1) >= 0.125 - 1e-6).all()
        assert (found[rule].max(axis=1) > 0.3).any()
    assert not np.allclose(found[Regret()], found[Learnability(of_success=False)])


# ---- a training otherwise ------------------------------------------------------------------------


def as_before(world, params, before, action, noise):
    """A step of the copies as it was before there were curricula."""
    own = copies._own(params, before.context)
    moved: Moved = world.step(before.world, action[:, None], own)
    terminated = moved.done[:, 0]
    done = terminated | (before.elapsed + 1 >= world.decisions(params))
    after = world.observe(moved.state, own).obs[:, 0]
    taken = jnp.cumsum(done)
    n_contexts = params.visible.shape[0]
    context = jnp.where(done, (before.turn + taken - 1) % n_contexts, before.context)
    state = world.restart(moved.state, done, noise, copies._own(params, context))
    elapsed = jnp.where(done, 0, before.elapsed + 1)
    new = copies.Copies(state, elapsed, context, (before.turn + taken[-1]) % n_contexts)
    return new, copies.Step(moved.reward[:, 0], terminated, done, after), None


def test_without_a_curriculum_weights_are_bit_for_bit_what_they_were(monkeypatch):
    now = trained(WORLD)
    assert now.state.copies.past is None  # and files of before hold all that there is
    jax.clear_caches()
    monkeypatch.setattr(copies, "_advance", as_before)
    assert_same(now, trained(WORLD))
    jax.clear_caches()


@pytest.mark.parametrize("rule", [Learnability(), Regret()])
def test_a_training_that_goes_on_ends_where_it_would_have(rule, tmp_path):
    world = taught(WORLD, rule, BOUNDS)
    whole = trained(world)
    file = tmp_path / "training.npz"
    paused = trained(world, until=2 * PPO.update_length, saved=engine.SavedTraining(file))
    assert (int(paused.updates), int(whole.updates)) == (2, 4)
    again = trained(world, saved=engine.SavedTraining(file))
    assert_same(whole, again)
    other = trained(WORLD)
    assert (np.asarray(other.state.weights.actor[0][0]) != whole.state.weights.actor[0][0]).any()


def test_one_context_leaves_nothing_to_choose():
    one = jax.tree.map(lambda x: x[:1], params_of())
    settings = (RECIPE.ppo, [7], one, 2 * PPO.update_length)
    plain = engine.train(WORLD, *settings, judging=False)
    same = engine.train(taught(WORLD, Regret(), BOUNDS), *settings, judging=False)
    assert_same(plain, same)


# ---- where it is asked for -----------------------------------------------------------------------


def test_a_baseline_with_a_curriculum_says_so_and_plays_the_same_episodes(tmp_path):
    cmdp = get_cmdp("cartpole-length", visibility="multiplier")
    contexts = [cmdp.space.contexts[place] for place in (3, 40, 99)]
    plain = replace(cmdp.trainer_for("quick"), eval_episodes=2)
    trainer = with_curriculum(plain, "regret", cmdp.normalisation)
    job = InJax(trainer, contexts, "ppo", 13_000)
    assert json.loads(json.dumps(job.settings)) == job.settings
    assert "taught by Regret(uniform=0.5, temperature=0.3" in job.settings["environment"]
    returns, _, record = job.run(0, tmp_path / "taught", lambda *_: None)
    assert returns.shape == (3,)
    assert record["steps"] == 25_600  # and no other
    with pytest.raises(InvalidInput, match="other settings: environment was"):
        InJax(plain, contexts, "ppo", 13_000).run(0, tmp_path / "taught", lambda *_: None)


def test_a_curriculum_needs_copies_steps_and_bounds():
    cmdp = get_cmdp("cartpole-length")
    with pytest.raises(UnknownName, match="curriculum is called 'luck'"):
        with_curriculum(cmdp.trainer, "luck", cmdp.normalisation)
    with pytest.raises(InvalidInput, match="needs bounds of the returns, got None"):
        with_curriculum(cmdp.trainer, "regret", None)
    ring = get_cmdp("ring-vel")
    with pytest.raises(InvalidInput, match="got WorldTrainer that counts episodes"):
        with_curriculum(ring.trainer, "regret", ring.normalisation)
    with pytest.raises(InvalidInput, match="start again one by one, got object"):
        taught(object(), Regret(), BOUNDS)


def test_worlds_with_other_rules_are_other_worlds():
    one, other = (taught(WORLD, rule, BOUNDS) for rule in (Regret(), Regret(temperature=1.0)))
    assert one != other
    assert isinstance(one, Taught)
    assert repr(one) != repr(other) != repr(WORLD)
    assert one == taught(WORLD, Regret(), BOUNDS)
