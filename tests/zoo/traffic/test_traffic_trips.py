from types import SimpleNamespace

import pytest

pytest.importorskip("gymnasium")

from mbtl.zoo.cmdps.traffic.eco import Region, Trip, co2_rate


class Road:
    """A simulation of which only lanes and speeds are known; rearmost cars first, as in SUMO."""

    def __init__(self):
        self.lanes = {f"{road}_0": [] for road in ("AB", "AA", "approach", "box", "exit")}
        self.speeds, self.pending = {}, []
        self.lane = SimpleNamespace(
            getLastStepVehicleIDs=self.lanes.get,
            getLastStepVehicleNumber=lambda lane: len(self.lanes[lane]),
            getLastStepMeanSpeed=lambda lane: (
                sum(map(self.speeds.get, self.lanes[lane])) / max(len(self.lanes[lane]), 1)
            ),
        )
        self.simulation = SimpleNamespace(getPendingVehicles=lambda: self.pending)
        self.vehicle = SimpleNamespace(getSpeed=self.speeds.get, getAcceleration=lambda car: 0.0)


def test_a_trip_counts_a_stop_once_until_the_car_has_driven_again():
    trip = Trip()
    for speed in (5.0, 0.05, 0.2, 0.0, 0.0, 2.0, 0.0):
        trip.move(speed, 0.0)
    assert trip.stops == 2
    assert trip.mean_speed == pytest.approx(7.25 / 7)
    assert trip.co2_sum == pytest.approx(7 * trip.co2, rel=0.01)


def test_the_foremost_car_comes_first():
    road, region = Road(), Region()
    road.lanes |= {"approach_0": ["d", "c"], "exit_0": ["b", "a"]}
    road.speeds.update(dict.fromkeys("abcd", 10.0))
    region.update(road)
    assert list(region.present) == ["a", "b", "c", "d"]
    assert region.roads == [["a", "b"], [], ["c", "d"]]


def test_the_summary_is_a_mean_over_cars_that_went_through_and_count():
    road, region = Road(), Region()
    lane = road.lanes["approach_0"]
    lane.append("early")
    road.speeds.update(early=1.0, fast=12.0, slow=4.0)
    region.update(road)
    region.begin()
    lane[:] = ["fast", "slow"]
    region.update(road)
    region.update(road)
    lane.remove("fast")  # after two steps, 12 m
    road.speeds["slow"] = 0.0
    region.update(road)
    nobody_else = region.summary(seconds=1.5)
    lane.remove("slow")  # after three steps, 4 m
    lane.append("late")  # still there in the end: not counted
    road.speeds["late"] = 9.0
    region.update(road)
    summary = region.summary(seconds=2.0)
    assert nobody_else["trip_speed"] == pytest.approx(12.0)
    assert summary["trip_speed"] == pytest.approx((12.0 + 8.0 / 3.0) / 2.0)
    assert summary["stops"] == 0.5
    assert summary["completed"] == 2
    assert summary["throughput"] == pytest.approx(2 / 2.0 * 3600.0)
    fast, braking = co2_rate(12.0, 0.0), co2_rate(0.0, -8.0)
    slow = 2 * co2_rate(4.0, 0.0) + braking
    assert summary["co2"] == pytest.approx((2 * fast + slow) * 0.5 / 2.0)


def test_the_mean_speed_is_of_all_cars_and_whoever_waits_to_enter_stands():
    road, region = Road(), Region()
    road.lanes["AB_0"].append("before")
    road.speeds["before"] = 14.0
    region.update(road)
    region.begin()
    road.lanes["AB_0"][:] = ["a", "b"]
    road.lanes["exit_0"].append("c")
    road.speeds.update(a=6.0, b=0.0, c=12.0)
    road.pending += ["d", "e"]
    region.update(road)
    road.pending.clear()
    region.update(road)
    assert region.summary(seconds=1.0)["mean_speed"] == pytest.approx(36.0 / (5 + 3))


def test_without_a_completed_trip_all_is_nought():
    assert set(Region().summary(seconds=1.0).values()) == {0.0}
