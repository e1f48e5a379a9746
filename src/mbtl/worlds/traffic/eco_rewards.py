"""What agents of the eco-driving twin can be taught by; none of these is the score.

    paper     (v - crawling max(0, crawl - v) - co2 E) / scale of the own car (cmdp-spec, 6.2)
    delay     v / limit - 1 of the own car
    platoon   the same, summed over the own car and those behind it up to the next agent, as far as
              they are in the region
    road      the same, with those who are behind on the straight feeder

The sum of v over a trip is its length whatever the speed, so that `paper` hardly asks for speed;
the sum of `delay` is the time lost. Delay of the platoon counts those who cannot overtake. As the
score sees cars in the region only, it pays to keep others out of it; under `road` it does not.
Notation as in `mbtl.worlds.traffic.eco`.
"""

from __future__ import annotations

from typing import Literal

import jax
import jax.numpy as jnp

from mbtl.worlds.traffic.eco_state import Costs

Reward = Literal["paper", "delay", "platoon", "road"]


def paper(costs: Costs, speed: jax.Array, co2: jax.Array) -> jax.Array:
    """(rows, n) of every car, as if it were an agent."""
    crawling = jnp.maximum(0.0, costs.crawl - speed)
    return (speed - costs.crawling * crawling - costs.co2 * co2) / costs.scale


def delay(limit: float, speed: jax.Array) -> jax.Array:
    """(rows, n) share of a step that every car loses, negative."""
    return speed / limit - 1.0


def of_platoons(each: jax.Array, row: jax.Array) -> jax.Array:
    """(A, n) sums over an agent and the cars behind it up to the next agent.

    Args:
        each: (rows, n) of every car, 0 where it does not count.
        row: (A, n) of the agents; negative: nobody, whose sum is nonsense.
    """
    before = jnp.concatenate([jnp.zeros_like(each[:1]), jnp.cumsum(each, axis=0)])
    following = jnp.where(row[None] > row[:, None], row[None], len(each)).min(axis=1)
    first = jnp.maximum(row, 0)
    return _at(before, following) - _at(before, first)


def _at(field: jax.Array, rows: jax.Array) -> jax.Array:
    return jnp.take_along_axis(field, rows, axis=0, mode="promise_in_bounds")
