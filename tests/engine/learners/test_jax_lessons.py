"""Lessons: other actions in training than in use, a rule to begin with, deviations that last."""

import numpy as np
import pytest

pytest.importorskip("pettingzoo", reason="the traffic extra is not installed")

import jax
import jax.numpy as jnp

from mbtl.engine import worlds
from mbtl.engine.learners import networks
from mbtl.engine.learners.episodic.episodes import Actor, record
from mbtl.engine.learners.export import lawful
from mbtl.engine.worlds.environments import Box, Law
from mbtl.errors import InvalidInput
from mbtl.problems import get_cmdp
from mbtl.zoo.cmdps.traffic import eco
from mbtl.zoo.worlds.pendulum import Pendulum, PendulumParams
from mbtl.zoo.worlds.traffic.eco import layers


@pytest.fixture(scope="module")
def cmdp():
    return get_cmdp("eco-green", engine="jax")


def seen(*, phase, left, speed, changes):
    """An observation of a car that is alone on the approach."""
    obs = np.zeros(eco.SIZE, np.float32)
    obs[eco.LAYOUT["speed"]] = speed / eco.SPEED_SCALE
    obs[eco.LAYOUT["distance"]] = left / eco.LENGTH_SCALE
    obs[eco.LAYOUT["phase"]] = np.eye(3)[["green", "yellow", "red"].index(phase)]
    obs[eco.LAYOUT["changes"]] = np.array(changes) / eco.TIME_SCALE
    obs[eco.LAYOUT["road"]] = (1.0, 0.0, 0.0)
    obs[eco.LAYOUT["destination"]] = (0.0, 1.0, 0.0)
    obs[eco.LAYOUT["leader"]] = obs[eco.LAYOUT["follower"]] = eco.ABSENT
    obs[eco.LAYOUT["left"]] = obs[eco.LAYOUT["right"]] = [speed / eco.SPEED_SCALE, 0, 0, 0] * 2
    return obs


@pytest.mark.parametrize("activation", ["tanh", "relu"])
def test_a_lawful_policy_does_what_the_law_says_of_its_outputs(activation):
    law = Law(scale=28.0, feature=1, gain=-30.0, box=Box((-20.0,), (10.0,)))
    weights = networks.init_weights(0, 3, Box((0.0,), (1.0,)), (8, 8), log_std=-1.0)
    obs = np.random.default_rng(0).uniform(0.0, 1.0, (50, 3)).astype(np.float32)
    expected = 28.0 * networks.apply(weights.actor, obs, activation) - 30.0 * obs[:, [1]]
    found = lawful(weights, law, activation)
    np.testing.assert_allclose(
        networks.apply(found.actor, obs, activation), expected, rtol=0.0, atol=1e-3
    )
    np.testing.assert_allclose(found.log_std, np.log(28.0 * np.exp(-1.0)), rtol=1e-6)
    with pytest.raises(InvalidInput, match="tanh or relu"):
        lawful(weights, law, "mish")


def test_the_rule_glides_to_a_red_light_and_leaves_alone_who_makes_the_green():
    red = seen(phase="red", left=200.0, speed=14.0, changes=(25.0, 60.0, 101.0))
    green = seen(phase="green", left=100.0, speed=14.0, changes=(20.0, 61.0, 96.0))
    red_speed, green_speed = networks.apply(layers("glide"), np.stack([red, green]))
    assert 14.0 * red_speed[0] == pytest.approx(0.55 * 200.0 / 26.0, abs=1.0)
    assert green_speed[0] > 0.95


def test_a_training_begins_with_the_rule_in_accelerations_whatever_else_it_sees(cmdp):
    trainer = cmdp.trainer_for("standard")
    policy = trainer.untrained({"green": 20.0})
    obs = seen(phase="red", left=200.0, speed=3.0, changes=(25.0, 60.0, 101.0))
    (advice,) = np.asarray(networks.apply(layers("glide"), obs))
    action, _ = policy.predict(np.append(obs, np.float32(1.7)))
    assert action == pytest.approx((14.0 * advice - 3.0) / 0.5, abs=1e-3)
    assert (policy.head.low, policy.head.high) == (-20.0, 10.0)


def test_a_lesson_is_part_of_the_recipe_and_no_part_of_older_ones(cmdp):
    assert cmdp.trainer_for("standard").recipe["actions"] == "speed"
    assert {"actions", "reward"}.isdisjoint(cmdp.trainer_for("paper").recipe)
    assert cmdp.trainer_for("paper", reward="delay").recipe["reward"] == "delay"


def test_deviations_from_the_mean_last_as_many_decisions_as_they_are_held():
    world = worlds.Solo(Pendulum(horizon=12))
    weights = networks.stack([networks.init_weights(0, 3, world.action, (4,))])
    actor = Actor(weights.actor, weights.log_std, weights.critic)
    params = PendulumParams(*[jnp.float32(1.0)] * (len(PendulumParams._fields) - 1), jnp.zeros(0))
    seeds = jnp.arange(2, dtype=jnp.uint32)[None]
    play = jax.jit(record, static_argnums=(0, 1, 2, 6))

    def deviations(hold):
        lived = play(world, "tanh", 12, actor, seeds, params, hold)
        return np.asarray(lived.action - lived.outputs)[0, :, 0, 0, 0]

    fresh, held = deviations(1), deviations(4)
    assert len(set(fresh.round(4))) == 12
    np.testing.assert_allclose(held, np.repeat(fresh[:3], 4), atol=1e-5)
