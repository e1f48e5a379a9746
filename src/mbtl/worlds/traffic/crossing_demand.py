"""Who comes to the intersection of the signal twin, when and on which lane.

As `mbtl.cmdps.traffic.demand` draws them; lanes are those from which a car's turn is allowed, and
cars that go straight take the one on which the fewest have come so far.

Notation (shapes): n simulations, N cars of each at most, K of one lane, 16 lanes.
"""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp

from mbtl.worlds import random

APPROACHES, LANES = 4, 4
LEFT = LANES - 1
"""The lane of an approach from which cars turn left."""

_TIMES, _PLACES, _TURNS, _SIDES = range(4, 8)  # streams of random numbers

CROWDED = 3.0
"""A draw with a number beyond this comes within three quarters of the time, or less."""
_BEYOND = math.exp(-(CROWDED**2))  # luck of such a number

NEVER = 1e6
"""When a car departs that does not exist [s]."""


RIGHT = 0.25
"""Added to the second in which a car departs if it turns right: one number per car is enough."""


def most_per_lane(cars: int, straight: float) -> int:
    """K, so many that a lane gets more by luck of five deviations only."""
    share = (straight + 0.5 * (1.0 - straight)) / (APPROACHES * LEFT)
    mean = cars * max(share, 0.5 * (1.0 - straight) / APPROACHES)
    return math.ceil(mean + 5.0 * math.sqrt(mean)) + 4


def crowded_share(cars: jax.Array) -> jax.Array:
    """Probability of a crowded draw: its largest number is beyond `CROWDED`."""
    return -jnp.expm1(cars * math.log1p(-_BEYOND))


def departures(
    seeds: jax.Array, cars: jax.Array, most: int, seconds: float, crowded: jax.Array | int = -1
) -> jax.Array:
    """(N, n) whole seconds, ascending; `NEVER` beyond the number of cars.

    Args:
        seeds: (n,) uint32.
        cars: how many come, a scalar or (n,).
        most: N.
        seconds: the episode's.
        crowded: 1: only a draw that is, 0: only one that is not, -1: as it comes; as `cars`.
    """
    there = jnp.arange(most)[:, None] < jnp.asarray(cars)
    luck = random.uniform(seeds, _TIMES, jnp.uint32(0), most)
    # the least luck makes the largest number; in a crowded draw the first car has it
    least = -jnp.expm1(jnp.log1p(-luck[0] * crowded_share(jnp.asarray(cars))) / cars)
    floor = jnp.where(crowded == 1, least, jnp.where(crowded == 0, _BEYOND, 0.0))
    luck = luck.at[0].set(jnp.where(crowded == 1, 0.0, luck[0]))
    luck = floor + (1.0 - floor) * luck
    draws = jnp.sqrt(-jnp.log(luck))  # Weibull of shape 2
    ordered = jnp.sort(jnp.where(there, draws, jnp.inf), axis=0)
    low = jnp.floor(ordered[1])
    high = jnp.ceil(jnp.where(there, draws, 0.0).max(axis=0))
    times = jnp.rint((ordered - low) / (high - low) * seconds)
    return jnp.where(there, jnp.clip(times, 0.0, seconds), NEVER)


def plan(
    seeds: jax.Array,
    cars: jax.Array,
    most: int,
    per_lane: int,
    seconds: float,
    straight: float,
    crowded: jax.Array | int = -1,
) -> jax.Array:
    """(K, 16, n) when the cars of a lane depart, one after the other, and `RIGHT` if they turn so.

    `NEVER`: there is no such car. Arguments as in `departures`, with K and the share straight on.
    """
    times = departures(seeds, cars, most, seconds, crowded)
    moment = jnp.uint32(0)
    ahead = random.uniform(seeds, _TURNS, moment, most) < straight
    entry = jnp.floor(random.uniform(seeds, _PLACES, moment, most) * APPROACHES).astype(jnp.int32)
    left = ~ahead & (random.uniform(seeds, _SIDES, moment, most) < 0.5)
    right = ~ahead & ~left
    n = times.shape[1]
    lanes = jnp.arange(APPROACHES * LANES)[:, None]

    def one(count: jax.Array, car: tuple[jax.Array, ...]) -> tuple[jax.Array, jax.Array]:
        time, entry, left, right = car
        first = entry * LANES
        counts = jnp.take_along_axis(count, first + jnp.arange(LEFT)[:, None], axis=0)
        fewest = jnp.argmin(counts, axis=0).astype(jnp.int32)
        lane = first + jnp.where(left, LEFT, jnp.where(right, 0, fewest))
        number = jnp.take_along_axis(count, lane[None], axis=0)[0]
        number = jnp.where(time < NEVER, number, per_lane)
        count = count + ((lanes == lane) & (time < NEVER))
        return count, jnp.stack([number, lane])

    none = jnp.zeros((APPROACHES * LANES, n), jnp.int32)
    _, found = jax.lax.scan(one, none, (times, entry, left, right))
    number, lane, which = found[:, 0], found[:, 1], jnp.arange(n)[None]
    size = (per_lane, APPROACHES * LANES, n)
    place = (number, lane, jnp.broadcast_to(which, number.shape))
    return jnp.full(size, NEVER).at[place].set(times + jnp.where(right, RIGHT, 0.0), mode="drop")
