"""What the ramp twin is made of: its constants and its state.

Notation as in `mbtl.worlds.traffic.ramp`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp

from mbtl.worlds.traffic.lane import EMPTY


class Queue(NamedTuple):
    """Cars that follow one another, (rows, n); row 0 is the foremost, rows behind the last EMPTY.

    Attributes:
        x: front [m], 0 at the zipper.
        speed: [m/s].
        desired: v0 [m/s].
        told: advised speed [m/s] or acceleration [m/s^2]; infinite: it drives by itself.
        car: int32, its number among those that entered the main road; RAMP_CAR, or NO_CAR.
    """

    x: jax.Array
    speed: jax.Array
    desired: jax.Array
    told: jax.Array
    car: jax.Array


RAMP_CAR, NO_CAR = -1, -2
EPSILON = 0.1  # metres: SUMO lets tails enter, and fronts leave, that far from a road's end

VACANT = Queue(EMPTY, 0.0, 1.0, jnp.inf, NO_CAR)
"""Fields of a row without a car."""


def empty(rows: int, n: int) -> Queue:
    """No cars."""
    return Queue(*(jnp.full((rows, n), value) for value in VACANT))


def there(queue: Queue) -> jax.Array:
    """(rows, n) whether there is a car."""
    return queue.car != NO_CAR


class Look(NamedTuple):
    """What the advised drivers see.

    Attributes:
        car: (A, n) number of the car of each place; NO_CAR: nobody has it.
        raw: (8, A, n) in metres and m/s.
    """

    car: jax.Array
    raw: jax.Array


class Counts(NamedTuple):
    """Sums over the measured steps, (n,), but `collided`: over all of them.

    Attributes:
        steps: so many.
        speed: means over the cars [m/s].
        left: cars that reached the end.
        wanted: cars whose last chance to enter came.
        missed: those of them that found no room.
        collided: cars.
    """

    steps: jax.Array
    speed: jax.Array
    left: jax.Array
    wanted: jax.Array
    missed: jax.Array
    collided: jax.Array


class Held(NamedTuple):
    """What happened since the last decision.

    Attributes:
        reward: (n,) sum.
        early: what was seen after the first step.
        car: (A, n) who was told.
    """

    reward: jax.Array
    early: Look
    car: jax.Array


class RampState(NamedTuple):
    """n ramps.

    Attributes:
        main: cars on the main road before the zipper.
        side: cars from the ramp before the zipper.
        end: cars behind the zipper.
        waiting: (2, n) a car waits to enter the main road, the ramp.
        entered: (n,) cars that have entered the main road.
        counts: what score and measures are made of.
        look: at the last decision.
        seed: (n,) uint32.
        steps: simulation steps since the warm-up began.
    """

    main: Queue
    side: Queue
    end: Queue
    waiting: jax.Array
    entered: jax.Array
    counts: Counts
    look: Look
    seed: jax.Array
    steps: jax.Array


@dataclass(frozen=True)
class Roads:
    """Lengths in metres, speeds in m/s.

    Attributes:
        main: before the merge section.
        side: the ramp, likewise.
        merge: section in which the two lanes run side by side.
        end: behind the zipper.
        gaps: from the end of either merge lane to the start of the end, as the crow flies.
        limit: speed limit.
    """

    main: float
    side: float
    merge: float
    end: float
    gaps: tuple[float, float]
    limit: float

    def lane(self, k: int) -> float:
        """From the start of the main road, or of the ramp, to the zipper."""
        return (self.main, self.side)[k] + self.merge

    def entry(self, k: int, car: float) -> float:
        """Where the front of a car of that length is that has entered."""
        return car + EPSILON - self.lane(k)


@dataclass(frozen=True)
class Flow:
    """Cars that come evenly spaced; in simulation steps.

    Attributes:
        first: when the first one comes.
        every: between two.
        patience: steps in which a car that finds no room tries again, before it is dropped.
        speed: at which it enters [m/s].
    """

    first: int
    every: int
    patience: int
    speed: float

    def comes(self, step: jax.Array) -> jax.Array:
        """Whether a car comes in this step."""
        since = step - self.first
        return (since >= 0) & (since % self.every == 0)
