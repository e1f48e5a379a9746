"""The eco-driving twin: closed forms, bookkeeping of cars and agents, and random arrivals."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

pytest.importorskip("jax", reason="the jax extra is not installed")
pytest.importorskip("pettingzoo", reason="the traffic extra is not installed")

import mbtl.engine.learners as engine  # noqa: F401  isort: skip  # before jax: it sets jax's flags
import jax
import jax.numpy as jnp

from mbtl.errors import ContextMismatch
from mbtl.zoo.cmdps.traffic.eco import co2_rate, light
from mbtl.zoo.cmdps.traffic.twins import EcoProblem
from mbtl.zoo.worlds.traffic import lane
from mbtl.zoo.worlds.traffic.eco import EcoParams, Light
from mbtl.zoo.worlds.traffic.lane import Ahead, Cars, Incomer

CAR = {"length": 5.0, "min_gap": 2.0, "tau": 1.0, "accel": 2.6, "decel": 4.5}


def cars(speed, x=None):
    speed = jnp.array(speed, jnp.float32)[:, None]
    rows = {name: jnp.full(speed.shape, value) for name, value in CAR.items()}
    none = jnp.zeros(speed.shape, jnp.int32)
    x = jnp.zeros(speed.shape) if x is None else jnp.array(x, jnp.float32)[:, None]
    return Cars(x=x, speed=speed, controlled=none, **rows)


def ahead(gap, speed, there=True):
    return Ahead(jnp.array([[gap]]), jnp.array([[speed]]), jnp.array(there))


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


@pytest.fixture(scope="module")
def small():
    """Four agents at most, and long rows only."""
    twin = EcoProblem(agents=4)([{}])[0]
    return replace(twin, few=())


# ---- car-following -------------------------------------------------------------------------------


def test_a_free_car_at_the_limit_keeps_it_and_a_resting_one_starts_in_two_inner_steps():
    v = lane.follow(cars([14.0, 0.0]), ahead(1.0, 1.0, there=False), 2.0, 14.0, 0.5)
    first = 0.25 * 2.6
    second = first + 0.25 * 2.6 * (1.0 - (first / 14.0) ** 4)
    np.testing.assert_allclose(v[:, 0], [14.0, second], rtol=1e-5)


def test_at_the_equilibrium_gap_a_car_keeps_its_speed():
    v = 8.0
    gap = (2.0 + v) / np.sqrt(1.0 - (v / 14.0) ** 4)
    found = lane.follow(cars([v]), ahead(gap, v), 2.0, 14.0, 0.5)
    assert float(found[0, 0]) == pytest.approx(v, rel=1e-6)


@pytest.mark.parametrize(
    ("left", "can", "gap"),
    [(30.0, True, 29.0), (9.0, True, 8.75), (8.8, True, 8.7), (8.0, False, 7.9)],
)
def test_a_car_stops_a_metre_before_the_line_or_nearer_if_it_must(left, can, gap):
    # at 10 m/s, with 4.5 m/s^2 in steps of 0.5 s: 0.5 (7.75 + 5.5 + 3.25 + 1) = 8.75 m
    stops, stop = lane.halt(cars([10.0]), jnp.array([[left]]), 0.5)
    assert bool(stops[0, 0]) == can
    assert float(stop.gap[0, 0]) == pytest.approx(gap)


def test_a_car_that_rests_before_its_stop_closes_what_is_left():
    me = cars([0.0, 0.0, 3.0])
    v = lane.halting(me, jnp.array([[0.0], [0.0], [2.0]]), jnp.array([[0.2], [0.009], [0.5]]), 0.5)
    np.testing.assert_allclose(v[:, 0], [(0.2 - 0.001) / 0.5, 0.0, 1.0], rtol=1e-5)


def test_a_car_enters_behind_another_only_where_it_has_room():
    new = Cars(*(field[0] for field in cars([5.0])))
    wish = 2.0 + 5.0 * 1.0  # as fast as the last car
    for gap, room in ((wish + 0.1, True), (wish - 0.1, False)):
        last = cars([5.0], x=[100.0])
        found = lane.room(last, jnp.array([0]), 95.0 - gap, 5.0, new)
        assert bool(found[0]) == room


# ---- bookkeeping ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("gone", "between", "last", "found"),
    [
        (False, None, None, [4.0, 3.0, 2.0, 0.0, 0.0]),
        (True, None, None, [3.0, 2.0, 0.0, 0.0, 0.0]),
        (False, 1, None, [4.0, 9.0, 3.0, 2.0, 0.0]),
        (True, 1, None, [3.0, 9.0, 2.0, 0.0, 0.0]),
        (True, 2, 3, [3.0, 2.0, 9.0, 7.0, 0.0]),
        (False, 0, 4, [9.0, 4.0, 3.0, 2.0, 7.0]),
    ],
)
def test_rows_move_up_and_make_way(gone, between, last, found):
    def comes(row, car):
        return Incomer(jnp.array([row is not None]), jnp.array([row or 0]), (jnp.array([car]),))

    rows = (jnp.array([[4.0], [3.0], [2.0], [0.0], [0.0]]),)
    new = lane.shifted(rows, (0.0,), jnp.array([gone]), comes(last, 7.0), comes(between, 9.0))
    assert new[0][:, 0].tolist() == found


def test_cars_stay_in_order_and_no_car_is_lost(twin):
    state = after(twin, [{"inflow": 1600.0, "penetration": 0.5}] * 8, 1000)
    x = np.asarray(state.main.x)
    there = x > 0.5 * lane.EMPTY
    assert (np.diff(x, axis=0)[there[1:]] < 0.0).all()
    assert (np.diff(there.astype(int), axis=0) <= 0).all()  # no hole
    on_road = there.sum(axis=0) + (np.asarray(state.side.x) > 0.5 * lane.EMPTY).sum(axis=0)
    gone = np.asarray(state.entered).sum(axis=0) - on_road
    uncounted = gone - np.asarray(state.totals.completed)
    assert ((uncounted >= 0) & (uncounted < 25)).all()  # those of the warm-up
    assert there.sum(axis=0).max() > twin.few[0][0]  # long rows were in use


@pytest.mark.long
def test_rows_that_nobody_needs_change_nothing(twin, small):
    short, long = (after(each, [{}] * 8, 400) for each in (twin, small))
    np.testing.assert_allclose(short.main.x, long.main.x, atol=0.01)
    assert (np.asarray(short.main.x[0]) > 0.0).any()


@pytest.mark.long
def test_agents_are_the_foremost_controlled_cars_in_the_region(small):
    state = after(small, [{"penetration": 1.0}] * 8, 300)
    rows, x = np.asarray(state.row), np.asarray(state.main.x)
    for i in range(8):
        inside = np.flatnonzero(x[:, i] > 0.0)
        places = (int(state.first[i]) + np.arange(4)) % 4
        agents = [row for row in rows[places, i] if row >= 0]
        assert agents == inside[:4].tolist()
        assert np.asarray(state.trip.place)[agents, i].tolist() == places[: len(agents)].tolist()
    assert (rows >= 0).sum() > 8


@pytest.mark.long
def test_an_agent_that_is_told_to_brake_does_and_pays_for_it(twin):
    contexts = [{"penetration": 1.0}] * 8
    state, (params, *_) = after(twin, contexts, 300), EcoProblem()(contexts)[1]
    acting = np.asarray(twin.observe(state, params).acting)
    moved = jax.jit(twin.step)(state, jnp.full((8, twin.agents, 1), -3.0), params)
    i, place = np.nonzero(acting & ~np.asarray(moved.done))
    assert len(i) > 20
    before = np.asarray(state.main.speed)[np.asarray(state.row)[place, i], i]
    now = np.asarray(twin.observe(moved.state, params).obs)[i, place, 0] * 15.0
    slower = np.maximum(before - 1.5, 0.0)
    assert (now <= slower + 1e-4).all()
    assert np.mean(np.abs(now - slower) < 1e-4) > 0.8  # the others follow someone
    grams = co2_rate(now, (now - before) / 0.5) * 0.5
    paid = (now - 35.0 * np.maximum(0.0, 1.0 - now) - 3.0 * grams) / 15.0
    reward = np.asarray(moved.reward)
    np.testing.assert_allclose(reward[i, place], paid, atol=1e-4)
    assert (reward[~acting] == 0.0).all()


def test_every_context_is_another_task_and_contexts_do_not_mix(twin):
    contexts = [{}, {"penetration": 1.0}, {"inflow": 1600.0}, {"green": 5.0}]
    mixed = np.asarray(twin.score(after(twin, contexts + [{}] * 4, 1500)))
    alone = np.asarray(twin.score(after(twin, [{"inflow": 1600.0}] * 8, 1500)))
    assert len(set(mixed.tolist())) == 8
    assert mixed[3] < mixed[2] < mixed[0]  # a short green, and a jam, are slow
    assert alone[2] == pytest.approx(mixed[2], abs=0.02)


@pytest.mark.parametrize("context", [{"green": 0.0}, {"penetration": 0.0}, {"penetration": 1.5}])
def test_an_impossible_context_is_refused(context):
    with pytest.raises(ContextMismatch):
        EcoProblem()([context])


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
    for time in np.arange(0.0, 160.0, 0.5):
        seen = [float(x) for x in ours.seen(jnp.float32(green), jnp.float32(time))]
        assert seen[:3] == np.eye(3)[theirs.phase(time)].tolist()
        assert seen[3:] == pytest.approx(theirs.changes(time))
        side = ours.side(jnp.float32(green), jnp.float32(time))
        assert bool(side) == (green + 3.0 <= time % theirs.cycle < green + 38.0)


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
    twin = replace(twin, few=())  # one length of rows to compile instead of three
    lesson = twin.lesson("speed")
    params = jax.tree.map(jnp.asarray, EcoProblem()([{"penetration": 1.0, "inflow": 800.0}])[1][0])
    seen = jax.jit(twin.observe)(state, params)
    assert seen.acting.sum() > 16
    share = jax.random.uniform(jax.random.key(0), (*seen.acting.shape, 1))
    law = lesson.law
    told = law.scale * share + law.gain * seen.obs[..., [law.feature]]
    told = jnp.clip(told, jnp.array(law.box.low), jnp.array(law.box.high))
    by_speed = jax.jit(lesson.step)(state, share, params).state
    by_law = jax.jit(twin.step)(state, told, params).state
    np.testing.assert_allclose(by_speed.main.speed, by_law.main.speed, atol=1e-4)
    alone = jax.jit(twin.drive)(state, params).state
    assert float(jnp.abs(by_speed.main.speed - alone.main.speed).max()) > 1.0
