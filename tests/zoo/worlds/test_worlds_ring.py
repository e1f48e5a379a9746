"""The ring's twin: closed forms, and that nothing depends on the company."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("jax", reason="the jax extra is not installed")
pytest.importorskip("gymnasium", reason="the envs extra is not installed")

import mbtl.engine.learners as engine  # noqa: F401  isort: skip  # before jax: it sets jax's flags
import jax
import jax.numpy as jnp

from mbtl.engine.learners import networks
from mbtl.engine.learners.episodic import episodes, learning
from mbtl.engine.learners.episodic.episodes import Actor, measures, record
from mbtl.engine.worlds import random
from mbtl.problems import get_cmdp
from mbtl.seeds import episode_seed
from mbtl.zoo.cmdps.traffic.twins import RingProblem
from mbtl.zoo.worlds.traffic import ring as ring_module
from mbtl.zoo.worlds.traffic.idm import IDM, follow, obey
from mbtl.zoo.worlds.traffic.ring import RingTwin

HUMAN = IDM(accel=1.0, decel=1.5, tau=1.0)
NOBODY = Actor((), jnp.zeros((1, 1)))
START, STEP, OBSERVE = (
    jax.jit(method, static_argnums=0)
    for method in (RingTwin.start, RingTwin.step, RingTwin.observe)
)


def ring(hold=2.0, **options):
    twin, (params,) = RingProblem("acceleration", **options)([{"hold": hold}])
    return twin, params


def unguided(twin, params, seeds):
    seeds = np.array([seeds], np.uint32)
    decisions = twin.decisions(params)
    found = measures(twin, "tanh", "none", NOBODY, seeds, seeds, params, decisions)
    return np.asarray(found["score"])[0]


# ---- car-following -------------------------------------------------------------------------------


def test_a_free_car_accelerates_as_the_model_says():
    speed = follow(HUMAN, jnp.array(10.0), jnp.array(10.0), jnp.array(1e9), 2.0, 20.0, 0.1)
    assert float(speed) == pytest.approx(10.0 + 0.1 * (1.0 - 0.5**4), rel=1e-6)


def test_at_the_equilibrium_gap_a_car_keeps_its_speed():
    v, v0 = 4.0, 13.89
    gap = (2.0 + v * 1.0) / np.sqrt(1.0 - (v / v0) ** 4)
    speed = follow(HUMAN, jnp.array(v), jnp.array(v), jnp.array(gap), 2.0, v0, 0.1)
    assert float(speed) == pytest.approx(v, rel=1e-6)


def test_no_car_brakes_harder_than_in_an_emergency_or_drives_backwards():
    hit = follow(HUMAN, jnp.array([10.0, 0.5]), jnp.zeros(2), jnp.full(2, 0.01), 2.0, 13.89, 0.1)
    np.testing.assert_allclose(hit, [10.0 - 0.9, 0.0], rtol=1e-6)


@pytest.mark.parametrize(
    ("target", "safe", "told"),
    [
        (9.0, 5.1, 5.1),  # never above what is safe
        (5.05, 5.1, 5.05),
        (0.0, 5.1, 4.85),  # braking is comfortable ...
        (0.0, 4.2, 4.2),  # ... unless safety needs more
    ],
)
def test_a_told_speed_is_obeyed_within_limits(target, safe, told):
    speed = obey(HUMAN, jnp.array(target), jnp.array(5.0), jnp.array(safe), 0.1)
    assert float(speed) == pytest.approx(told, rel=1e-6)


# ---- the ring ------------------------------------------------------------------------------------


def test_uniform_flow_without_noise_keeps_the_equilibrium_through_the_warm_up():
    twin, params = ring(noise=0.0, start="uniform")
    twin = replace(twin, speed_factor=0.0)  # all drivers want the same
    state = START(twin, jnp.zeros(1, jnp.uint32), params)
    v, gap = 4.3334, 250.0 / 22 - 5.0  # spec, 12.1
    assert gap == pytest.approx((2.0 + v) / np.sqrt(1.0 - (v / 13.89) ** 4), rel=1e-4)
    np.testing.assert_allclose(state.speed, v, atol=1e-3)


def test_noise_makes_traffic_stop_and_go():
    found = unguided(*ring(), range(100))
    assert 3.0 < found.mean() < 3.3
    assert found.std() > 0.02


def test_the_ring_keeps_its_length():
    twin, params = ring()
    state = START(twin, jnp.arange(2, dtype=jnp.uint32), params)
    for action in (1.0, -1.0, 1.0):
        state = STEP(twin, state, jnp.full((2, 1), action), params).state
    total = state.gap.sum(axis=0) + twin.cars * twin.car_length
    np.testing.assert_allclose(total, twin.circumference, rtol=1e-5)


def test_an_episode_does_not_depend_on_its_company():
    alone, together = unguided(*ring(), [7]), unguided(*ring(), [3, 7, 9])
    assert alone[0] == pytest.approx(together[1], abs=1e-3)  # another batch rounds differently
    assert abs(together[1] - together[0]) > 0.01


def test_every_hold_is_another_task():
    rewards = []
    for hold in (1.0, 4.0):
        twin, params = ring(hold)
        state = START(twin, jnp.arange(2, dtype=jnp.uint32), params)
        rewards.append(np.asarray(STEP(twin, state, jnp.full((2, 1), -1.0), params).reward))
    assert (rewards[0] > rewards[1]).all()  # braking for longer is slower


@pytest.mark.parametrize(("hold", "decisions"), [(1.0, 400), (3.0, 134), (40.0, 10)])
def test_decisions_fill_the_controlled_time(hold, decisions):
    twin, params = ring(hold)
    assert twin.decisions(params) == decisions


def test_a_stale_observation_is_that_of_the_first_step():
    seen = {}
    for obs in ("fresh", "stale"):
        twin, params = ring(hold=2.0, obs=obs)
        state = START(twin, jnp.zeros(2, jnp.uint32), params)
        first = OBSERVE(twin, state, params).obs
        state = STEP(twin, state, jnp.full((2, 1), -1.0), params).state
        seen[obs] = np.asarray(OBSERVE(twin, state, params).obs)[0, 0]
    short, params = ring(hold=0.1)
    after_one = STEP(
        short, START(short, jnp.zeros(2, jnp.uint32), params), jnp.full((2, 1), -1.0), params
    )
    np.testing.assert_array_equal(
        seen["stale"], np.asarray(OBSERVE(short, after_one.state, params).obs)[0, 0]
    )
    assert seen["fresh"][0] < seen["stale"][0] < first[0, 0, 0]


def test_a_collision_ends_the_ring_and_is_charged():
    twin, params = ring()
    state = START(twin, jnp.zeros(2, jnp.uint32), params)
    near = state.gap.at[1, 0].set(0.2).at[2, 0].add(state.gap[1, 0] - 0.2)
    moved = STEP(twin, state._replace(gap=near), jnp.zeros((2, 1)), params)
    assert moved.done[:, 0].tolist() == [True, False]
    assert float(moved.reward[0, 0]) == pytest.approx(-100.0, abs=1.0)
    again = STEP(twin, moved.state, jnp.zeros((2, 1)), params)
    assert float(again.reward[0, 0]) == 0.0
    assert not bool(again.done[0, 0])
    np.testing.assert_array_equal(again.state.gap[:, 0], moved.state.gap[:, 0])


def test_after_a_collision_the_cars_stand_for_the_rest_of_the_measured_part():
    """Half of the measured part at the speed of a free flow, the other half at none."""
    twin, params = ring(hold=10.0, noise=0.0, start="uniform")
    twin = replace(twin, warm_up=100, unmeasured=100, total_steps=1_100, speed_factor=0.0)
    drive = jax.jit(twin.drive)
    state = START(twin, jnp.zeros(2, jnp.uint32), params)
    for _ in range(6):
        state = drive(state, params).state
    speed, so_far = float(state.driven[0, 1]), float(twin.score(state)[0])
    near = state.gap.at[1, 0].set(0.2).at[2, 0].add(state.gap[1, 0] - 0.2)
    state = STEP(twin, state._replace(gap=near), jnp.zeros((2, 1)), params).state
    assert state.running.tolist() == [False, True]
    for _ in range(4):
        state = drive(state, params).state
    crashed, whole = np.asarray(twin.score(state))
    assert crashed == pytest.approx(so_far / 2, rel=0.01)
    assert whole == pytest.approx(speed, rel=0.2)


# ---- decisions that last differently long --------------------------------------------------------


@pytest.mark.parametrize("obs", ["fresh", pytest.param("stale", marks=pytest.mark.long)])
def test_rings_of_several_holds_live_together_as_they_do_alone(obs):
    contexts = [{"hold": hold} for hold in (1.0, 3.0, 4.0)]
    twin, each = RingProblem("acceleration", obs=obs, visibility="multiplier")(contexts)
    twin = replace(twin, warm_up=20, unmeasured=20, total_steps=100)
    together = jax.tree.map(lambda *x: jnp.stack(x), *each)
    seeds = np.arange(6, dtype=np.uint32).reshape(3, 2)
    weights = networks.stack([networks.init_weights(i, 4, twin.action, (8,)) for i in range(3)])
    actor = Actor(weights.actor, weights.log_std, weights.critic)
    params = jax.tree.map(lambda x: jnp.repeat(x, 2, axis=0), together)
    beats = twin.decisions(together)
    assert beats == (10, 12, 10)  # three holds of 4 s, of 1 s each, are the longest episode
    mixed = jax.jit(record, static_argnums=(0, 1, 2))(twin, "tanh", beats, actor, seeds, params)
    judged = measures(twin, "tanh", "mean", actor, seeds, seeds, params, beats)["score"]
    for p, own in enumerate(each):
        some = jax.tree.map(lambda x, p=p: x[p : p + 1], actor)
        count = twin.decisions(own)
        alone = jax.jit(record, static_argnums=(0, 1, 2))(
            twin, "tanh", count, some, seeds[p : p + 1], own
        )
        assert np.asarray(mixed.acting[p]).sum() == 2 * count
        assert not mixed.acting[p, : 10 - count].any()
        for name in ("outputs", "action", "value", "reward", "done"):
            found = getattr(mixed, name)[p, 10 - count :]
            np.testing.assert_allclose(found, getattr(alone, name)[0], atol=1e-4)
        for name in ("score", "last_value", "last_acting"):
            np.testing.assert_allclose(getattr(mixed, name)[p], getattr(alone, name)[0], atol=1e-4)
        seen = [x.obs[i][x.row[i]] for x, i in ((mixed, p), (alone, 0))]
        np.testing.assert_allclose(seen[0][10 - count :], seen[1], atol=1e-4)
        its = seeds[p : p + 1]
        own_score = measures(twin, "tanh", "mean", some, its, its, own, count)["score"]
        np.testing.assert_allclose(judged[p], own_score[0], atol=1e-4)


def test_a_collision_ends_only_its_own_ring_and_stays_with_the_decision_in_which_it_was():
    twin, each = RingProblem("acceleration", noise=0.0)([{"hold": 1.0}, {"hold": 2.0}])
    twin = replace(twin, warm_up=20, unmeasured=20, total_steps=100)
    params = jax.tree.map(lambda *x: jnp.stack(x), *each)
    beats = twin.decisions(params)
    state = START(twin, jnp.zeros(2, jnp.uint32), params)
    held, done, reward = twin.held(state), [], []
    for now in range(4):
        if now == 2:  # with the second decision of the second ring
            state = state._replace(
                gap=state.gap.at[1, 1].set(0.2).at[2, 1].add(state.gap[1, 1] - 0.2)
            )
        moved, held = twin.beat(state, held, jnp.zeros((2, 1)), params, beats, jnp.int32(now))
        state = moved.state
        done.append(moved.done[:, 0].tolist())
        reward.append(float(moved.reward[1, 0]))
    assert done == [[False, False]] * 3 + [[False, True]]
    assert reward[0] == reward[2] == 0.0  # told with the last beat
    assert reward[3] == pytest.approx(-100.0, abs=1.0)


# ---- random numbers ------------------------------------------------------------------------------


def test_moments_of_each_simulation_give_the_numbers_of_that_moment():
    seeds = jnp.arange(3, dtype=jnp.uint32)
    each = random.bits(seeds, 5, jnp.array([4, 0, 7]), 6)
    for i, moment in enumerate((4, 0, 7)):
        np.testing.assert_array_equal(each[:, i], random.bits(seeds, 5, jnp.int32(moment), 6)[:, i])


def test_noise_is_standard_normal_and_uncorrelated():
    draw = jax.vmap(lambda t: random.normal(jnp.arange(200, dtype=jnp.uint32), 2, t, 22))
    z = np.asarray(draw(jnp.arange(250)))  # (moments, cars, seeds): 1.1 million
    n = z.size
    assert abs(z.mean()) < 4 / np.sqrt(n)
    assert abs(z.var() - 1.0) < 4 * np.sqrt(2 / n)
    assert abs((z**4).mean() - 3.0) < 4 * np.sqrt(96 / n)
    for axis in range(3):  # between neighbours in time, cars and seeds
        a, b = np.take(z, range(z.shape[axis] - 1), axis), np.take(z, range(1, z.shape[axis]), axis)
        assert abs((a * b).mean()) < 4 / np.sqrt(n)


def test_nothing_in_an_episode_is_drawn_twice():
    """One seed mixes places to numbers one to one, so equal numbers would be of one place."""

    def drawn(stream, moments, count):
        each = jax.vmap(lambda t: random.bits(jnp.zeros(1, jnp.uint32), stream, t, count))
        return np.asarray(each(jnp.arange(moments))).reshape(-1)

    streams = (ring_module._SHARES, ring_module._FACTORS, episodes._ACTION, learning._EPISODE)
    parts = [drawn(stream, 4000, 22) for stream in streams]
    together = np.concatenate([drawn(ring_module._NOISE, 5000, 22), *parts])
    assert len(np.unique(together)) == len(together)


def test_rows_without_a_policy_are_those_of_nobody_and_of_anybody():
    trainer = get_cmdp("ring-acc", engine="jax").trainer_for(eval_episodes=4)
    rows = trainer.reference_rows([{"hold": 40.0}], [1])
    seeds = [episode_seed(1, episode) for episode in range(4)]
    assert rows["unguided"][0] == pytest.approx(unguided(*ring(40.0), seeds))
    assert rows["random_actions"].shape == (1, 4)
    assert rows["random_actions"].mean() < rows["unguided"].mean()


def test_coins_are_nearly_normal_and_independent_of_their_neighbours():
    seeds = jnp.arange(200, dtype=jnp.uint32)
    drawn = np.stack([random.coins(seeds, 5, jnp.int32(t), 40) for t in range(50)]).astype(float)
    assert drawn.mean() == pytest.approx(0.0, abs=0.01)  # 400,000 of them
    assert drawn.var() == pytest.approx(1.0, abs=0.01)
    assert (drawn**4).mean() - 3.0 == pytest.approx(-1 / 16, abs=0.03)
    for axis in range(3):  # moments, cars, simulations
        later, earlier = (np.delete(drawn, k, axis) for k in (0, -1))
        assert abs((later * earlier).mean()) < 0.01
