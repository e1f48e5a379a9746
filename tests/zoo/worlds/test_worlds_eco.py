"""The eco-driving twin: closed forms, bookkeeping of cars, random arrivals, and rewards."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mbtl.problems import get_cmdp
from mbtl.zoo.cmdps.traffic.eco import LIMIT, light
from mbtl.zoo.cmdps.traffic.twins import EcoProblem
from mbtl.zoo.worlds.traffic import eco, lane
from mbtl.zoo.worlds.traffic.eco import Costs, EcoParams, Light

SEEDS = jnp.arange(8, dtype=jnp.uint32)


@partial(jax.jit, static_argnums=0)
def _after(twin, params, steps):
    state = twin.start(SEEDS, params)
    return jax.lax.fori_loop(0, steps, lambda _, s: twin.drive(s, params).state, state)


def after(twin, contexts, steps):
    """State of 8 simulations, one per context, after so many unguided steps."""
    each = EcoProblem()(contexts)[1]
    columns = [jnp.stack([getattr(p, name) for p in each]) for name in EcoParams._fields]
    return _after(twin, EcoParams(*columns), jnp.int32(steps))


@pytest.fixture(scope="module")
def twin():
    """Rows of two lengths, so that there is less to compile."""
    twin = EcoProblem()([{}])[0]
    return replace(twin, few=twin.few[:1])


# ---- car-following -------------------------------------------------------------------------------


# ---- bookkeeping ---------------------------------------------------------------------------------


def test_contexts_do_not_mix_and_in_all_of_them_cars_stay_in_order_and_none_is_lost(twin):
    busy = {"inflow": 1600.0, "penetration": 0.5}
    contexts = [{}, {"penetration": 1.0}, {"inflow": 1600.0}, {"green": 5.0}, busy, busy, {}, {}]
    state = after(twin, contexts, 800)
    scores = np.asarray(twin.score(state))
    assert len(set(scores.tolist())) == 8
    assert max(scores[2:4]) < scores[0]  # a short green, and a jam, are slow
    alone = np.asarray(twin.score(after(twin, contexts[2:3] * 8, 800)))
    assert alone[2] == pytest.approx(scores[2], abs=0.02)
    x = np.asarray(state.main.x)
    there = x > 0.5 * lane.EMPTY
    assert (np.diff(x, axis=0)[there[1:]] < 0.0).all()
    assert (np.diff(there.astype(int), axis=0) <= 0).all()  # no hole
    on_road = there.sum(axis=0) + (np.asarray(state.side.x) > 0.5 * lane.EMPTY).sum(axis=0)
    gone = np.asarray(state.entered).sum(axis=0) - on_road
    uncounted = gone - np.asarray(state.totals.completed)
    assert ((uncounted >= 0) & (uncounted < 25)).all()  # those of the warm-up
    assert there.sum(axis=0).max() > twin.few[0][0]  # long rows were in use


@pytest.mark.parametrize(("visibility", "size"), [("hidden", 39), ("multiplier", 40), ("raw", 44)])
def test_what_is_seen_of_the_context(visibility, size):
    twin, (params,) = EcoProblem(unit={"green": 25.0}, visibility=visibility)([{"green": 50.0}])
    assert twin.n_features + len(params.visible) == size
    if visibility == "multiplier":
        assert params.visible.tolist() == [2.0]


# ---- signals and arrivals ------------------------------------------------------------------------


@pytest.mark.parametrize("green", [1.0, 35.0])
def test_the_light_is_that_of_the_corridor(green):
    ours, theirs = Light(3.0, 35.0), light(green)
    times = np.arange(0.0, 160.0, 0.5)
    greens = jnp.full(len(times), green)
    seen = np.stack(ours.seen(greens, jnp.asarray(times, jnp.float32)), axis=1)
    side = np.asarray(ours.side(greens, jnp.asarray(times, jnp.float32)))
    for k, time in enumerate(times):
        assert seen[k, :3].tolist() == np.eye(3)[theirs.phase(time)].tolist()
        assert seen[k, 3:] == pytest.approx(theirs.changes(time))
        assert side[k] == (green + 3.0 <= time % theirs.cycle < green + 38.0)


def test_arrivals_are_poisson_and_drivers_as_the_population_says(twin):
    seeds = jnp.arange(40_000, dtype=jnp.uint32)
    gap, car = twin.demand.draw(seeds, jnp.zeros((2, len(seeds)), jnp.int32), 400.0, 0.2)
    n = len(seeds)
    for feeder, share in enumerate((0.9, 0.1)):
        mean = 3600.0 / (400.0 * share)
        assert float(gap[feeder].mean()) == pytest.approx(mean, rel=4 / n**0.5)
        assert float(gap[feeder].std()) == pytest.approx(mean, rel=8 / n**0.5)
    controlled = np.asarray(car.controlled[0]) > 0
    assert controlled.mean() == pytest.approx(0.2, abs=4 * (0.16 / n) ** 0.5)
    length, tau = np.asarray(car.length[0]), np.asarray(car.tau[0])
    assert (tau[controlled] == 1.0).all()
    assert (length == 12.0).mean() == pytest.approx(0.8 * 0.0035, abs=0.001)
    passenger = ~controlled & (length == 5.0)
    assert passenger.mean() == pytest.approx(0.8 * 0.425 / 0.9995, abs=0.01)
    assert tau[passenger].mean() == pytest.approx(0.296, abs=4 * 0.041 / passenger.sum() ** 0.5)
    assert tau[passenger].std() == pytest.approx(0.88 * 0.041, rel=0.03)
    assert np.abs(tau[passenger] - 0.296).max() < 2.001 * 0.041


def test_advised_speeds_do_what_the_accelerations_of_their_law_do(twin):
    state = after(twin, [{"penetration": 1.0, "inflow": 800.0}] * 8, 200)
    lesson = twin.lesson("speed")
    params = jax.tree.map(jnp.asarray, EcoProblem()([{"penetration": 1.0, "inflow": 800.0}])[1][0])
    seen = jax.jit(twin.observe)(state, params)
    assert seen.acting.sum() > 16
    share = jax.random.uniform(jax.random.key(0), (*seen.acting.shape, 1))
    law = lesson.law
    told = law.scale * share + law.gain * seen.obs[..., [law.feature]]
    told = jnp.clip(told, jnp.array(law.box.low), jnp.array(law.box.high))
    when = state.steps * twin.dt, params.green

    def driven(world, *actions):
        speeds = jax.jit(world._speeds)
        return [speeds(state, action[..., 0].T, *when)[0] for action in actions]

    by_speed, otherwise = driven(lesson, share, 1.0 - share)
    np.testing.assert_allclose(by_speed, *driven(twin, told), atol=1e-4)
    assert float(jnp.abs(by_speed - otherwise).max()) > 1.0


# ---- what it is taught by ------------------------------------------------------------------------


@pytest.mark.parametrize("speed", [3.5, 7.0, 14.0])
def test_speeds_of_a_trip_add_up_to_its_length_so_the_papers_reward_hardly_asks_for_them(speed):
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


def test_each_reward_is_given_to_agents_only():
    twin, params = get_cmdp("eco-green", engine="jax").trainer.problem([{"green": 20.0}])
    shapes = jax.eval_shape(twin.start, jnp.arange(1, dtype=jnp.uint32), params)
    state = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), shapes)
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
