"""SUMO moves the cars of the eco-driving road as `zoo.cmdps.traffic.eco` says, step by step."""

import math
from typing import NamedTuple

import numpy as np
import pytest

pytest.importorskip("libsumo")

from mbtl.zoo.cmdps.traffic.eco import (
    FEEDERS,
    LIMIT,
    STEP,
    Car,
    corridor,
    light,
    population,
    routes,
)
from mbtl.zoo.cmdps.traffic.simulation import Simulation

ROADS = {"AB": (-246.0, 0.0), "AA": (-242.8, 0.0), "approach": (0.0, 235.6), "box": (235.6, 250.0),
         "exit": (250.0, 485.6)}  # fmt: skip
REGION = ["approach", "box", "exit"]


class Seen(NamedTuple):
    car: Car
    road: str
    x: float
    v: float

    @property
    def tail(self):
        return self.x - self.car.length

    def leads_on(self, road):
        """Whether the car, or its tail, is on the road."""
        route = [self.car.feeder, *REGION]
        if road not in route:
            return False
        start, end = ROADS[road]
        return self.road == road or (self.x > end and start < end and self.tail < end)


def idm(driver, v, gap, leader, min_gap=0.0):
    for _ in range(2):
        closing = v * (v - leader) / (2.0 * math.sqrt(driver.accel * driver.decel))
        wish = min_gap + max(0.0, v * driver.tau + closing)
        push = 1.0 - (v / LIMIT) ** 4 - (wish / max(gap, 1e-3)) ** 2
        v = max(0.0, v + driver.accel * push * STEP / 2)
        gap -= max(0.0, (v - leader) * STEP / 2)
    return v


def phase_of(signal, road, time):
    if road == "AA":
        within = time % signal.cycle - signal.green - 3.0
        return 2 if within < 0 else 0 if within < 35.0 else 1
    return signal.phase(time)


def stop(driver, v, left):
    """Speed before a light that is not green, `left` metres away; None: the car drives on."""
    b = max(driver.decel, 3.0)
    n = int(v / (b * STEP))
    braking = STEP * (n * v - b * STEP * n * (n + 1) / 2)
    if left < braking:
        return None
    gap = max(0.0, left - max(0.1, min(1.0, left - braking)))
    if gap < 0.01:
        return 0.0
    speed = idm(driver, v, gap, 0.0)
    if v < 1e-3 and speed < 1e-3:
        speed = (gap - 1e-3) / STEP
    return min(speed, gap / STEP)


def next_speed(me, cars, signal, time, target):
    driver, v = me.car.driver, me.v
    bound = idm(driver, v, 1e6, LIMIT)
    ahead = [me.road, *REGION] if me.road in FEEDERS else REGION[REGION.index(me.road) :]
    for road in ahead[:2] if me.road in FEEDERS else ahead:
        leaders = [c for c in cars if c is not me and c.leads_on(road) and c.x > me.x]
        if leaders:
            leader = min(leaders, key=lambda c: c.tail)
            gap = leader.tail - me.x
            bound = min(bound, idm(driver, v, gap, leader.v, driver.min_gap))
        if road in (*FEEDERS, "approach") and phase_of(signal, road, time):
            halt = stop(driver, v, ROADS[road][1] - me.x)
            if halt is not None:
                bound = min(bound, halt)
                break
    if target is not None:
        bound = max(min(bound, target), v - STEP * driver.decel)
    return max(bound, v - STEP * 9.0, 0.0)


def enters(car, cars):
    """Whether there is room for a car on its feeder."""
    driver = car.driver
    last = min((c for c in cars if c.road == car.feeder), key=lambda c: c.x, default=None)
    if last is None:
        return True
    wish = 5.0 * driver.tau + 5.0 * (5.0 - last.v) / (2.0 * math.sqrt(driver.accel * driver.decel))
    gap = last.tail - (ROADS[car.feeder][0] + car.length + 0.1)
    return gap >= driver.min_gap + max(0.0, wish)


@pytest.mark.parametrize(
    ("inflow", "green", "controlled"),
    [(400.0, 35.0, 0.0), (400.0, 35.0, 0.5), (1000.0, 5.0, 0.2), (2000.0, 50.0, 0.1)],
)
def test_sumo_moves_cars_as_the_module_says(inflow, green, controlled):
    rng = np.random.default_rng(0)
    signal = light(green)
    everyone = {car.id: car for car in population(rng, inflow, max(controlled, 1e-9), 300.0)}
    waiting = {f: [c for c in everyone.values() if c.feeder == f] for f in FEEDERS}
    simulation = Simulation(corridor(signal), step_length=STEP)
    simulation.start(routes(list(everyone.values())), 0)
    cars, moves, wrong = [], 0, []
    with simulation.guard() as api:
        for k in range(600):
            targets = {}
            for me in cars:
                if me.car.controlled and me.road in REGION and rng.random() < 0.7:
                    target = min(max(me.v + STEP * rng.normal(0.0, 3.0), 0.0), LIMIT)
                    targets[me.car.id] = target
                    api.vehicle.slowDown(me.car.id, target, 0.0)
            expected = {
                me.car.id: next_speed(me, cars, signal, k * STEP, targets.get(me.car.id))
                for me in cars
            }
            before = {me.car.id: me for me in cars}
            api.simulationStep()
            cars = [
                Seen(everyone[id], road, start + api.vehicle.getLanePosition(id), speed)
                for road, (start, _) in ROADS.items()
                for id in api.lane.getLastStepVehicleIDs(f"{road}_0")
                for speed in [api.vehicle.getSpeed(id)]
            ]
            for me in cars:
                if me.car.id in before:
                    moves += 1
                    assert me.x == pytest.approx(before[me.car.id].x + STEP * me.v, abs=1e-6)
                    if abs(me.v - expected[me.car.id]) > 1e-3:
                        wrong.append((k, me, expected[me.car.id]))
            for feeder, queue in waiting.items():
                new = [me for me in cars if me.car.id not in before and me.car.feeder == feeder]
                old = [me for me in cars if me.car.id in before]
                due = bool(queue) and queue[0].depart <= k * STEP
                assert len(new) == (due and enters(queue[0], old)), (k, feeder)
                if new:
                    assert new[0].car is queue.pop(0)
                    assert new[0].v == 5.0
                    assert new[0].x == pytest.approx(ROADS[feeder][0] + new[0].car.length + 0.1)
    simulation.close()
    assert moves > 4000
    # where the jam stands across the ghost signal, cars of AA overlook tails of AB
    allowed = 0 if inflow < 2000.0 else moves // 1000
    assert len(wrong) <= allowed, wrong[:3]
