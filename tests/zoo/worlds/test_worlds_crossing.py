"""The signal's twin by itself: Krauss's rules, who comes, and that company changes nothing."""

from dataclasses import replace
from operator import itemgetter

import numpy as np
import pytest

pytest.importorskip("jax", reason="the jax extra is not installed")
pytest.importorskip("gymnasium", reason="the envs extra is not installed")

import mbtl.engine.learners  # noqa: F401  isort: skip  # before jax: it sets jax's flags
import jax
import jax.numpy as jnp

from mbtl.engine.learners.episodic.episodes import Actor
from mbtl.engine.learners.evaluation import evaluate, own_measures
from mbtl.errors import ContextMismatch
from mbtl.zoo.cmdps.traffic import signal
from mbtl.zoo.cmdps.traffic.signal import cell_of
from mbtl.zoo.cmdps.traffic.twins import SignalProblem
from mbtl.zoo.worlds.traffic import crossing as coming
from mbtl.zoo.worlds.traffic import lane
from mbtl.zoo.worlds.traffic.crossing import VACANT, CrossingTwin, Krauss, Queues, _greens, moved_up

DRIVER = Krauss(1.0, 4.5, 0.5)
SEEDS = np.array([[0, 1, 2]], np.uint32)


BUSIEST = {"inflow": 2000.0}
START, STEP = (
    jax.jit(method, static_argnums=0) for method in (CrossingTwin.start, CrossingTwin.step)
)


def twin_at(**features):
    """A twin and the parameters of one context in it; all tests share its compiled programs."""
    twin, (params, _) = SignalProblem()([features, BUSIEST])
    return twin, params


def played(twin, params, seeds, phase_of, decisions):
    """The state after so many decisions; `phase_of` maps the number of a decision to a phase."""
    state = START(twin, jnp.asarray(seeds, jnp.uint32), params)
    for k in range(decisions):
        state = STEP(twin, state, jnp.full((len(seeds), 1), phase_of(k)), params).state
    return state


@pytest.mark.parametrize("speed", [0.0, 0.7, 4.5, 9.9, 14.0, 25.0])
def test_who_is_able_to_stop_comes_to_rest_within_the_metres(speed):
    metres = float(DRIVER.metres(jnp.float32(speed))) + speed  # a step of reaction before
    assert float(DRIVER.able_to_stop(jnp.float32(metres + 0.01))) >= speed
    assert float(DRIVER.able_to_stop(jnp.float32(metres - 0.01))) < speed + 0.01


def test_who_slows_for_a_turn_has_its_speed_at_the_line():
    v, left = 14.0, 100.0
    while left > 0.0:
        v = min(v + 1.0, 14.0, float(DRIVER.slowing(jnp.float32(left), jnp.float32(6.51))))
        left -= v
    assert v == pytest.approx(6.51, abs=0.01)


def test_luck_costs_half_an_acceleration_at_most():
    speed, most = jnp.float32(10.0), jnp.float32(14.0)
    fast, slow = (float(DRIVER.next_speed(speed, most, jnp.float32(u))) for u in (0.0, 1.0))
    assert (fast, slow) == (11.0, 10.5)


def test_departures_are_those_of_the_environment_in_distribution():
    seeds = jnp.arange(400, dtype=jnp.uint32)
    found = np.asarray(coming.departures(seeds, jnp.float32(300.0), 512, 5400.0))
    assert (found[300:] == coming.NEVER).all()
    assert (np.diff(found[:300], axis=0) >= 0.0).all()
    rng = np.random.default_rng(0)
    mine = np.array([signal.departures(rng, 300, 5400) for _ in range(400)])
    for share in (0.1, 0.5, 0.9):
        ours, theirs = found[int(300 * share)], mine[:, int(300 * share)]
        error = np.hypot(ours.std(), theirs.std()) / 20.0
        assert abs(ours.mean() - theirs.mean()) < 4.0 * error


def test_draws_of_one_mode_are_those_of_the_environment_in_distribution():
    seeds, cars = jnp.arange(400, dtype=jnp.uint32), jnp.full(400, 300.0)
    rng = np.random.default_rng(0)
    for crowded in (0, 1):
        modes = jnp.full(400, crowded)
        found = np.asarray(coming.departures(seeds, cars, 512, 5400.0, modes))
        mine = np.array(
            [signal.departures(rng, 300, 5400, crowded=crowded == 1) for _ in range(400)]
        )
        for share in (0.1, 0.5, 0.9, 0.99):
            ours, theirs = found[int(300 * share)], mine[:, int(300 * share)]
            error = np.hypot(ours.std(), theirs.std()) / 20.0
            assert abs(ours.mean() - theirs.mean()) < 4.0 * error
    assert float(coming.crowded_share(jnp.float32(300.0))) == pytest.approx(
        signal.crowded_share(300), rel=1e-4
    )


def test_an_evaluated_episode_is_one_of_each_mode_weighted_by_its_share():
    contexts = [{"inflow": 20.0}, {"inflow": 500.0}]
    twin, each = SignalProblem()(contexts)
    twin = replace(twin, total_seconds=1080, few=(), rows=24)  # a short and small program
    params = jax.tree.map(lambda *x: np.stack(x), *each)
    nobody = Actor((), jnp.zeros((1, 1)))
    found = evaluate(twin, nobody, params, [[0, 1, 2]] * 2, how="random")
    every, shares = twin.strata(params)
    modes = [jax.tree.map(itemgetter(k), every) for k in range(4)]
    alone = [
        own_measures(twin, "tanh", "random", nobody, SEEDS, mode)["score"][0] for mode in modes
    ]
    usual, crowded = np.array(alone[::2]), np.array(alone[1::2])
    assert np.allclose(shares[:, 1], [signal.crowded_share(n) for n in (20, 500)], rtol=1e-4)
    assert np.allclose(found[0], usual * shares[:, :1] + crowded * shares[:, 1:], rtol=1e-6)
    assert (crowded[1] < usual[1]).all()


def test_cars_come_on_lanes_of_their_turns_and_fill_them_evenly():
    most = coming.most_per_lane(1000, 0.75)
    plan = np.asarray(
        coming.plan(jnp.arange(50, dtype=jnp.uint32), jnp.float32(1000.0), 1024, most, 5400.0, 0.75)
    )
    there = plan < coming.NEVER
    assert (there.sum(axis=(0, 1)) == 1000).all()
    right = there & (plan % 1.0 > 0.0)
    lanes = there.sum(axis=0).reshape(4, 4, -1)
    assert right.sum(axis=0).reshape(4, 4, -1)[:, 1:].sum() == 0
    assert right.sum() == pytest.approx(50 * 125, rel=0.03)
    assert lanes[:, coming.LEFT].sum() == pytest.approx(50 * 125, rel=0.03)
    assert (np.ptp(lanes[:, : coming.LEFT], axis=1) <= 5).mean() > 0.95


def test_each_phase_has_its_lanes():
    west, north, east, south = range(0, 16, 4)
    lanes = [set(np.flatnonzero(shows)) for shows in _greens()]
    assert lanes[0] == {north, north + 1, north + 2, south, south + 1, south + 2}
    assert lanes[1] == {north + 3, south + 3}
    assert lanes[2] == {west, west + 1, west + 2, east, east + 1, east + 2}
    assert lanes[3] == {west + 3, east + 3}


def test_queues_move_up_when_cars_have_left():
    x = np.full((6, 16, 1), lane.EMPTY, np.float32)
    x[2:5, 0, 0] = 30.0, 20.0, 10.0
    x[:2, 1, 0] = 50.0, 40.0
    full = [np.full(x.shape, value, np.float32) for value in VACANT]
    found = np.asarray(moved_up(Queues(jnp.asarray(x), *map(jnp.asarray, full[1:])), 5).x)[:, :, 0]
    assert found[:4, 0].tolist() == [30.0, 20.0, 10.0, lane.EMPTY]
    assert found[:3, 1].tolist() == [50.0, 40.0, lane.EMPTY]


def test_a_lane_without_green_holds_its_cars_before_the_line():
    twin, params = twin_at(inflow=200.0)
    state = played(twin, params, [3], lambda k: 0, 200)
    queues = jax.tree.map(np.asarray, state.queues)
    east_west = [lane for lane in range(16) if lane // 4 in (0, 2)]
    x = queues.x[:, east_west]
    cars = x > -1.0
    entered = np.asarray(state.entered)[east_west]
    assert (cars.sum(axis=0) == entered).all()
    assert x.max() < 750.0
    front = x.max(axis=0)[entered > 0]
    assert np.median(750.0 - front) == pytest.approx(1.0, abs=0.2)
    gaps = -np.diff(x, axis=0)[cars[1:] & (queues.v[1:, east_west] < 0.1)]
    assert gaps.min() > 7.4


def test_waiting_is_booked_as_the_environment_defines_it():
    twin, params = twin_at(inflow=100.0)
    state, total = START(twin, jnp.asarray([3], jnp.uint32), params), 0.0
    for k in range(120):
        moved = STEP(twin, state, jnp.full((1, 1), (k // 4) % 4), params)
        x = np.asarray(moved.state.queues.x)
        on = (x > -1.0) & (x <= 750.0)
        waited = float((np.asarray(moved.state.queues.waited) * on).sum())
        assert float(moved.reward[0, 0]) == pytest.approx(float(state.waiting[0]) - waited)
        state, total = moved.state, total + waited
    assert float(twin.waiting(state)[0]) == pytest.approx(total / 5400.0, rel=1e-5)
    paper = replace(twin, scored="paper")
    assert float(paper.score(state)[0]) == -float(twin.waiting(state)[0])
    assert float(twin.score(state)[0]) == -float(twin.delay(state)[0])
    assert float(state.time[0]) == 120 * 10 + 29 * 4


def test_whoever_never_has_green_loses_all_the_time_since_its_departure():
    twin, params = twin_at(inflow=100.0, length=60.0)
    state = played(twin, params, [3], lambda k: 1, 400)  # green for left turns of two roads
    plan, entered = np.asarray(state.plan), np.asarray(state.entered)
    due = np.where(plan < coming.NEVER, np.floor(plan), np.nan)
    blocked = [lane for lane in range(16) if lane not in (7, 15)]
    until = np.asarray(state.time)
    longest = np.nansum(np.maximum(until - due[:, blocked], 0.0), axis=(0, 1))
    served = 60.0 * np.isfinite(due[:, [7, 15]]).sum(axis=(0, 1))
    assert (entered.sum(axis=0) < 100).all()  # the roads are full
    lost = np.asarray(twin.delay(state)) * 100.0
    assert (lost < longest + served).all()
    assert (lost > 0.97 * longest).all()  # but for the way to the queue


def test_lights_of_its_own_need_no_policy():
    twin, params = twin_at(inflow=300.0)
    twin = replace(twin, few=(), rows=16)  # one length of rows to compile
    empty = START(twin, jnp.arange(4, dtype=jnp.uint32), params)
    delays = {}
    for way in twin.ways:
        one = replace(twin, way=way)
        run = jax.jit(
            lambda state, one=one: jax.lax.fori_loop(
                0, 540, lambda _, s: one.drive(s, params).state, state
            )
        )
        delays[way] = np.asarray(one.delay(run(empty)))
    assert delays["fixed_time"].mean() == pytest.approx(26.1, abs=2.0)  # in SUMO 27.7 +- 0.5
    assert (delays["actuated"] < 0.8 * delays["fixed_time"]).all()


def test_an_episode_is_the_same_in_any_company():
    twin, params = twin_at(inflow=1500.0)
    alone = played(twin, params, [7], lambda k: k % 3, 80)
    one = jax.tree.map(lambda x: jnp.broadcast_to(x, (4, *x.shape)), params)
    crowd = played(twin, one, [3, 7, 9, 11], lambda k: k % 3, 80)
    assert float(twin.score(alone)[0]) == float(twin.score(crowd)[1])
    mixed = one._replace(inflow=jnp.asarray([200.0, 1500.0, 800.0, 2000.0]))
    mixed = played(twin, mixed, [3, 7, 9, 11], lambda k: k % 3, 80)
    assert float(twin.score(mixed)[1]) == pytest.approx(float(twin.score(alone)[0]), rel=1e-6)


def test_what_is_seen_are_the_cells_in_which_cars_are():
    twin, params = twin_at(length=300.0)
    state = played(twin, params, [5], lambda k: (k // 3) % 4, 60)
    seen = np.asarray(twin.observe(state, params).obs)[0, 0].reshape(8, 10)
    x = np.asarray(state.queues.x)[:, :, 0]
    edges = np.array(twin.cells) * 300.0 / 750.0
    expected = np.zeros((8, 10))
    for place in range(16):
        cars = x[(x[:, place] > -1.0) & (x[:, place] <= 300.0), place]
        expected[2 * (place // 4) + (place % 4 == 3), cell_of(300.0 - cars, edges)] = 1.0
    assert expected.sum() > 5
    np.testing.assert_array_equal(seen, expected)


def test_a_jam_ends_the_episode():
    twin, params = twin_at(inflow=2000.0)
    state = played(twin, params, [1], lambda k: 1, 500)
    assert bool(twin.over(state)[0])
    assert float(twin.score(state)[0]) <= twin.jam
    assert float(state.time[0]) < 5400.0
    again = STEP(twin, state, jnp.full((1, 1), 0), params)
    assert float(twin.score(again.state)[0]) == float(twin.score(state)[0])


@pytest.mark.parametrize("features", [{"length": 5.0}, {"inflow": 10.5}, {"inflow": 1.0}])
def test_what_is_no_intersection_is_refused(features):
    with pytest.raises(ContextMismatch, match=r"approach must hold|number of cars"):
        SignalProblem()([features])
