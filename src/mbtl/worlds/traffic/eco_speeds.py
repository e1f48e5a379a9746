"""How fast cars of the eco-driving twin drive next: leaders on three roads, and two lights.

A driver follows the nearest car or tail on its own road, and, unless a light stops it before, the
last one on the next road; from the approach also the last one on the exit, and from the feeders
the main light.
Notation as in `mbtl.worlds.traffic.eco`.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

from mbtl.worlds.traffic import lane
from mbtl.worlds.traffic.eco_state import Road
from mbtl.worlds.traffic.lane import Ahead, Cars


class Last(NamedTuple):
    """The last car whose front is beyond the start of a road, (n,).

    Attributes:
        tail: its back [m]; without a car it is far away.
        speed: [m/s].
        side: it came from the side feeder.
        there: it, or its tail, is on the road.
    """

    tail: jax.Array
    speed: jax.Array
    side: jax.Array
    there: jax.Array


def last_on(main: Cars, side: jax.Array, start: float, end: float) -> Last:
    """The last car on the road from `start` to `end`.

    Args:
        main: cars.
        side: (rows, n) where they came from.
        start: position [m].
        end: position [m].
    """
    count = (main.x > start).sum(axis=0)
    row = jnp.maximum(count - 1, 0)
    tail = lane.at(main.x, row) - lane.at(main.length, row)
    there = (count > 0) & (tail < end)
    return Last(tail, lane.at(main.speed, row), lane.at(side, row) > 0, there)


def speeds(
    road: Road,
    dt: float,
    main: Cars,
    from_side: jax.Array,
    side: Cars,
    go: jax.Array,
    side_go: jax.Array,
) -> tuple[jax.Array, jax.Array]:
    """Speeds after this step of cars that drive by themselves, of `main` and `side`.

    Args:
        road: geometry.
        dt: seconds of the step.
        main: (rows, n).
        from_side: (rows, n) which of them came from the side feeder.
        side: (side_rows, n).
        go: the main light, and the ghost to the straight feeder, show green; a scalar or (n,).
        side_go: the ghost shows green to the side feeder.
    """
    approach = last_on(main, from_side, 0.0, road.line)
    box = last_on(main, from_side, road.line, road.box)
    leaving = last_on(main, from_side, road.box, road.end)

    x = main.x
    feeder, before, within = x <= 0.0, x <= road.line, x <= road.box
    ends = jnp.where(feeder, 0.0, jnp.where(before, road.line, road.box))
    tail = lane.one_ahead(x - main.length, lane.FREE)
    overhangs = ~(feeder & (lane.one_ahead(from_side, 0) > 0)) | (
        lane.one_ahead(x, lane.FREE) <= 0.0
    )
    own = Ahead(
        tail - x, lane.one_ahead(main.speed, road.limit), ((tail < ends) & overhangs) | ~within
    )
    v = lane.follow(main, own, main.min_gap, road.limit, dt)

    can_stop, stop = lane.halt(main, ends - x, dt)
    stopped = before & ~go & can_stop
    blocked = feeder & ~stopped & approach.there & approach.side & (approach.tail < 0.0)
    halts, stop = _blocked(stopped, stop, blocked, x)
    next_tail = jnp.where(feeder, approach.tail, jnp.where(before, box.tail, leaving.tail))
    next_speed = jnp.where(feeder, approach.speed, jnp.where(before, box.speed, leaving.speed))
    next_there = jnp.where(feeder, approach.there, jnp.where(before, box.there, leaving.there))
    v = _onward(
        main, v, halts, stop, Ahead(next_tail - x, next_speed, next_there & within), road, dt
    )

    far = Ahead(
        jnp.where(feeder, road.line - lane.STOP_FROM_LINE, leaving.tail) - x,
        jnp.where(feeder, 0.0, leaving.speed),
        before & ~halts & jnp.where(feeder, ~go, leaving.there),
    )
    far_gap = jnp.where(feeder, 0.0, main.min_gap)
    v = jnp.minimum(v, lane.follow(main, far, far_gap, road.limit, dt))
    v_side = _side_speeds(road, dt, side, approach, go, side_go)
    return lane.bounded(main, v, dt), lane.bounded(side, v_side, dt)


def _side_speeds(
    road: Road, dt: float, side: Cars, approach: Last, go: jax.Array, side_go: jax.Array
) -> jax.Array:
    tail = lane.one_ahead(side.x - side.length, approach.tail)
    speed = lane.one_ahead(side.speed, approach.speed)
    there = lane.one_ahead(jnp.ones(side.x.shape, bool), approach.side & (approach.tail < 0.0))
    v = lane.follow(side, Ahead(tail - side.x, speed, there), side.min_gap, road.limit, dt)
    can_stop, stop = lane.halt(side, -side.x, dt)
    blocked = approach.there & ~approach.side & (approach.tail < 0.0)
    stopped = ~side_go & can_stop
    halts, stop = _blocked(stopped, stop, ~stopped & blocked, side.x)
    onward = Ahead(approach.tail - side.x, approach.speed, approach.there)
    v = _onward(side, v, halts, stop, onward, road, dt)
    line = Ahead(road.line - lane.STOP_FROM_LINE - side.x, jnp.float32(0.0), ~go & ~halts)
    return jnp.minimum(v, lane.follow(side, line, jnp.float32(0.0), road.limit, dt))


def _blocked(
    stopped: jax.Array, stop: Ahead, blocked: jax.Array, x: jax.Array
) -> tuple[jax.Array, Ahead]:
    """With a stop at the ghost where a tail that is still in the other feeder bars the way."""
    near = jnp.maximum(0.0, -lane.LEAST_FROM_LINE - x)
    return stopped | blocked, stop._replace(gap=jnp.where(blocked, near, stop.gap))


def _onward(
    cars: Cars, v: jax.Array, halts: jax.Array, stop: Ahead, onward: Ahead, road: Road, dt: float
) -> jax.Array:
    """The lesser of `v` and what the light, or behind it the next road, allows."""
    ahead = Ahead(
        jnp.where(halts, stop.gap, onward.gap),
        jnp.where(halts, stop.speed, onward.speed),
        halts | onward.there,
    )
    min_gap = jnp.where(halts, 0.0, cars.min_gap)
    followed = lane.follow(cars, ahead, min_gap, road.limit, dt)
    allowed = jnp.where(halts, lane.halting(cars, followed, stop.gap, dt), followed)
    return jnp.minimum(v, allowed)
