"""Who drives into a twin, and when: Poisson arrivals of drivers who differ.

Notation (shapes): n simulations, 2 feeders, the straight one first; arrays are (2, n).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp

from mbtl.worlds import random

_STREAM = 3
_DRAWS = 7  # per car: gap in time, controlled, kind, and the four numbers of a driver

Driver = tuple[float, ...]
"""minGap [m], tau [s], accel, decel [m/s^2]."""


class Kind(NamedTuple):
    """A kind of vehicle with a human driver.

    Attributes:
        share: of the fleet; shares need not add up to 1.
        length: [m].
        mean: of the drivers.
        std: before the cut.
    """

    share: float
    length: float
    mean: Driver
    std: Driver


class Car(NamedTuple):
    """One car per feeder and simulation: its length, its driver, and whether it is controlled."""

    length: jax.Array
    min_gap: jax.Array
    tau: jax.Array
    accel: jax.Array
    decel: jax.Array
    controlled: jax.Array


@dataclass(frozen=True)
class Demand:
    """Distributions of cars.

    Attributes:
        kinds: of human drivers.
        cut: standard deviations at which normal distributions end.
        controlled: the driver of all controlled cars.
        controlled_length: [m].
        shares: of the inflow, per feeder.
    """

    kinds: tuple[Kind, ...]
    cut: float
    controlled: Driver
    controlled_length: float
    shares: tuple[float, float]

    def draw(
        self, seed: jax.Array, number: jax.Array, inflow: jax.Array, penetration: jax.Array
    ) -> tuple[jax.Array, Car]:
        """One car of each feeder. It follows from its number, so that every policy meets the same.

        Args:
            seed: (n,) uint32.
            number: (2, n) of the car among those of its feeder, from 0.
            inflow: cars per hour, a scalar or (n,).
            penetration: probability that a car is controlled, a scalar or (n,).

        Returns:
            (2, n) seconds after the car before, and the cars.
        """
        draws = jnp.stack(
            [random.uniform(seed, _STREAM, 2 * number[k] + k, _DRAWS) for k in (0, 1)], axis=1
        )
        per_second = jnp.array(self.shares)[:, None] * jnp.asarray(inflow) / 3600.0
        gap = -jnp.log(draws[0]) / per_second
        controlled = draws[1] < penetration
        total = sum(kind.share for kind in self.kinds)
        edges, below = [], 0.0
        for kind in self.kinds[:-1]:
            below += kind.share / total
            edges.append(draws[2] >= below)

        def of_kind(values: list[float]) -> jax.Array:
            chosen = jnp.full_like(gap, values[0])
            for beyond, value in zip(edges, values[1:], strict=True):
                chosen = jnp.where(beyond, value, chosen)
            return chosen

        inner = math.erf(self.cut / math.sqrt(2.0))  # probability of what the cut leaves
        spread = math.sqrt(2.0) * jax.lax.erf_inv((2.0 * draws[3:] - 1.0) * inner)
        length = of_kind([kind.length for kind in self.kinds])
        driver = [
            jnp.where(
                controlled,
                own,
                of_kind([kind.mean[i] for kind in self.kinds])
                + of_kind([kind.std[i] for kind in self.kinds]) * spread[i],
            )
            for i, own in enumerate(self.controlled)
        ]
        length = jnp.where(controlled, self.controlled_length, length)
        return gap, Car._make([length, *driver, jnp.int32(controlled)])
