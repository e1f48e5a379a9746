from functools import partial

import numpy as np
import pytest
from played import begun, played

from mbtl.errors import ContextMismatch, InvalidInput, UnknownName
from mbtl.problems import get_cmdp
from mbtl.zoo.cmdps.traffic import signal
from mbtl.zoo.cmdps.traffic.signal import CELLS, SCORES, Signal, cell_of

FIXED_TIME = (0, 0, 0, 1, 2, 2, 2, 3)  # 30 s for the through traffic, 10 s for the left turns


@pytest.fixture
def make(opened):
    return lambda context=None, **options: opened(Signal(context, **options))


def episode(env, phases, seed=0):
    """(decisions, return, info) of an episode that repeats `phases`."""
    env.reset(seed=seed)
    decisions, total = 0, 0.0
    while True:
        _, reward, terminated, truncated, info = env.step(phases[decisions % len(phases)])
        decisions, total = decisions + 1, total + reward
        if terminated or truncated:
            return decisions, total, info


# ---- closed form -------------------------------------------------------------------------------


def test_cells_scale_with_the_length_of_the_road():
    near_and_far = np.array([0.0, 6.9, 7.0, 399.0, 400.0, 750.0])
    assert cell_of(near_and_far, CELLS).tolist() == [0, 0, 1, 8, 9, 9]
    assert cell_of(near_and_far / 2, CELLS / 2).tolist() == [0, 0, 1, 8, 9, 9]


@pytest.mark.parametrize("n", [2, 50, 1000])
def test_departures_fill_the_episode_with_whole_seconds(n):
    times = signal.departures(np.random.default_rng(0), n, 5400)
    assert times.shape == (n,)
    assert (np.diff(times) >= 0).all()
    assert (times == np.rint(times)).all()
    assert times[0] >= 0
    assert times[-1] <= 5400


def test_the_two_modes_of_demand_are_as_probable_as_they_are_said_to_be():
    largest = np.random.default_rng(1).weibull(signal.SHAPE, (2000, 1000)).max(axis=1)
    assert signal.crowded_share(1000) == pytest.approx(0.1161, abs=1e-4)
    assert (largest > 3).mean() == pytest.approx(0.1161, abs=3 * (0.1 / 2000) ** 0.5)

    plain = [signal.departures(np.random.default_rng(s), 1000, 5400) for s in range(40)]
    crowds = [np.random.default_rng(s).weibull(signal.SHAPE, 1000).max() > 3 for s in range(40)]
    for crowded in (False, True):
        told = [
            signal.departures(np.random.default_rng(s), 1000, 5400, crowded=crowded)
            for s in range(40)
        ]
        same = [np.array_equal(*pair) for pair in zip(plain, told, strict=True)]
        assert same == [crowd == crowded for crowd in crowds]
        mean = np.mean(told) / 5400  # that of Weibull(2) over 3, or over 4
        assert mean == pytest.approx(0.886 / (4 if crowded else 3), rel=0.03)


def test_an_episode_plays_the_mode_that_it_is_told(make):
    env = make({"inflow": 2500.0})
    assert sum(env.strata) == pytest.approx(1.0)
    assert env.strata[1] == pytest.approx(0.2654, abs=1e-4)
    with pytest.raises(InvalidInput, match="stratum is 0"):
        env.reset(seed=0, options={"stratum": 2})
    delays = []
    for stratum in (0, 1):
        env.reset(seed=3, options={"stratum": stratum})
        for _ in range(12):
            env.step(0)
        delays.append(env._delay)
    assert delays[1] > 1.3 * delays[0]  # in two minutes, of cars that come earlier


def test_three_quarters_go_straight_and_turns_go_both_ways():
    ways = signal.directions(np.random.default_rng(0), 20_000)
    turns = [(signal.APPROACHES.index(b) - signal.APPROACHES.index(a)) % 4 for a, b in ways]
    shares = np.bincount(turns, minlength=4) / len(ways)
    assert shares == pytest.approx([0.0, 0.125, 0.75, 0.125], abs=0.01)


# ---- the intersection --------------------------------------------------------------------------


def test_decisions_are_between_386_and_540(make):
    env = make({"inflow": 50}, jam=-np.inf)
    assert episode(env, (0,))[0] == 540  # the green never changes
    assert episode(env, (0, 2))[0] == 386  # it always does


def test_a_fixed_time_signal_serves_the_nominal_demand(make):
    decisions, total, info = episode(make(), FIXED_TIME)
    assert decisions == 451
    assert total == 0.0  # rewards are differences: nobody waited before, nobody waits at the end
    assert info["score"] == -info["delay"]
    assert 5.7 < info["waiting"] < 13.5  # the range of the paper's raw waiting
    # 66 s of red in a cycle of 96 s for seven of eight, 86 s for the others; and drivers dawdle
    by_chance = (0.875 * 66.0**2 + 0.125 * 86.0**2) / (2.0 * 96.0)
    assert by_chance < info["delay"] < by_chance + 6.0
    assert info["not_inserted"] == info["collisions"] == 0


def test_the_delay_is_what_sumo_says_cars_lose_and_what_they_wait_to_enter(make):
    env = begun(make({"inflow": 2000, "length": 40}))  # on so short a road some wait outside
    lost, outside = {}, 0
    original = env.simulation.api.simulationStep

    def watched(time):
        nonlocal outside
        original(time)
        api = env.simulation.api
        outside += len(api.simulation.getPendingVehicles())
        for car in api.vehicle.getIDList():
            if "_in" in api.vehicle.getRoadID(car):
                lost[car] = api.vehicle.getTimeLoss(car)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(env.simulation.api, "simulationStep", watched)
        for k in range(80):
            env.step(FIXED_TIME[k % 8])
    assert outside > 0
    assert len(lost) > 30
    assert env._delay * 2000 == pytest.approx(sum(lost.values()) + outside, rel=0.03)


def test_lights_of_sumos_own_stand_beside_policies(make):
    def alone(way):
        env = begun(make({"inflow": 500}))
        return played(lambda: env.follow(way))[-1][4]

    *_, decided = episode(make({"inflow": 500}), FIXED_TIME)
    fixed, actuated = alone("fixed_time"), alone("actuated")
    assert fixed["delay"] == pytest.approx(decided["delay"])  # the same lights, second by second
    assert actuated["delay"] < 0.8 * fixed["delay"]
    env = begun(make({"inflow": 500}))
    with pytest.raises(UnknownName, match="Did you mean 'actuated'"):
        env.follow("actuatd")


def test_yellow_comes_before_another_green_only(make):
    env = begun(make())
    times = []
    for phase in (0, 0, 1, 1, 3):
        env.step(phase)
        times.append(env.simulation.api.simulation.getTime())
    assert times == [10, 20, 34, 44, 58]
    state = env.simulation.api.trafficlight.getRedYellowGreenState("centre")
    assert state.count("G") == 2  # one left turn from the west and one from the east
    assert set(state) == {"G", "r"}


def test_roads_are_those_of_the_context_and_the_limit_is_the_same_for_everybody(make):
    env = begun(make({"length": 150, "speed": 5.5}))
    lane, vehicle = env.simulation.api.lane, env.simulation.api.vehicle
    for name in ("W_in_0", "N_in_3", "S_out_1"):
        assert (lane.getLength(name), lane.getMaxSpeed(name)) == (pytest.approx(150.0), 5.5)
    for phase in FIXED_TIME * 10:
        env.step(phase)
    cars = vehicle.getIDList()
    assert len(cars) > 10
    assert {vehicle.getSpeedFactor(car) for car in cars} == {1.0}


def test_the_observation_is_where_the_cars_are(make):
    env = make({"length": 100}, visibility="multiplier", unit={"length": 500.0})
    observation, _ = env.reset(seed=1)
    assert observation.tolist() == pytest.approx([0.0] * 80 + [0.2])
    for _ in range(40):
        observation = env.step(0)[0]
    api = env.simulation.api
    expected = np.zeros((4, 2, 10))
    for car in api.vehicle.getIDList():
        lane = api.vehicle.getLaneID(car)
        if "_in_" in lane:
            ahead = 100.0 - api.vehicle.getLanePosition(car)
            cell = int(cell_of(np.array([ahead]), CELLS * (100 / 750))[0])
            expected["WNES".index(lane[0]), int(lane[-1] == "3"), cell] = 1.0
    assert expected.any()
    np.testing.assert_array_equal(observation[:80], expected.reshape(-1))


def test_rewards_sum_to_minus_the_waiting_of_those_who_are_still_there(make):
    env = begun(make({"inflow": 500}))
    total = sum(env.step(0)[1] for _ in range(60))
    vehicle = env.simulation.api.vehicle
    waiting = sum(
        vehicle.getAccumulatedWaitingTime(car)
        for car in vehicle.getIDList()
        if "_in" in vehicle.getRoadID(car)
    )
    assert waiting > 0
    assert total == pytest.approx(-waiting)


# ---- jams --------------------------------------------------------------------------------------


def test_cars_that_block_each_other_at_the_stop_line_do_not_stop_the_traffic_for_good(make):
    # without the rule, 3,907 with 599 cars outside, and the queue never moves again
    _, _, info = episode(make({"length": 30}), FIXED_TIME)
    assert info["missed_turns"] > 0
    assert info["not_inserted"] == 0
    assert info["waiting"] < 50.0


def test_a_jam_ends_the_episode_and_no_score_is_clipped(make):
    # those of the other axis wait from their arrival on
    paper = partial(make, {"inflow": 200}, score="paper")
    decisions, _, whole = episode(paper(jam=-np.inf), (0,))
    assert decisions == 540
    assert whole["waiting"] > 1000.0
    assert whole["score"] == -whole["waiting"]
    assert not whole["jammed"]
    assert whole["mean_queue"] > 40.0
    decisions, _, cut = episode(paper(), (0,))
    assert decisions < 540
    assert cut["jammed"]
    assert cut["score"] == -cut["waiting"]
    assert 1000.0 == -SCORES["paper"].jam <= cut["waiting"] < whole["waiting"]


@pytest.mark.parametrize("score", SCORES)
def test_a_score_at_the_floor_is_told_as_soon_as_it_is_there(make, score):
    env, lowest = begun(make({"inflow": 200}, score=score)), SCORES[score].lowest
    outcomes = played(lambda: (*env.step(0), env._score))
    told = [info.get("final_score") for *_, info, _ in outcomes]
    scores = [now for *_, now in outcomes]
    assert told == [one if one <= lowest else None for one in scores]
    assert None in told
    assert len(told) - told.count(None) > 10
    signal = get_cmdp("signal-inflow", score=score)
    assert signal.normalisation.normalise(min(t for t in told if t)) == 0.0
    assert (signal.floor, signal.version) == (lowest, 4)


def test_a_jam_is_no_terminal_state_unless_the_end_of_time_is_one(make):
    for time_limit, expected in (("truncation", (False, True)), ("terminal", (True, False))):
        env = begun(make({"inflow": 50}, jam=-1e-9, time_limit=time_limit))
        assert played(lambda env=env: env.step(0))[-1][2:4] == expected


def test_every_car_enters_the_shortest_road_that_is_allowed(make, capfd):
    speed = 5.0
    stop = signal.stopping_distance(signal.entry_speed(speed))
    with pytest.raises(ContextMismatch, match=f"{stop:g} m"):
        Signal({"length": stop, "speed": speed})
    _, _, info = episode(make({"length": stop + 0.1, "speed": speed, "inflow": 300}), FIXED_TIME)
    assert info["not_inserted"] == 0
    assert capfd.readouterr().err == ""  # SUMO writes there about every car that it drops


def test_braking_takes_whole_seconds():
    # one second at 10 m/s, then 5.5 and 1, behind a car of 5 m that stands 0.1 m into the road
    assert signal.stopping_distance(10.0) == pytest.approx(5.1 + 10.0 + 5.5 + 1.0)
    assert signal.stopping_distance(4.0) == pytest.approx(5.1 + 4.0)
