"""The ramp's twin: the zipper in closed form, that no car is lost, and whose reward is whose."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("jax", reason="the jax extra is not installed")
pytest.importorskip("gymnasium", reason="the envs extra is not installed")
pytest.importorskip("pettingzoo", reason="the traffic extra is not installed")

import mbtl.engine.learners as engine  # noqa: F401  isort: skip  # before jax: it sets jax's flags
import jax
import jax.numpy as jnp

from mbtl.engine.learners import networks
from mbtl.engine.learners.episodic.episodes import Actor, Episodes, record
from mbtl.engine.learners.episodic.recipes import TRPORecipe
from mbtl.engine.learners.episodic.returns import Returns, advantages
from mbtl.errors import ContextMismatch
from mbtl.zoo.cmdps.traffic.twins import RampProblem
from mbtl.zoo.worlds.traffic.idm import IDM
from mbtl.zoo.worlds.traffic.ramp import NO_CAR, Zipper, braking, there

RULE = Zipper(IDM(1.0, 1.5, 1.0), length=5.0, min_gap=2.0, impatience=0.5, dt=0.1)
FREE = np.inf


def approach(left, speed, there=True, told=FREE):
    """One car with nobody before it on its lane."""
    column = (jnp.full((1, 1), x) for x in (left, speed, 13.89, FREE, told))
    left, speed, desired, behind, told = column
    return RULE.approach(jnp.full((1, 1), there), left, speed, desired, behind, told, 8.0)


# ---- the zipper ----------------------------------------------------------------------------------


def test_braking_is_counted_step_by_step():
    # 0.45 m/s, 0.15 less in every step: 0.03 + 0.015 + 0 m
    assert float(braking(jnp.float32(0.4501), 1.5, 0.1)) == pytest.approx(0.045, abs=1e-4)


def test_a_car_means_to_arrive_a_second_after_the_one_that_arrives_before():
    # SUMO's own answer, measured: a car 18.85 m before the zipper, another one 6.19 m before it
    left, speed = 18.85, 10.777
    found = RULE.speeds(approach(left, speed), approach(6.19, 8.063))
    time = 1.0 + 1.0  # of the other one, in whole steps and at least a second; and a second
    push = 2.0 * (left - (speed + 0.1) * time) / time**2
    assert float(found[0, 0]) == pytest.approx(speed + 0.1 * push, abs=1e-5)
    assert (float(found[0, 0]) - speed) / 0.1 == pytest.approx(-1.4520, abs=1e-3)


def test_nobody_yields_to_one_who_comes_much_later_or_does_not_come():
    ego = approach(20.0, 10.0)
    stands = approach(6.0, 0.0, told=0.0)  # measured: SUMO has nobody wait for it
    for foe in (approach(95.0, 5.0), approach(6.0, 8.0, there=False), stands):
        assert np.isinf(RULE.speeds(ego, foe)).all()


def test_of_two_who_meet_only_one_yields():
    one, other = approach(30.0, 10.0), approach(24.0, 9.0)
    assert np.isfinite(RULE.speeds(one, other)).all()
    assert np.isinf(RULE.speeds(other, one)).all()


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


@pytest.mark.parametrize(
    ("obs", "holds"),
    [
        pytest.param("fresh", (1.0, 4.0), marks=pytest.mark.long),
        pytest.param("fresh", (1.0, 3.0, 4.0), marks=pytest.mark.long),
        pytest.param("stale", (1.0, 3.0, 4.0), marks=pytest.mark.long),
    ],
)
def test_ramps_of_several_holds_live_together_as_they_do_alone(obs, holds):
    contexts, n = [{"hold": hold} for hold in holds], len(holds)
    twin, each = RampProblem("acceleration", obs=obs, visibility="multiplier")(contexts)
    twin = replace(twin, warm_up=600, unmeasured=20, total_steps=100)
    together = jax.tree.map(lambda *x: jnp.stack(x), *each)
    seeds = np.arange(2 * n, dtype=np.uint32).reshape(n, 2)
    weights = networks.stack([networks.init_weights(i, 9, twin.action, (8,)) for i in range(n)])
    actor = Actor(weights.actor, weights.log_std, weights.critic)
    params = jax.tree.map(lambda x: jnp.repeat(x, 2, axis=0), together)
    beats = twin.decisions(together)
    assert beats == (10, 12, 10)  # three holds of 4 s, of 1 s each, are the longest episode
    recorded = jax.jit(record, static_argnums=(0, 1, 2))
    mixed = recorded(twin, "tanh", beats, actor, seeds, params)
    for p, own in enumerate(each):
        some = jax.tree.map(lambda x, p=p: x[p : p + 1], actor)
        count, its = twin.decisions(own), seeds[p : p + 1]
        alone = recorded(twin, "tanh", count, some, its, own)
        later = slice(10 - count, None)
        assert not mixed.acting[p, : 10 - count].any()
        np.testing.assert_array_equal(mixed.acting[p, later], alone.acting[0])
        assert alone.acting.sum() > 4 * count  # several cars of each simulation
        told = np.asarray(alone.acting[0])
        for name in ("outputs", "action", "value", "reward", "done"):
            found, wanted = getattr(mixed, name)[p, later], getattr(alone, name)[0]
            np.testing.assert_allclose(found[told], wanted[told], atol=1e-4)
        for name in ("score", "last_value", "last_acting"):
            np.testing.assert_allclose(getattr(mixed, name)[p], getattr(alone, name)[0], atol=1e-4)


@pytest.mark.long
def test_an_episode_does_not_depend_on_its_company():
    twin, (params,) = RampProblem("speed")([{"hold": 40.0}])
    twin = replace(twin, warm_up=600, unmeasured=0, total_steps=800)
    one = jnp.uint32(7)

    def alone(seeds):
        state = twin.start(seeds, params)
        told = jnp.zeros((len(seeds), twin.agents), jnp.int32)  # so that the ramp fills up
        return twin.step(twin.step(state, told, params).state, told + 4, params)

    few, many = alone(one[None]), alone(jnp.arange(20, dtype=jnp.uint32))
    assert (np.asarray(there(many.state.side)).sum(axis=0) > 6).any()  # long rows were in use
    for a, b in zip(jax.tree.leaves(few), jax.tree.leaves(many), strict=True):
        if a.ndim:
            own = b[..., 7] if b.shape[-1] == 20 else b[7]
            np.testing.assert_allclose(np.squeeze(a), own, rtol=1e-4, atol=1e-4)


def test_the_hold_is_a_whole_number_of_steps():
    with pytest.raises(ContextMismatch, match=r"0\.1 s"):
        RampProblem("speed")([{"hold": 0.05}])


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
