import numpy as np
import pytest

pytest.importorskip("libsumo")

from mbtl.zoo.cmdps.traffic.eco import (
    CONTROLLED,
    CUT,
    FLEET,
    Driver,
    population,
    routes,
    truncated,
)


def draw(inflow=36_000.0, penetration=0.2, seconds=1000.0, seed=0):
    return population(np.random.default_rng(seed), inflow, penetration, seconds)


def test_arrivals_are_as_many_as_the_inflow_says_nine_in_ten_straight_on():
    cars = draw()
    assert len(cars) == pytest.approx(10_000, abs=400)  # 4 standard deviations of Poisson
    assert np.mean([car.feeder == "AB" for car in cars]) == pytest.approx(0.9, abs=0.012)
    times = [car.depart for car in cars]
    assert times == sorted(times)
    assert times[0] >= 0.0
    assert times[-1] <= 1000.0


def test_gaps_between_arrivals_are_exponential():
    gaps = np.diff([car.depart for car in draw() if car.feeder == "AB"])
    assert gaps.std() == pytest.approx(gaps.mean(), rel=0.05)


def test_penetration_is_the_share_of_controlled_cars():
    cars = draw()
    assert np.mean([car.controlled for car in cars]) == pytest.approx(0.2, abs=0.016)
    assert {car.driver for car in cars if car.controlled} == {CONTROLLED}
    assert all(car.controlled for car in draw(inflow=400, penetration=1.0))


def test_the_fleet_is_mixed_as_given():
    lengths = np.array([car.length for car in draw() if not car.controlled])
    total = sum(kind.share for kind in FLEET.values())
    for kind in FLEET.values():
        assert np.mean(lengths == kind.length) == pytest.approx(kind.share / total, abs=0.025)


def test_drivers_have_the_means_of_their_kind_and_positive_parameters():
    cars = [car for car in draw() if not car.controlled]
    for length, name in ((5.0, "car"), (6.0, "light truck")):
        kind = FLEET[name]
        drivers = np.array([car.driver for car in cars if car.length == length])
        assert drivers.mean(axis=0) == pytest.approx(np.array(kind.mean), rel=0.03)
        assert (np.abs(drivers - kind.mean) <= CUT * np.array(kind.std) + 1e-12).all()
    assert min(min(car.driver) for car in cars) > 0.0


def test_draws_are_normal_up_to_the_cut():
    draws = truncated(np.random.default_rng(0), (20_000,))
    assert np.abs(draws).max() <= CUT
    assert draws.mean() == pytest.approx(0.0, abs=0.03)
    assert draws.std() == pytest.approx(0.880, abs=0.015)  # sqrt(1 - 2 c pdf(c) / (2 cdf(c) - 1))


def test_a_seed_gives_the_same_cars_and_every_car_is_in_the_demand():
    assert draw(inflow=400) == draw(inflow=400) != draw(inflow=400, seed=1)
    xml = routes(draw(inflow=400))
    assert xml.count("<vehicle ") == xml.count("<vType ") == len(draw(inflow=400))
    assert Driver._fields == ("min_gap", "tau", "accel", "decel")
