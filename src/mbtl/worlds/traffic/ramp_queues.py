"""Cars of the ramp twin that enter, leave, pass the zipper or collide.

Notation as in `mbtl.worlds.traffic.ramp`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from mbtl.worlds.traffic import lane
from mbtl.worlds.traffic.lane import Incomer
from mbtl.worlds.traffic.ramp_state import VACANT, Queue, there


def driven(queue: Queue, speed: jax.Array, dt: float) -> Queue:
    """After a step of `dt` seconds."""
    is_car = there(queue)
    x = jnp.where(is_car, queue.x + dt * speed, lane.EMPTY)
    return queue._replace(x=x, speed=jnp.where(is_car, speed, 0.0))


def with_last(queue: Queue, gone: jax.Array, comes: jax.Array, car: Queue) -> Queue:
    """Without the foremost car, if it has gone, and with a last one, if it comes."""
    row = there(queue).sum(axis=0) - gone
    return lane.shifted(queue, VACANT, gone, Incomer(comes, row, car))


def without_collided(queues: tuple[Queue, ...], length: float, least: float) -> tuple[Any, Any]:
    """Without the cars that are closer than `least` [m]; and how many those were, (n,)."""
    masks = []
    for queue in queues:
        gap = lane.one_ahead(queue.x - length, lane.FREE) - queue.x
        hits = there(queue) & (gap < least)
        masks.append(hits | lane.one_behind(hits, False))
    collided = jnp.asarray(sum(mask.sum(axis=0) for mask in masks))
    removed: tuple[Queue, ...] = jax.lax.cond(
        (collided > 0).any(),
        lambda: tuple(without(q, mask) for q, mask in zip(queues, masks, strict=True)),
        lambda: queues,
    )
    return removed, collided


def joined(main: Queue, side: Queue, end: Queue, passes: jax.Array, left: jax.Array) -> Queue:
    """The cars behind the zipper with those that have passed it."""
    heads = [Queue(*(field[0] for field in queue)) for queue in (main, side)]
    main_first = passes[0] & (~passes[1] | (heads[0].x >= heads[1].x))
    row = there(end).sum(axis=0) - left

    def chosen(first: jax.Array) -> Any:
        return jax.tree.map(lambda a, b: jnp.where(first, a, b), *heads)

    between = Incomer(passes.any(axis=0), row, chosen(main_first))
    last = Incomer(passes.all(axis=0), row + 1, chosen(~main_first))
    return lane.shifted(end, VACANT, left, last, between)


def without(queue: Queue, gone: jax.Array) -> Queue:
    """The queue without some cars, closed up."""
    order = jnp.argsort(gone, axis=0, stable=True)
    vacated = jnp.take_along_axis(gone, order, axis=0)
    take: Callable[[jax.Array, Any], jax.Array] = lambda field, nobody: jnp.where(  # noqa: E731
        vacated, jnp.asarray(nobody, field.dtype), jnp.take_along_axis(field, order, axis=0)
    )
    return Queue(*(take(field, nobody) for field, nobody in zip(queue, VACANT, strict=True)))
