"""Trips through the eco-driving region: what scores and rewards are made of."""

from __future__ import annotations

from typing import Any

from mbtl.cmdps.traffic.corridor import FEEDERS, ROADS, STEP
from mbtl.cmdps.traffic.emissions import co2_rate

HALTED, MOVING = 0.1, 1.0
"""A stop: slower than the first [m/s] after having been faster than the second."""

_LANES = tuple(f"{road}_0" for road in reversed(ROADS))
_FEEDERS = tuple(f"{road}_0" for road in FEEDERS)


class Trip:
    """One car in the region so far.

    Attributes:
        speed: now [m/s].
        co2: of this step [g].
        steps, distance, co2_sum, stops: so far; the distance is the sum of speeds x step [m].
    """

    __slots__ = ("_moving", "co2", "co2_sum", "distance", "speed", "steps", "stops")

    def __init__(self) -> None:
        """The car is not in the region yet; its first `move` is its entry."""
        self.speed = self.co2 = self.co2_sum = self.distance = 0.0
        self.steps = self.stops = 0
        self._moving = False

    def move(self, speed: float, acceleration: float) -> None:
        """One step that ended at this speed."""
        self.speed = speed
        self.co2 = co2_rate(speed, acceleration) * STEP
        self.co2_sum += self.co2
        self.distance += speed * STEP
        self.steps += 1
        if speed > MOVING:
            self._moving = True
        elif speed < HALTED and self._moving:
            self.stops += 1
            self._moving = False

    @property
    def mean_speed(self) -> float:
        """Over the steps in the region [m/s]."""
        return self.distance / (self.steps * STEP)


class Region:
    """All trips of an episode, and what all cars do before and between them.

    Attributes:
        roads: cars on exit, box and approach; on each, the foremost first.
        present: their trips, in the same order: from the end of the region to its start.
        completed: trips that went through and count.
    """

    def __init__(self) -> None:
        """Empty."""
        self.roads: list[list[str]] = [[], [], []]
        self.present: dict[str, Trip] = {}
        self.completed: list[Trip] = []
        self._uncounted: frozenset[str] = frozenset()
        self._speeds, self._cars = 0.0, 0

    def begin(self) -> None:
        """The measurement begins: cars that are in the region are no trips that count."""
        self._uncounted = frozenset(self.present)
        self._speeds, self._cars = 0.0, 0

    def update(self, api: Any) -> None:
        """Read the state after a simulation step: a call per lane and a call per car."""
        ids, speed_of = api.lane.getLastStepVehicleIDs, api.vehicle.getSpeed
        before, after = self.present, {}
        self.roads = [ids(lane)[::-1] for lane in _LANES]
        for road in self.roads:
            for car in road:
                speed = speed_of(car)
                trip = before.pop(car, None)
                if trip is None:
                    trip = Trip()
                    acceleration = api.vehicle.getAcceleration(car)
                else:
                    acceleration = (speed - trip.speed) / STEP
                trip.move(speed, acceleration)
                after[car] = trip
        self.present = after
        for lane in _FEEDERS:
            cars = api.lane.getLastStepVehicleNumber(lane)
            self._speeds += cars * api.lane.getLastStepMeanSpeed(lane)
            self._cars += cars
        self._speeds += sum(trip.speed for trip in after.values())
        self._cars += len(after) + len(api.simulation.getPendingVehicles())
        self.completed += [trip for car, trip in before.items() if car not in self._uncounted]

    def summary(self, seconds: float) -> dict[str, float]:
        """Means over the completed trips, but for the first; 0 where there is none.

        Args:
            seconds: of the measurement.

        Returns:
            mean_speed: over all cars and steps, those outside the region too [m/s], where a car
            that waits to enter stands; trip_speed: in the region [m/s]; co2: [g] per car; stops:
            per car; throughput: cars per hour; completed: cars.
        """
        n = len(self.completed)
        share = 1.0 / n if n else 0.0
        return {
            "mean_speed": self._speeds / max(self._cars, 1),
            "trip_speed": share * sum(trip.mean_speed for trip in self.completed),
            "co2": share * sum(trip.co2_sum for trip in self.completed),
            "stops": share * sum(trip.stops for trip in self.completed),
            "throughput": 3600.0 * n / seconds,
            "completed": float(n),
        }
