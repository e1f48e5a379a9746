"""A policy that goes on is the same policy, whoever learns and by whatever recipe."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import poles
import pytest
from poles import assert_same, first

import mbtl.engine.learners as engine
from mbtl.engine import worlds
from mbtl.engine.learners import networks
from mbtl.engine.learners.clock import Pace, clock_at
from mbtl.engine.learners.recipes import RECIPES as BY_COPIES
from mbtl.engine.learners.recipes import TWIN_RECIPES, EpisodicPPORecipe, TRPORecipe
from mbtl.errors import InvalidInput
from mbtl.problems import get_cmdp
from mbtl.zoo.worlds import CartPole

WORLD = worlds.Solo(CartPole(horizon=12))
OBSERVATIONS = np.random.default_rng(0).normal(0.3, [2.0, 3.0, 0.2, 3.0, 1.0], (40, 5))

BY_STEPS = {"n_envs": 2, "n_steps": 32, "batch_size": 32, "hidden": (8,)}
SMALL = {
    engine.PPORecipe: BY_STEPS,
    engine.A2CRecipe: {"n_envs": 2, "hidden": (8,)},
    engine.DQNRecipe: {"buffer_size": 800, "learning_starts": 0, "hidden": (8,)},
    TRPORecipe: {"hidden": (8,)},
    EpisodicPPORecipe: {"rows": 16, "minibatches": 2, "n_epochs": 2, "hidden": (8,), "begin": ""},
}
SMALL_Q = {"gradient_steps": 2, "batch_size": 8, "buffer_size": 64, "hidden": (8,)}
PPO = engine.PPORecipe(**BY_STEPS)
KINDS = {
    "steps": (BY_COPIES, ("PPO fast", "A2C fast", "DQN fast")),
    "episodes": (TWIN_RECIPES, ("TRPO paper", "PPO glide", "DQN fast")),
}
"""A recipe of each learner: others of it differ in numbers only."""
RECIPES = {
    f"{name} by {unit}": replace(recipe, **SMALL.get(type(recipe), SMALL_Q))
    for unit, (kinds, names) in KINDS.items()
    for name in names
    for recipe in [kinds[name.split()[0]][name.split()[1]]]
}
for method in ("paco", "moore"):
    RECIPES[method] = engine.MultiTaskRecipe.of(method, PPO, 2)
RECIPES["ppo standardised"] = engine.MultiTaskRecipe.of("ppo", replace(PPO, standardize=True))
NAMES = [pytest.param(n, marks=pytest.mark.long) if n == "paco" else n for n in RECIPES]


def params_of(recipe, lengths):
    params = poles.params_of(WORLD, lengths)
    if not isinstance(recipe, engine.MultiTaskRecipe):
        return params
    both = jax.tree.map(lambda x: np.concatenate([x, x]), params)  # for each policy
    return engine.in_sets(recipe, both, 2)


def outputs(recipe, network):
    each = jax.vmap(partial(networks.apply, activation=recipe.activation), (0, None))
    places = OBSERVATIONS
    if getattr(recipe, "has_vectors", False):
        places = np.column_stack([OBSERVATIONS, np.linspace(0.0, 1.0, len(OBSERVATIONS))])
    return np.asarray(each(network, np.float32(places)))


def test_a_lesson_s_policy_is_taught_again_as_it_was():
    trainer = get_cmdp("eco-green", engine="jax").trainer_for("standard")
    context = {"green": 20.0}
    policy = trainer.untrained(context)
    world, _ = trainer._lessons([context])
    again = engine.export_policies(world, engine.taught(world, policy, policy.activation))[0]
    seen = np.random.default_rng(0).uniform(0.0, 1.0, (20, *policy.observation_shape))
    np.testing.assert_allclose(again.outputs(seen), policy.outputs(seen), rtol=1e-5)
    assert again.head.log_std == pytest.approx(policy.head.log_std, rel=1e-5)


def test_a_policy_that_would_act_otherwise_is_refused():
    policy = get_cmdp("cartpole-length", engine="jax").trainer_for("quick").untrained({"length": 1})
    with pytest.raises(InvalidInput, match="with the activation relu, got tanh"):
        engine.taught(WORLD, policy, "relu")
    with pytest.raises(InvalidInput, match="with the activation tanh, got str"):
        engine.taught(WORLD, "policy.zip", "tanh")


def test_a_copy_learns_as_slowly_as_its_parent_did():
    """Half a unit of copies at the full rate was behind a fresh unit at home."""
    own, parents = Pace.endless(10, 1.0), Pace.endless(10, 1.0, before=8)
    rates = [
        float(clock_at(number, pace).rate) for number, pace in [(0, own), (8, own), (0, parents)]
    ]
    np.testing.assert_allclose(rates, [1.0, 1 / 3, 1 / 3], rtol=1e-6)
    ending = parents.branch(7, 9)  # counts from its own first update
    rates = [float(clock_at(number, ending).rate) for number in (7, 8, 9)]
    np.testing.assert_allclose(rates, [0.25, 0.125, 0.0], rtol=1e-6)


@pytest.mark.parametrize("name", NAMES)
def test_extended_or_tuned_it_acts_as_before_until_it_learns(name):
    """Extended it ends, bit for bit, where it would have ended without a pause, and whatever the
    other policies of the program are."""
    recipe = RECIPES[name]
    train = partial(engine.train, WORLD, judging=False)
    own, unit = params_of(recipe, [0.4, 1.0]), recipe.update_length
    whole = train(recipe, [3, 5], own, 3 * unit)
    pace = (Pace.falling if recipe.anneal else Pace.endless)(3)
    half = train(recipe, [3, 5], own, unit, pace=pace)
    kept = engine.from_arrays(engine.start(WORLD, recipe, [3, 5], own), engine.to_arrays(half))
    end = train(recipe, [3, 5], own, 3 * unit, resume=kept)
    assert_same(whole, end)
    other = params_of(recipe, [0.2, 2.0])
    beside = jax.tree.map(lambda x, y: np.stack([x[0], y[1]]), own, other)
    company = train(recipe, [3, 9], beside, 3 * unit)
    assert_same(first(whole.state), first(company.state))
    assert not poles.same(*(jax.tree.map(lambda x: x[1], t.state) for t in (whole, company)))

    before = jax.tree.map(np.array, whole.state.weights)
    given = jax.tree.map(jnp.asarray, before)
    if isinstance(given, networks.Weights):
        given = given._replace(critic=())
    still = Pace.endless(3).branch(-1, 0)  # whose gradient steps have length 0
    tuned = train(recipe, [7, 8], other, unit, weights=given, pace=still).state.weights
    assert_same(given.actor, before.actor)  # they stay their owner's
    another_stage = whole._replace(updates=whole.updates * 0)
    extended = train(recipe, [3, 5], own, unit, resume=another_stage, pace=still).state.weights
    close = partial(np.testing.assert_allclose, rtol=1e-4, atol=1e-6)
    for after in (tuned, extended):
        close(outputs(recipe, after.actor), outputs(recipe, before.actor))
        close(after.log_std, before.log_std)
    if before.critic and not isinstance(recipe, TRPORecipe):  # whose critic has a rate of its own
        close(outputs(recipe, extended.critic), outputs(recipe, before.critic))
