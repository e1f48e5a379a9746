"""What agents of the ramp twin see: the layout of `mbtl.cmdps.traffic.ramp`.

Notation as in `mbtl.worlds.traffic.ramp`.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp

from mbtl.worlds.traffic.ramp_state import NO_CAR, Look, RampState, there


def look(state: RampState, agents: int, every: int, length: float, reach: float) -> Look:
    """Find the advised cars and what each of them sees.

    Args:
        state: of n ramps.
        agents: A.
        every: one car of the main road in so many is advised.
        length: of a car [m].
        reach: the distance of a car that is not there [m].
    """
    main, side, end = state.main, state.side, state.end
    behind = len(end.x)  # rows of `main` come after those of `end`
    x, speed, car = (
        jnp.concatenate([getattr(end, name), getattr(main, name)]) for name in ("x", "speed", "car")
    )
    advised = (car >= 0) & (car % every == 0)
    place = jnp.where(advised, car // every % agents, -1)
    here = place[None] == jnp.arange(agents)[:, None, None]  # (A, rows, n)
    present, mine = here.any(axis=1), jnp.argmax(here, axis=1)

    def of(field: jax.Array, row: jax.Array) -> jax.Array:
        return jnp.take_along_axis(field, row, axis=0, mode="clip")

    def neighbour(is_there: jax.Array, x: jax.Array, speed: jax.Array) -> list[jax.Array]:
        distance = jnp.maximum(0.0, jnp.abs(x - own))
        return [jnp.where(is_there, distance, reach), jnp.where(is_there, speed, 0.0)]

    own = of(x, mine)
    before, on_end = mine >= behind, there(end).sum(axis=0)
    ahead = jnp.where(mine == behind, on_end, mine) - 1
    last_on_end = ~before & (mine + 1 >= on_end)
    first = main.x[0] >= side.x[0]  # of those that come to the zipper
    follows = jnp.where(last_on_end, jnp.maximum(main.x[0], side.x[0]), of(x, mine + 1))
    head_speed = jnp.where(first, main.speed[0], side.speed[0])
    follower = jnp.where(last_on_end, head_speed, of(speed, mine + 1))
    someone = there(main)[0] | there(side)[0]
    next_there = (mine + 1 < len(car)) & (of(car, mine + 1) != NO_CAR)
    has_follower = jnp.where(last_on_end, someone, next_there)
    joins = before & there(side)[0]
    raw = [
        jnp.where(before & (own < 0.0), -own, reach),
        of(speed, mine),
        *neighbour(ahead >= 0, of(x, jnp.maximum(ahead, 0)), of(speed, jnp.maximum(ahead, 0))),
        *neighbour(has_follower, follows, follower),
        jnp.where(joins, -side.x[0], reach),
        jnp.where(joins, side.speed[0], 0.0),
    ]
    return Look(jnp.where(present, of(car, mine), NO_CAR), jnp.stack(raw))


def numbers(seen: Look, scale: tuple[float, float]) -> jax.Array:
    """(n, A, 8) observations: shares of `scale`, from -1 to 1."""
    share = seen.raw / jnp.array(scale * 4)[:, None, None]
    return jnp.moveaxis(2.0 * jnp.clip(share, 0.0, 1.0) - 1.0, 0, -1).swapaxes(0, 1)
