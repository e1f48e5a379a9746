import pytest
from played import begun

from mbtl.errors import InvalidInput
from mbtl.zoo.cmdps.traffic import eco
from mbtl.zoo.cmdps.traffic.eco import Eco, Trip


@pytest.fixture
def make(opened):
    return lambda context=None, **options: opened(Eco(context, **options))


def unguided(env, seed=0):
    """Measures of an episode in which every car drives by itself."""
    env.reset(seed=seed)
    while env.agents:
        env.step({})
    return env.summary


# ---- closed form -------------------------------------------------------------------------------


def test_the_reward_pays_for_speed_and_charges_for_crawling_and_emissions():
    cruising, standing = Trip(), Trip()
    cruising.move(14.0, 0.0)
    standing.move(0.0, 0.0)
    assert standing.co2 == pytest.approx(7.8e-4 * 2350 * 0.5)
    assert eco.reward(cruising) == pytest.approx((14.0 - 3 * cruising.co2) / 15)
    assert eco.reward(standing) == pytest.approx((0.0 - 35.0 - 3 * standing.co2) / 15)


# ---- traffic -----------------------------------------------------------------------------------


# Means of 5 seeds, measured: 9.4 nominal, 1.9 green 1 s, 10.7 green 50 s, 4.3 at 2000 cars/h,
# 10.6 at 40 cars/h, 10.8 where all cars drive as controlled ones do (they accelerate faster).
def test_traffic_without_control_is_slower_with_little_green_and_many_cars(make):
    nominal = unguided(make())
    assert 8.5 < nominal["trip_speed"] < 10.5
    assert 80 < nominal["co2"] < 150
    assert 0.2 < nominal["stops"] < 0.8
    assert 280 < nominal["throughput"] < 420  # 400 cars/h come, the last ones do not get through
    assert nominal["not_inserted"] == nominal["collisions"] == 0
    starved, crowded = unguided(make({"green": 1.0})), unguided(make({"inflow": 2000.0}))
    assert 0.5 < starved["trip_speed"] < 3.5
    assert 3.0 < crowded["trip_speed"] < 6.0
    for jam in (starved, crowded):
        assert jam["trip_speed"] < nominal["trip_speed"]
        assert jam["co2"] > 1.5 * nominal["co2"]
        assert jam["stops"] > nominal["stops"]
        assert jam["not_inserted"] > 0
    assert starved["throughput"] < 60 < nominal["throughput"] < crowded["throughput"]


def test_a_jam_beats_free_traffic_by_the_paper_s_score_and_never_by_the_default_one(make):
    """Who blocks the road after a minute is judged by the few cars that came through before."""
    context = {"green": 16.0, "penetration": 0.4}
    env = make(context)
    free = unguided(env)
    env.reset(seed=0)
    while env.agents:
        blocked = env._left < env.horizon - 120
        env.step({car: [-20.0] for car in env.agents} if blocked else {})
    jam = env.summary
    assert jam["throughput"] < 0.2 * free["throughput"]
    assert jam["trip_speed"] > free["trip_speed"] + 0.5
    assert jam["mean_speed"] < 0.3 * free["mean_speed"]
    assert (jam["score"], free["score"]) == (jam["mean_speed"], free["mean_speed"])
    paper = unguided(make(context, score="paper"))
    assert paper == {**free, "score": free["trip_speed"]}


def test_an_episode_ends_at_the_horizon_and_says_what_it_measured(make):
    for limit, name in (("truncation", 3), ("terminal", 2)):
        env = begun(make(horizon=120, time_limit=limit))
        while env.agents:
            out = env.step({})
        assert all(out[name].values())
        assert not any(out[5 - name].values())
        assert set(next(iter(out[4].values()))) >= {"score", "co2", "stops", "throughput"}
        with pytest.raises(InvalidInput, match="reset"):
            env.step({})


def test_an_episode_without_controlled_cars_is_over_after_reset_with_its_measures(make):
    env = make({"penetration": 1e-6})
    assert env.reset(seed=0) == ({}, {})
    assert env.agents == env.possible_agents == []
    assert env.summary["completed"] > 50
    with pytest.raises(InvalidInput, match="reset"):
        env.step({})


# ---- agents ------------------------------------------------------------------------------------


def test_agents_are_the_controlled_cars_in_the_region_and_are_terminated_as_they_leave(make):
    env = begun(make({"penetration": 1.0}))
    left = 0
    for _ in range(200):
        acting = list(env.agents)
        _, rewards, terminated, truncated, _ = env.step({})
        here = {
            car
            for road in ("approach", "box", "exit")
            for car in env.simulation.api.edge.getLastStepVehicleIDs(road)
        }
        assert set(env.agents) == here
        assert set(env.agents) <= set(env.possible_agents)
        assert {car for car in acting if terminated[car]} == set(acting) - here
        assert all(rewards[car] == 0.0 for car in set(acting) ^ here)
        assert not any(truncated.values())
        left += len(set(acting) - here)
    assert left > 5
