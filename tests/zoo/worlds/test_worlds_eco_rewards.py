"""What eco-driving is taught by: closed forms of the rewards, and their place in a training."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("jax", reason="the jax extra is not installed")
pytest.importorskip("pettingzoo", reason="the traffic extra is not installed")

import mbtl.engine.learners as engine  # noqa: F401  isort: skip  # before jax: it sets jax's flags
import jax.numpy as jnp

from mbtl.errors import UnknownName
from mbtl.problems import get_cmdp
from mbtl.zoo.cmdps.traffic.eco import LIMIT
from mbtl.zoo.worlds.traffic import eco
from mbtl.zoo.worlds.traffic.eco import Costs

CONTEXT = {"green": 20.0}


@pytest.fixture(scope="module")
def cmdp():
    return get_cmdp("eco-green", engine="jax")


@pytest.mark.parametrize("speed", [3.5, 7.0, 14.0])
def test_speeds_of_a_trip_add_up_to_its_length_so_the_papers_reward_hardly_asks_for_them(
    speed,
):
    steps = int(490.0 / (0.5 * speed))
    free = Costs(crawl=1.0, crawling=35.0, co2=0.0, scale=15.0)
    paper = eco.paper(free, jnp.full(steps, speed), jnp.zeros(steps)).sum()
    np.testing.assert_allclose(paper, 490.0 / (0.5 * 15.0), rtol=1e-5)
    delay = eco.delay(LIMIT, jnp.full(steps, speed)).sum()
    np.testing.assert_allclose(-0.5 * delay, 490.0 / speed - 490.0 / LIMIT, atol=1e-3)


def test_a_platoon_is_an_agent_and_the_cars_behind_it_up_to_the_next_agent():
    each = jnp.array([[-1.0], [-2.0], [-4.0], [-8.0], [-16.0]])
    row = jnp.array([[3], [-1], [1]])  # places are not in the order of the road
    found = eco.of_platoons(each, row)
    assert float(found[0, 0]) == -24.0
    assert float(found[2, 0]) == -6.0


def test_each_reward_is_given_to_agents_only(cmdp):
    twin, params = cmdp.trainer.problem([CONTEXT])
    twin = replace(twin, warm_up=0, few=())  # less to compile
    state = twin.start(jnp.arange(1, dtype=jnp.uint32), params)
    speed = jnp.full_like(state.main.x, 7.0).at[2].set(0.0)
    main = state.main._replace(x=jnp.full_like(state.main.x, -1e4).at[:4, 0].set(
        jnp.array([300.0, 200.0, 100.0, -10.0])
    ))  # fmt: skip
    row = jnp.full_like(state.row, -1).at[5, 0].set(1)
    state = state._replace(main=main, row=row)
    leaves, co2 = jnp.array([False]), jnp.zeros_like(speed)
    expected = {"paper": 7.0 / 15.0, "delay": -0.5, "platoon": -1.5, "road": -2.0}
    assert set(expected) == set(twin.rewards)
    for name, value in expected.items():
        reward, done = replace(twin, reward=name)._rewards(state, speed, co2, leaves)
        np.testing.assert_allclose(reward[5, 0], value, rtol=1e-6)
        assert float(jnp.abs(reward).sum()) == pytest.approx(abs(value))
        assert not done.any()


def test_a_new_policy_begins_with_the_first_action_of_its_recipe(cmdp):
    trainer = cmdp.trainer_for("paper", hyperparameters={"first_action": 3.0})
    action, _ = trainer.untrained(CONTEXT).predict(np.zeros((1, 40), np.float32))
    assert float(action.reshape(())) == pytest.approx(3.0)


def test_another_reward_is_part_of_the_recipe_and_an_unknown_one_is_refused(cmdp):
    assert "reward" not in cmdp.trainer_for("paper").recipe
    assert cmdp.trainer_for("paper", reward="delay").recipe["reward"] == "delay"
    with pytest.raises(UnknownName, match="delay, paper, platoon, road"):
        cmdp.trainer_for("standard", reward="speed").train([CONTEXT], 0)
    ring = get_cmdp("ring-acc", engine="jax").trainer_for("quick", reward="delay")
    with pytest.raises(UnknownName, match="reward of this world"):
        ring.train([{"hold": 5.0}], 0)
