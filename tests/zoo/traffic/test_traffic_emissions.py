import numpy as np
import pytest

pytest.importorskip("gymnasium")

from mbtl.zoo.cmdps.traffic.eco import co2_rate, fuel_rate, power

IDLE = 7.8e-4 * 2350  # g/s


def test_a_standing_car_idles():
    assert power(0.0, 0.0) == 0.0
    assert co2_rate(0.0, 0.0) == pytest.approx(IDLE)


def test_the_closed_form_at_ten_metres_per_second():
    assert power(10.0, 0.0) == pytest.approx((237.2 + 17.85) * 10 / 3312)
    needed = (237.2 + 17.85 + 3278 * 2) * 10 / 3312  # 20.56 kW
    assert power(10.0, 2.0) == pytest.approx(needed)
    litres = 7.8e-4 + 1.956e-5 * needed + 1e-6 * needed**2
    assert fuel_rate(10.0, 2.0) == pytest.approx(litres)
    assert co2_rate(10.0, 2.0) == pytest.approx(3.772, abs=1e-3)


def test_braking_costs_no_more_than_idling():
    assert power(10.0, -3.0) < 0
    assert co2_rate(10.0, -3.0) == pytest.approx(IDLE)


def test_arrays_give_what_numbers_give():
    speeds, pushes = np.array([0.0, 5.0, 14.0]), np.array([1.0, -2.0, 0.5])
    each = [co2_rate(v, a) for v, a in zip(speeds.tolist(), pushes.tolist(), strict=True)]
    assert co2_rate(speeds, pushes) == pytest.approx(each)
