"""Parts of eco-driving: who comes, the light, what is emitted, and what is measured of a trip."""

from types import SimpleNamespace

import numpy as np
import pytest

from mbtl.zoo.cmdps.traffic import eco

# ---- who comes -----------------------------------------------------------------------------------


def draw(inflow=36_000.0, penetration=0.2, seconds=1000.0, seed=0):
    return eco.population(np.random.default_rng(seed), inflow, penetration, seconds)


def test_cars_are_as_many_as_the_inflow_says_and_of_the_fleet():
    cars = draw()
    assert len(cars) == pytest.approx(10_000, abs=400)  # 4 standard deviations of Poisson
    assert np.mean([car.feeder == "AB" for car in cars]) == pytest.approx(0.9, abs=0.012)
    times = [car.depart for car in cars]
    assert times == sorted(times)
    assert 0.0 <= times[0] <= times[-1] <= 1000.0
    assert np.mean([car.controlled for car in cars]) == pytest.approx(0.2, abs=0.016)
    assert {car.driver for car in cars if car.controlled} == {eco.CONTROLLED}
    others, total = [c for c in cars if not c.controlled], sum(k.share for k in eco.FLEET.values())
    for name, kind in eco.FLEET.items():
        own = [car for car in others if car.length == kind.length]
        assert len(own) / len(others) == pytest.approx(kind.share / total, abs=0.025)
        if name in ("car", "light truck"):
            drivers = np.array([car.driver for car in own])
            assert drivers.mean(axis=0) == pytest.approx(np.array(kind.mean), rel=0.03)
            assert (np.abs(drivers - kind.mean) <= eco.CUT * np.array(kind.std) + 1e-12).all()
    assert min(min(car.driver) for car in cars) > 0.0


def test_a_seed_gives_the_same_cars_and_every_car_is_in_the_demand():
    cars = draw(inflow=400, penetration=1.0)
    assert cars == draw(inflow=400, penetration=1.0) != draw(inflow=400, penetration=1.0, seed=1)
    assert all(car.controlled for car in cars)
    assert eco.routes(cars).count("<vehicle ") == eco.routes(cars).count("<vType ") == len(cars)


# ---- the light -----------------------------------------------------------------------------------


def test_the_signal_is_green_yellow_and_red_in_turn_and_counts_down_to_its_changes():
    signal = eco.light(35.0)
    assert signal.cycle == 76.0
    assert [signal.phase(t) for t in (0.0, 34.5, 35.0, 37.5, 38.0, 75.5, 76.0)] == [
        *(0, 0, 1, 1, 2, 2, 0)
    ]
    assert signal.changes(0.0) == (35.0, 76.0, 111.0)
    assert signal.changes(34.5) == (0.5, 41.5, 76.5)
    assert signal.changes(35.0) == (41.0, 76.0, 117.0)
    assert signal.changes(76.0 + 75.0) == (1.0, 36.0, 77.0)


# ---- what is emitted and measured ----------------------------------------------------------------


def test_the_closed_form_at_ten_metres_per_second():
    assert eco.power(10.0, 0.0) == pytest.approx((237.2 + 17.85) * 10 / 3312)
    needed = (237.2 + 17.85 + 3278 * 2) * 10 / 3312  # 20.56 kW
    assert eco.power(10.0, 2.0) == pytest.approx(needed)
    litres = 7.8e-4 + 1.956e-5 * needed + 1e-6 * needed**2
    assert eco.fuel_rate(10.0, 2.0) == pytest.approx(litres)
    assert eco.co2_rate(10.0, 2.0) == pytest.approx(3.772, abs=1e-3)
    assert eco.power(10.0, -3.0) < 0
    assert eco.co2_rate(10.0, -3.0) == pytest.approx(7.8e-4 * 2350)  # braking costs as idling


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


def test_who_was_there_before_is_no_trip_and_whoever_waits_to_enter_stands():
    """All else of a summary is what the twin measures, too."""
    road, region = Road(), eco.Region()
    road.lanes["AB_0"].append("behind")
    road.lanes["approach_0"].append("before")
    road.speeds.update(behind=14.0, before=14.0)
    region.update(road)
    region.begin()
    road.lanes["approach_0"].clear()
    road.lanes["AB_0"][:] = ["a", "b"]
    road.lanes["exit_0"].append("c")
    road.speeds.update(a=6.0, b=0.0, c=12.0)
    road.pending += ["d", "e"]
    region.update(road)
    road.pending.clear()
    region.update(road)
    summary = region.summary(seconds=1.0)
    assert summary["mean_speed"] == pytest.approx(36.0 / (5 + 3))
    assert summary["completed"] == 0
