"""The ramp's twin: the zipper in closed form, that no car is lost, and whose reward is whose."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mbtl.engine.learners.episodic.episodes import Episodes
from mbtl.engine.learners.episodic.returns import Returns, advantages
from mbtl.engine.learners.recipes import TRPORecipe
from mbtl.zoo.cmdps.traffic.twins import RampProblem
from mbtl.zoo.worlds.traffic.idm import IDM
from mbtl.zoo.worlds.traffic.ramp import NO_CAR, Zipper, there

RULE = Zipper(IDM(1.0, 1.5, 1.0), length=5.0, min_gap=2.0, impatience=0.5, dt=0.1)
SPEEDS, APPROACH = jax.jit(RULE.speeds), jax.jit(RULE.approach)
FREE = np.inf


def approach(left, speed, there=True, told=FREE):
    """One car with nobody before it on its lane."""
    column = (jnp.full((1, 1), x) for x in (left, speed, 13.89, FREE, told))
    left, speed, desired, behind, told = column
    return APPROACH(jnp.full((1, 1), there), left, speed, desired, behind, told, 8.0)


# ---- the zipper ----------------------------------------------------------------------------------


def test_a_car_means_to_arrive_a_second_after_the_one_that_arrives_before():
    # SUMO's own answer, measured: a car 18.85 m before the zipper, another one 6.19 m before it
    left, speed = 18.85, 10.777
    found = SPEEDS(approach(left, speed), approach(6.19, 8.063))
    time = 1.0 + 1.0  # of the other one, in whole steps and at least a second; and a second
    push = 2.0 * (left - (speed + 0.1) * time) / time**2
    assert float(found[0, 0]) == pytest.approx(speed + 0.1 * push, abs=1e-5)
    assert (float(found[0, 0]) - speed) / 0.1 == pytest.approx(-1.4520, abs=1e-3)


def test_nobody_yields_to_one_who_comes_much_later_or_does_not_come():
    ego = approach(20.0, 10.0)
    stands = approach(6.0, 0.0, told=0.0)  # measured: SUMO has nobody wait for it
    for foe in (approach(95.0, 5.0), approach(6.0, 8.0, there=False), stands):
        assert np.isinf(SPEEDS(ego, foe)).all()


def test_of_two_who_meet_only_one_yields():
    one, other = approach(30.0, 10.0), approach(24.0, 9.0)
    assert np.isfinite(SPEEDS(one, other)).all()
    assert np.isinf(SPEEDS(other, one)).all()


# ---- the whole -----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def driven():
    """Three short episodes without advice: the state after the warm-up, and one hold."""
    twin, (params,) = RampProblem("acceleration")([{"hold": 40.0}])
    twin = replace(twin, warm_up=600, unmeasured=0, total_steps=400)

    @jax.jit
    def play(seeds):
        warm = twin.start(seeds, params)
        return warm, twin.drive(warm, params)

    return play(jnp.arange(3, dtype=jnp.uint32))


def test_cars_stay_in_order_and_no_car_is_lost(driven):
    warm, moved = driven
    for state in (warm, moved.state):
        on_road = 0
        for queue in (state.main, state.side, state.end):
            is_car, x = np.asarray(there(queue)), np.asarray(queue.x)
            assert (np.diff(is_car.astype(int), axis=0) <= 0).all()  # no gaps between rows
            apart = np.where(is_car[1:], x[:-1] - x[1:], np.inf)
            assert apart.min() > 5.0
            on_road = on_road + ((queue.car >= 0) & is_car).sum(axis=0)
        numbers = np.concatenate([np.asarray(state.end.car), np.asarray(state.main.car)])
        for k in range(3):  # the cars of the main road leave in the order in which they came
            mine = numbers[:, k][numbers[:, k] >= 0]
            assert (np.diff(mine) == 1).all()
            assert mine[-1] == int(state.entered[k]) - 1
        assert (on_road > 5).all()


def test_everybody_who_acts_has_the_reward_of_all_and_who_leaves_is_done(driven):
    warm, moved = driven
    before, after = np.asarray(warm.look.car).T, np.asarray(moved.state.look.car).T
    acting, reward = before != NO_CAR, np.asarray(moved.reward)
    assert acting.any()
    assert (before[acting] % 10 == 0).all()
    left = np.asarray(moved.state.counts.left) / 400.0
    np.testing.assert_allclose(np.where(acting, left[:, None], 0.0), reward, rtol=1e-5)
    np.testing.assert_array_equal(np.asarray(moved.done), acting & (before != after))
    assert np.asarray(moved.done).any()


def test_cars_that_found_no_room_are_counted(driven):
    counts = driven[1].state.counts
    # 40 s from second 60 on: cars of the main road come every 1.8 s, of the ramp every 12 s
    assert np.asarray(counts.wanted).tolist() == [26, 26, 26]
    assert (np.asarray(counts.missed) > 0).all()
    assert (np.asarray(counts.missed) < 26).all()
    assert (np.asarray(counts.collided) == 0).all()


# ---- credit --------------------------------------------------------------------------------------


def test_the_team_is_paid_until_the_end_also_who_has_left():
    """Two agents and two decisions; the second leaves in the first one."""
    acting = np.array([[[True, True]], [[True, False]]])
    reward = np.where(acting, np.array([2.0, 4.0])[:, None, None], 0.0)
    zeros = jnp.zeros((2, 1, 2, 1))
    lived = Episodes(
        obs=jnp.zeros((4, 2)),
        row=jnp.zeros((2, 1, 2), jnp.int32),
        outputs=zeros,
        action=zeros,
        value=jnp.asarray([[[1.0, 3.0]], [[5.0, 9.0]]]),
        acting=jnp.asarray(acting),
        reward=jnp.asarray(reward, jnp.float32),
        done=jnp.asarray([[[False, True]], [[False, False]]]),
        last_value=jnp.asarray([[8.0, 1.0]]),
        last_acting=jnp.asarray([[True, False]]),
        score=jnp.zeros(1),
    )
    recipe = TRPORecipe(gamma=0.5, normalize_reward=False, center_reward=False)
    own = advantages(recipe, Returns.empty(), lived)[1]
    np.testing.assert_allclose(own[0, 0], [2.0 + 0.5 * (4.0 + 0.5 * 8.0), 2.0])
    team = replace(recipe, credit="team")
    advantage, target, _ = advantages(team, Returns.empty(), lived)
    np.testing.assert_allclose(target[0, 0], [6.0, 6.0])  # 2 + .5 (4 + .5 8), for both
    np.testing.assert_allclose(advantage[0, 0], [5.0, 3.0])
