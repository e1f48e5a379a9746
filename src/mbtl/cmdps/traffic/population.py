"""Who drives on the eco-driving road, and when they come (cmdp-spec, 6.1).

Arrivals are Poisson on each feeder; a car is controlled with probability `penetration`. Controlled
cars are alike. Human drivers differ: the reference draws them from 2000 calibrated samples; here
each parameter is drawn by itself from a normal distribution with the mean and the standard
deviation of the samples, cut at 2 standard deviations: the last whole number that keeps every gap
positive (the cut leaves 0.88 of the standard deviation). Cars and light trucks share drivers, as
in the reference; trucks and buses have others.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.special import ndtr, ndtri

from mbtl.arrays import Array
from mbtl.cmdps.traffic.corridor import FEEDERS, ROADS, SHARES


class Driver(NamedTuple):
    """IDM of one car: metres, seconds."""

    min_gap: float
    tau: float
    accel: float
    decel: float


class Kind(NamedTuple):
    """A kind of vehicle: its share of the fleet, its length [m] and its drivers."""

    share: float
    length: float
    mean: Driver
    std: Driver


CUT = 2.0
"""Standard deviations at which the distributions end."""

_CARS = (Driver(2.20, 0.296, 0.744, 1.66), Driver(0.18, 0.041, 0.007, 0.08))
_TRUCKS = (Driver(1.30, 0.57, 0.746, 1.54), Driver(0.55, 0.14, 0.007, 0.22))

FLEET = {
    "car": Kind(0.425, 5.0, *_CARS),
    "light truck": Kind(0.472, 6.0, *_CARS),
    "truck": Kind(0.099, 7.1, *_TRUCKS),
    "bus": Kind(0.0035, 12.0, *_TRUCKS),
}
"""Of human drivers; the shares are made to add up to 1."""

CONTROLLED = Driver(min_gap=2.0, tau=1.0, accel=2.6, decel=4.5)
CONTROLLED_LENGTH = 5.0
DEPART_SPEED = 5.0


class Car(NamedTuple):
    """One car of an episode.

    Attributes:
        id: "car0", "car1", ... in the order of departure.
        feeder: "AB" or "AA".
        depart: when it wants to enter [s].
        controlled: whether it is an agent.
    """

    id: str
    feeder: str
    depart: float
    controlled: bool
    length: float
    driver: Driver


def truncated(rng: np.random.Generator, shape: tuple[int, ...]) -> Array:
    """Standard normal draws within `CUT`, by inversion: one uniform number each."""
    low = float(ndtr(-CUT))
    draws: Array = ndtri(rng.uniform(low, 1.0 - low, shape))
    return draws


def population(
    rng: np.random.Generator, inflow: float, penetration: float, seconds: float
) -> list[Car]:
    """The cars of one episode, in the order of departure.

    Args:
        rng: where all draws come from.
        inflow: cars per hour, both feeders together.
        penetration: probability that a car is controlled.
        seconds: until when cars come.
    """
    arrivals = [
        (time, feeder)
        for feeder in FEEDERS
        for time in _poisson(rng, inflow * SHARES[feeder] / 3600.0, seconds)
    ]
    n = len(arrivals)
    controlled = rng.random(n) < penetration
    kinds = list(FLEET.values())
    shares = np.array([kind.share for kind in kinds])
    which = rng.choice(len(kinds), n, p=shares / shares.sum())
    means, stds = np.array([k.mean for k in kinds]), np.array([k.std for k in kinds])
    drivers = means[which] + stds[which] * truncated(rng, (n, len(Driver._fields)))
    return [
        Car(f"car{k}", feeder, time, True, CONTROLLED_LENGTH, CONTROLLED)
        if controlled[k]
        else Car(f"car{k}", feeder, time, False, kinds[which[k]].length, Driver(*drivers[k]))
        for k, (time, feeder) in enumerate(sorted(arrivals))
    ]


def routes(cars: list[Car]) -> str:
    """XML of the cars: a vehicle type each, because a driver is one.

    Nobody exceeds the limit or dawdles: the speed factor is 1 without spread, and IDM has no noise.
    """
    ways = "".join(f'<route id="{f}" edges="{f} {" ".join(ROADS)}"/>' for f in FEEDERS)
    rows = "".join(
        f'<vType id="{car.id}" carFollowModel="IDM" length="{car.length:g}" '
        f'minGap="{car.driver.min_gap:.6f}" tau="{car.driver.tau:.6f}" '
        f'accel="{car.driver.accel:.6f}" decel="{car.driver.decel:.6f}" '
        'speedFactor="1" speedDev="0"/>'
        f'<vehicle id="{car.id}" type="{car.id}" route="{car.feeder}" depart="{car.depart:.3f}" '
        f'departSpeed="{DEPART_SPEED:g}"/>'
        for car in cars
    )
    return f"<routes>{ways}{rows}</routes>"


def _poisson(rng: np.random.Generator, rate: float, seconds: float) -> list[float]:
    """Arrival times in 0..seconds: given their number, they are uniform."""
    times: list[float] = np.sort(rng.uniform(0.0, seconds, rng.poisson(rate * seconds))).tolist()
    return times
