"""What the eco-driving twin is made of: its constants, its contexts and its state.

Notation as in `mbtl.worlds.traffic.eco`.
"""

from __future__ import annotations

from typing import NamedTuple

import jax

from mbtl.worlds.traffic.arrivals import Car
from mbtl.worlds.traffic.lane import Cars


class EcoParams(NamedTuple):
    """One context, or one per simulation.

    Attributes:
        penetration: probability that a car is controlled; a scalar or (n,), as the next two.
        inflow: cars per hour.
        green: [s].
        visible: (v,) or (n, v) features appended to each observation.
    """

    penetration: jax.Array
    inflow: jax.Array
    green: jax.Array
    visible: jax.Array


class Trip(NamedTuple):
    """What is kept of each car of `main`, (rows, n), beside how it drives.

    Attributes:
        side: it comes from the side feeder; int32, 0 or 1.
        place: of the agent; -1: it drives by itself.
        steps: in the region.
        distance: driven there [m].
        co2: emitted there [g].
        stops: there.
        moving: it has been fast since its last stop; int32, 0 or 1.
        counts: it was not in the region in the warm-up; int32, 0 or 1.
    """

    side: jax.Array
    place: jax.Array
    steps: jax.Array
    distance: jax.Array
    co2: jax.Array
    stops: jax.Array
    moving: jax.Array
    counts: jax.Array


class Totals(NamedTuple):
    """Sums over completed cars, (n,): those that came after the warm-up and have left the region.

    The last two are over all cars and the steps after the warm-up.

    Attributes:
        completed: cars.
        speed: of their mean speeds [m/s].
        co2: [g].
        stops: stops.
        speeds: of all cars on the road, step by step [m/s].
        cars: all that were on the road or had waited to enter it, step by step.
    """

    completed: jax.Array
    speed: jax.Array
    co2: jax.Array
    stops: jax.Array
    speeds: jax.Array
    cars: jax.Array


class EcoState(NamedTuple):
    """n roads.

    Attributes:
        main: cars of the straight feeder and the region.
        trip: of the same cars.
        side: cars of the side feeder.
        due: (2, n) when the next car of each feeder wants to enter [s].
        waiting: that car, (2, n).
        entered: (2, n) cars that have entered.
        inflow: (n,) cars per hour that want to.
        row: (A, n) where in `main` each agent is; -1: nobody has the place.
        first: (n,) place of the foremost agent.
        totals: what the measures are made of.
        seed: (n,) uint32.
        steps: simulation steps since the warm-up began.
    """

    main: Cars
    trip: Trip
    side: Cars
    due: jax.Array
    waiting: Car
    entered: jax.Array
    inflow: jax.Array
    row: jax.Array
    first: jax.Array
    totals: Totals
    seed: jax.Array
    steps: jax.Array


class Road(NamedTuple):
    """Positions of the road, in metres from the ghost light.

    Attributes:
        feeders: lengths of the straight and the side feeder.
        line: the stop line of the main light.
        box: end of the box.
        end: of the region.
        limit: speed limit [m/s].
        entry_speed: [m/s].
    """

    feeders: tuple[float, float]
    line: float
    box: float
    end: float
    limit: float
    entry_speed: float


class Costs(NamedTuple):
    """Reward of an agent: (v - crawling max(0, crawl - v) - co2 E) / scale, E in g per step."""

    crawl: float
    crawling: float
    co2: float
    scale: float


class Stops(NamedTuple):
    """A stop: slower than the first [m/s] after having been faster than the second."""

    halted: float
    moving: float


class Look(NamedTuple):
    """How an agent sees: divisors of speeds, lengths and times, and who is not there."""

    speed: float
    length: float
    time: float
    absent: tuple[float, float, float, float]
