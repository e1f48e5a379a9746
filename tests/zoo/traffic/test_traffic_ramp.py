import numpy as np
import pytest
from played import begun

from mbtl.errors import InvalidInput
from mbtl.zoo.cmdps.traffic import advisory
from mbtl.zoo.cmdps.traffic.ramp import RampAcc, RampVel


@pytest.fixture
def make(opened):
    return lambda kind=RampVel, hold=10.0, **options: opened(kind({"hold": hold}, **options))


def test_one_car_in_ten_that_enter_the_main_road_is_advised(make):
    env = begun(make())
    entered = []
    for _ in range(4):
        road = env.simulation.api.vehicle.getIDList()
        entered += [car for car in env.possible_agents if car in road and car not in entered]
        first = env.possible_agents.index(entered[0])
        there = [car for car in env.agents if env.possible_agents.index(car) >= first]
        assert len(there) >= 2
        places = [entered.index(car) for car in there]
        assert {place % 10 for place in places} == {places[0] % 10}  # every tenth that found room
        env.step({})
    assert 0 < len(env.agents) <= env.most_agents


def test_unguided_traffic_is_slow_and_an_episode_ends_after_the_measured_part(make):
    env = begun(make(hold=40.0))
    steps = advisory.hold_steps(40.0)
    for decision in range(10):
        agents, before = set(env.agents), set(env.simulation.api.vehicle.getIDList())
        observations, rewards, terminated, truncated, infos = env.step({})
        assert agents <= set(rewards) == set(observations)
        assert len({rewards[car] for car in agents}) == 1  # one reward for all
        last = decision == 9
        if not last:  # some enter and leave within the hold
            left = before - set(env.simulation.api.vehicle.getIDList())
            assert 0 <= next(iter(rewards.values())) * steps - len(left) < 4
        assert all(terminated[car] or truncated[car] for car in rewards) == last
    assert env.agents == []
    info = next(iter(infos.values()))
    assert info["collided"] == 0
    assert 2.5 < info["score"] < 4.5  # the spec's stored 3.93; see the docs for the difference
    with pytest.raises(InvalidInput, match="reset"):
        env.step({})


def test_each_car_that_collides_costs_fifty_and_stands_wherever_it_is(make, monkeypatch):
    monkeypatch.setattr(advisory, "UNMEASURED", 0)
    env = begun(make(hold=2.0))
    vehicle = env.simulation.api.vehicle
    speeds = {car: vehicle.getSpeed(car) for car in vehicle.getIDList()}
    blind = next(
        car for car in speeds
        if vehicle.getLeader(car, 50.0) and car not in env.agents and speeds[car] > 2.0
    )  # fmt: skip
    leader = vehicle.getLeader(blind, 50.0)[0]
    for car, speed in ((blind, 13.0), (leader, 0.0)):
        vehicle.setSpeedMode(car, 0)  # no check of safety
        vehicle.setSpeed(car, speed)
    collided, total = 0, 0.0
    there = set(vehicle.getIDList())
    while env.agents and not collided:
        rewards = env.step({})[1]
        collided = env._collided
        total = next(iter(rewards.values()))
    gone = there - set(vehicle.getIDList())
    assert {blind, leader} <= gone
    assert collided >= 2
    steps = advisory.hold_steps(2.0)
    left = total * steps + 50.0 * collided
    assert left == pytest.approx(round(left))
    assert 0 <= left < 5
    seen, drivers, before = [], env._drivers.step, env._means
    monkeypatch.setattr(env._drivers, "step", lambda *a: seen.append(drivers(*a)) or seen[-1])
    env.step({})
    expected = sum(sum(speeds) / (len(speeds) + collided) for speeds in seen)
    assert env._means - before == pytest.approx(expected)


def test_the_observation_shows_the_cars_around(make):
    env = make(noise=0.0, visibility="multiplier")
    observations, _ = env.reset(seed=0)
    vehicle = env.simulation.api.vehicle
    for car, observation in observations.items():
        assert env.observation_space(car).contains(observation)
        distance, speed, gap, leader_speed = (observation[:4] + 1) / 2 * [500, 30, 500, 30]
        assert speed == pytest.approx(vehicle.getSpeed(car), abs=1e-4)
        if vehicle.getRoadID(car) == "main":
            assert distance == pytest.approx(500 - vehicle.getLanePosition(car), abs=1e-3)
            leader, net = vehicle.getLeader(car, 500.0)
            assert leader_speed == pytest.approx(vehicle.getSpeed(leader), abs=1e-4)
            assert gap == pytest.approx(net + advisory.MIN_GAP + advisory.LENGTH, abs=1e-3)
        assert observation[8] == 10.0  # the multiplier: ten times the unit, 1 s


def test_an_advised_car_takes_the_advice(make):
    slow, fast = make(hold=2.0, noise=0.0), make(RampAcc, hold=2.0, noise=0.0)
    slow.reset(seed=0)
    car = slow.agents[-1]
    before = slow.simulation.api.vehicle.getSpeed(car)
    slow.step({car: 0})
    assert slow.simulation.api.vehicle.getSpeed(car) == pytest.approx(before - 3.0, abs=1e-6)
    slow.close()
    fast.reset(seed=0)
    fast.step({car: np.array([-0.5])})
    assert fast.simulation.api.vehicle.getSpeed(car) == pytest.approx(before - 1.5, abs=1e-6)
