"""Cars that follow one another on a lane with traffic lights, as SUMO 1.28 moves them.

Notation (shapes): n simulations; arrays of cars are (rows, n). Row 0 is the foremost car, row k + 1
follows row k, and rows behind the last car are empty: x = EMPTY. x is the front of a car [m], v its
speed and u its leader's [m/s], g the gap from bumper to bumper [m]. `zoo.cmdps.traffic.eco` states
the rules, and a test holds SUMO to them.
"""

from __future__ import annotations

from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp

from mbtl.engine.worlds.environments import Tree
from mbtl.zoo.worlds.traffic.idm import CLOSEST, EMERGENCY

EMPTY = -1e4
"""Position of a car that is not there [m]."""

FREE = 1e6
"""Gap where there is no leader [m]."""

STOP_FROM_LINE = 1.0
"""Where cars stop before a light, if they can [m]."""

LEAST_FROM_LINE = 0.1
"""Where they stop if they must [m]."""

_LIGHT_BRAKING = 3.0  # m/s^2; what SUMO expects of every car at a light, at least
_ARRIVED, _AT_REST = 0.01, 1e-3  # metres before a stop; m/s

Rows = TypeVar("Rows", bound=tuple[jax.Array, ...])


class Cars(NamedTuple):
    """A queue of cars.

    Attributes:
        x: front [m].
        speed: [m/s].
        length: [m].
        min_gap: s0 [m].
        tau: T [s].
        accel: a [m/s^2].
        decel: b [m/s^2].
        controlled: int32, 0 or 1; rows of bools are moved four times slower.
    """

    x: jax.Array
    speed: jax.Array
    length: jax.Array
    min_gap: jax.Array
    tau: jax.Array
    accel: jax.Array
    decel: jax.Array
    controlled: jax.Array


NOBODY = Cars(EMPTY, 0.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0)
"""Fields of an empty row."""


class Ahead(NamedTuple):
    """What a driver may have to follow; shapes that broadcast to (rows, n).

    Attributes:
        gap: g; negative where cars overlap.
        speed: u.
        there: whether there is any.
    """

    gap: jax.Array
    speed: jax.Array
    there: jax.Array


def empty(rows: int, n: int) -> Cars:
    """No cars."""
    return Cars(*(jnp.full((rows, n), value) for value in NOBODY))


def follow(cars: Cars, ahead: Ahead, min_gap: jax.Array, limit: float, dt: float) -> jax.Array:
    """Speed after one step: IDM in two inner steps, in which the leader keeps its speed.

        v' = v + a (1 - (v / limit)^4 - (s* / g)^2) dt / 2,   g' = g - max(0, v' - u) dt / 2

    Args:
        cars: (rows, n).
        ahead: the leaders; cars without one accelerate freely.
        min_gap: s0 towards them.
        limit: speed limit, and what every driver wants [m/s].
        dt: length of the step [s].
    """
    v, half = cars.speed, 0.5 * dt
    gap = jnp.where(ahead.there, ahead.gap, FREE)
    leader = jnp.where(ahead.there, ahead.speed, limit)
    per_speed = 0.5 * jax.lax.rsqrt(cars.accel * cars.decel)
    for _ in range(2):
        wish = min_gap + jnp.maximum(0.0, v * (cars.tau + (v - leader) * per_speed))
        close = wish / jnp.maximum(gap, CLOSEST)
        free = jnp.square(v / limit)
        v = jnp.maximum(0.0, v + half * cars.accel * (1.0 - free * free - close * close))
        gap = gap - half * jnp.maximum(0.0, v - leader)
    return v


def halt(cars: Cars, left: jax.Array, dt: float) -> tuple[jax.Array, Ahead]:
    """Whether a car can still stop at a line, and the standing leader that it then sees there.

    Args:
        cars: (rows, n).
        left: metres to the line.
        dt: length of the step [s].
    """
    b = jnp.maximum(cars.decel, _LIGHT_BRAKING) * dt
    n = jnp.floor(cars.speed / b)
    braking = dt * n * (cars.speed - 0.5 * b * (n + 1.0))
    before = jnp.clip(left - braking, LEAST_FROM_LINE, STOP_FROM_LINE)
    can = left >= braking
    return can, Ahead(jnp.maximum(0.0, left - before), jnp.zeros_like(left), can)


def halting(cars: Cars, speed: jax.Array, gap: jax.Array, dt: float) -> jax.Array:
    """Speed of a car that stops `gap` metres ahead, where IDM alone would give `speed`."""
    resting = (cars.speed < _AT_REST) & (speed < _AT_REST)
    speed = jnp.where(resting, (gap - _AT_REST) / dt, speed)
    return jnp.where(gap < _ARRIVED, 0.0, jnp.minimum(speed, gap / dt))


def bounded(cars: Cars, speed: jax.Array, dt: float) -> jax.Array:
    """No braking beyond an emergency, no driving backwards."""
    return jnp.maximum(speed, jnp.maximum(0.0, cars.speed - EMERGENCY * dt))


def moved(cars: Cars, speed: jax.Array, dt: float) -> Cars:
    """The cars one step later, each at its new speed."""
    there = cars.x > 0.5 * EMPTY
    return cars._replace(
        x=jnp.where(there, cars.x + dt * speed, EMPTY), speed=jnp.where(there, speed, 0.0)
    )


def room(cars: Cars, row: jax.Array, start: float, speed: float, car: Any) -> jax.Array:
    """(n,) whether a car can enter behind another one.

    Args:
        cars: the queue.
        row: (n,) of the last car.
        start: where the front of the new car would be [m].
        speed: of the new car [m/s].
        car: the new one (`arrivals.Car`), (n,).
    """
    x, length, last = (at(field, row) for field in (cars.x, cars.length, cars.speed))
    closing = speed * (speed - last) * 0.5 * jax.lax.rsqrt(car.accel * car.decel)
    return x - length - start >= car.min_gap + jnp.maximum(0.0, speed * car.tau + closing)


class Incomer(NamedTuple):
    """A car that comes into a queue.

    Attributes:
        comes: (n,) whether it does.
        row: (n,) where, counted after row 0 has left.
        car: its fields, (n,).
    """

    comes: jax.Array
    row: jax.Array
    car: Tree


def shifted(
    rows: Rows, vacant: Tree, gone: jax.Array, last: Incomer, between: Incomer | None = None
) -> Rows:
    """Rows after the foremost car has left and others have come.

    Args:
        rows: fields (rows, n) of a queue.
        vacant: fields of an empty row.
        gone: (n,) row 0 has left.
        last: comes into an empty row; `row` is counted after `between` has come.
        between: comes before the row that it takes.
    """

    def one(x: jax.Array, nobody: Any, behind: jax.Array, *into: jax.Array) -> jax.Array:
        k = jnp.arange(x.shape[0])[:, None]
        end = jnp.full((1, x.shape[1]), nobody, x.dtype)
        new = jnp.where(gone, jnp.concatenate([x[1:], end]), x)
        if between is not None:
            back = jnp.where(gone, x, jnp.concatenate([end, x[:-1]]))
            place = jnp.where(between.comes, between.row, x.shape[0])
            new = jnp.where(k < place, new, jnp.where(k == place, into[0], back))
        return jnp.where((k == last.row) & last.comes, behind, new)

    others = () if between is None else (between.car,)
    found: Rows = jax.tree.map(one, rows, vacant, last.car, *others)
    return found


def at(field: jax.Array, row: jax.Array) -> jax.Array:
    """(n,) entries of one row per simulation."""
    return jnp.take_along_axis(field, row[None], axis=0, mode="clip")[0]


def one_ahead(field: jax.Array, first: Tree) -> jax.Array:
    """(rows, n) the same of each car's predecessor, `first` for row 0."""
    return jnp.concatenate(
        [jnp.broadcast_to(first, (1, field.shape[1])).astype(field.dtype), field[:-1]]
    )


def one_behind(field: jax.Array, last: Tree) -> jax.Array:
    """(rows, n) the same of each car's follower, `last` for the last row."""
    return jnp.concatenate(
        [field[1:], jnp.broadcast_to(last, (1, field.shape[1])).astype(field.dtype)]
    )
