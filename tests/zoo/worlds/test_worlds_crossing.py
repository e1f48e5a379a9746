"""The signal's twin by itself: Krauss's rules, who comes, and that company changes nothing."""

from dataclasses import replace
from operator import itemgetter

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mbtl.engine.learners.episodic.episodes import Actor
from mbtl.engine.learners.evaluation import evaluate, own_measures
from mbtl.zoo.cmdps.traffic import signal
from mbtl.zoo.cmdps.traffic.signal import cell_of
from mbtl.zoo.cmdps.traffic.twins import SignalProblem
from mbtl.zoo.worlds.traffic import crossing as coming
from mbtl.zoo.worlds.traffic.crossing import CrossingTwin, Krauss

DRIVER = Krauss(1.0, 4.5, 0.5)
SEEDS = np.array([[0, 1, 2]], np.uint32)
EPISODES = jnp.arange(400, dtype=jnp.uint32)
START, STEP, DRIVE = (
    jax.jit(method, static_argnums=0)
    for method in (CrossingTwin.start, CrossingTwin.step, CrossingTwin.drive)
)


def crossings(*contexts):
    """A small twin and the parameters of four contexts in it; tests share its programs."""
    twin, each = SignalProblem()(contexts)
    return replace(twin, few=(), rows=24), jax.tree.map(lambda *x: jnp.stack(x), *each)


def played(twin, params, seeds, phase_of, decisions):
    """The state after so many decisions; `phase_of` maps the number of a decision to a phase."""
    state = START(twin, jnp.asarray(seeds, jnp.uint32), params)
    for k in range(decisions):
        state = STEP(twin, state, jnp.full((4, 1), phase_of(k)), params).state
    return state


@pytest.fixture(scope="module")
def blocked():
    """Four crossings where only left turns of two roads ever have green, after 240 decisions."""
    demand = ((100.0, 200.0), (100.0, 60.0), (1000.0, 200.0), (100.0, 200.0))
    twin, params = crossings(*({"inflow": n, "length": length} for n, length in demand))
    return twin, params, played(twin, params, [3, 3, 1, 4], lambda k: 1, 240)


def test_who_is_able_to_stop_comes_to_rest_within_the_metres_and_has_its_speed_at_a_turn():
    for speed in (0.0, 0.7, 4.5, 9.9, 14.0, 25.0):
        metres = float(DRIVER.metres(jnp.float32(speed))) + speed  # a step of reaction before
        assert float(DRIVER.able_to_stop(jnp.float32(metres + 0.01))) >= speed
        assert float(DRIVER.able_to_stop(jnp.float32(metres - 0.01))) < speed + 0.01
    v, left = 14.0, 100.0
    while left > 0.0:
        v = min(v + 1.0, 14.0, float(DRIVER.slowing(jnp.float32(left), jnp.float32(6.51))))
        left -= v
    assert v == pytest.approx(6.51, abs=0.01)


@pytest.mark.parametrize("crowded", [None, False, True])
def test_departures_are_those_of_the_environment_in_distribution(crowded):
    mode = () if crowded is None else (jnp.full(400, int(crowded)),)
    found = np.asarray(
        coming.departures(
            jnp.arange(400, dtype=jnp.uint32), jnp.full(400, 300.0), 512, 5400.0, *mode
        )
    )
    assert (found[300:] == coming.NEVER).all()
    assert (np.diff(found[:300], axis=0) >= 0.0).all()
    rng = np.random.default_rng(0)
    mine = np.array([signal.departures(rng, 300, 5400, crowded=crowded) for _ in range(400)])
    for share in (0.1, 0.5, 0.9, 0.99):
        ours, theirs = found[int(300 * share)], mine[:, int(300 * share)]
        error = np.hypot(ours.std(), theirs.std()) / 20.0
        assert abs(ours.mean() - theirs.mean()) < 4.0 * error


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
    plan = jax.jit(coming.plan, static_argnums=(2, 3))
    plan = np.asarray(plan(EPISODES[:50], jnp.float32(1000.0), 1024, most, 5400.0, 0.75))
    there = plan < coming.NEVER
    assert (there.sum(axis=(0, 1)) == 1000).all()
    right = there & (plan % 1.0 > 0.0)
    lanes = there.sum(axis=0).reshape(4, 4, -1)
    assert right.sum(axis=0).reshape(4, 4, -1)[:, 1:].sum() == 0
    assert right.sum() == pytest.approx(50 * 125, rel=0.03)
    assert lanes[:, coming.LEFT].sum() == pytest.approx(50 * 125, rel=0.03)
    assert (np.ptp(lanes[:, : coming.LEFT], axis=1) <= 5).mean() > 0.95


def test_a_lane_without_green_holds_its_cars_before_the_line(blocked):
    _, _, state = blocked
    queues = jax.tree.map(np.asarray, state.queues)
    east_west = [lane for lane in range(16) if lane // 4 in (0, 2)]
    x, entered = queues.x[:, east_west, 0], np.asarray(state.entered)[east_west, 0]
    cars = x > -1.0
    assert (cars.sum(axis=0) == entered).all()
    assert x.max() < 200.0
    front = x.max(axis=0)[entered > 0]
    assert np.median(200.0 - front) == pytest.approx(1.0, abs=0.2)
    gaps = -np.diff(x, axis=0)[cars[1:] & (queues.v[1:, east_west, 0] < 0.1)]
    assert gaps.min() > 7.4


def test_whoever_never_has_green_loses_all_the_time_since_its_departure(blocked):
    twin, _, state = blocked
    plan = np.asarray(state.plan)[..., 1]
    due = np.where(plan < coming.NEVER, np.floor(plan), np.nan)
    closed = [lane for lane in range(16) if lane not in (7, 15)]
    longest = np.nansum(np.maximum(float(state.time[1]) - due[:, closed], 0.0))
    served = 60.0 * np.isfinite(due[:, [7, 15]]).sum()
    assert np.asarray(state.entered)[:, 1].sum() < 100  # the roads are full
    lost = float(twin.delay(state)[1]) * 100.0
    assert 0.97 * longest < lost < longest + served  # but for the way to the queue


def test_a_jam_ends_the_episode(blocked):
    twin, params, state = blocked
    assert bool(twin.over(state)[2])
    assert float(twin.score(state)[2]) <= twin.jam
    assert float(state.time[2]) < 5400.0
    again = STEP(twin, state, jnp.full((4, 1), 0), params)
    assert float(twin.score(again.state)[2]) == float(twin.score(state)[2])


def test_waiting_is_booked_as_the_environment_defines_it_and_cells_show_where_cars_are():
    twin, params = crossings(*[{"inflow": 100.0}] * 3, {"length": 300.0})
    state, total = START(twin, jnp.arange(3, 7, dtype=jnp.uint32), params), 0.0
    for k in range(120):
        moved = STEP(twin, state, jnp.full((4, 1), (k // 4) % 4), params)
        x = np.asarray(moved.state.queues.x)[..., 0]
        on = (x > -1.0) & (x <= 750.0)
        waited = float((np.asarray(moved.state.queues.waited)[..., 0] * on).sum())
        assert float(moved.reward[0, 0]) == pytest.approx(float(state.waiting[0]) - waited)
        state, total = moved.state, total + waited
    assert float(twin.waiting(state)[0]) == pytest.approx(total / 5400.0, rel=1e-5)
    paper = replace(twin, scored="paper")
    assert float(paper.score(state)[0]) == -float(twin.waiting(state)[0])
    assert float(twin.score(state)[0]) == -float(twin.delay(state)[0])
    assert float(state.time[0]) == 120 * 10 + 29 * 4
    seen = np.asarray(twin.observe(state, params).obs)[3, 0].reshape(8, 10)
    x, edges = np.asarray(state.queues.x)[:, :, 3], np.array(twin.cells) * 300.0 / 750.0
    expected = np.zeros((8, 10))
    for place in range(16):
        cars = x[(x[:, place] > -1.0) & (x[:, place] <= 300.0), place]
        expected[2 * (place // 4) + (place % 4 == 3), cell_of(300.0 - cars, edges)] = 1.0
    assert expected.sum() > 5
    np.testing.assert_array_equal(seen, expected)


@pytest.mark.long
def test_lights_of_its_own_need_no_policy():
    twin, params = crossings(*[{"inflow": 300.0}] * 4)
    twin = replace(twin, total_seconds=1800)
    empty, delays = START(twin, EPISODES[:4], params), {}
    for way in twin.ways:
        one, state = replace(twin, way=way), empty
        for _ in range(180):
            state = DRIVE(one, state, params).state
        delays[way] = np.asarray(one.delay(state))
    # 66 s of red in a cycle of 96 s for seven of eight, 86 s for the others; and drivers dawdle
    by_chance = (0.875 * 66.0**2 + 0.125 * 86.0**2) / (2.0 * 96.0)
    assert by_chance < delays["fixed_time"].mean() < by_chance + 6.0
    assert (delays["actuated"] < 0.85 * delays["fixed_time"]).all()


def test_an_episode_is_the_same_in_any_company():
    contexts = [{"inflow": n, "length": 200.0} for n in (200.0, 900.0, 500.0, 1000.0)]
    scores = []
    for order, seeds in (((0, 1, 2, 3), (3, 7, 9, 11)), ((1, 1, 3, 0), (7, 5, 6, 2))):
        twin, params = crossings(*(contexts[i] for i in order))
        scores.append(np.asarray(twin.score(played(twin, params, seeds, lambda k: k % 3, 40))))
    assert scores[0][1] == scores[1][0] != scores[1][1]
