"""Car-following as SUMO integrates it: the intelligent driver model and its limits.

Notation: v speed and u the leader's [m/s]; g gap from bumper to bumper [m]; dt seconds.

    s* = s0 + max(0, v T + v (v - u) / (2 sqrt(a b)))
    v' = v + a (1 - (v / v0)^4 - (s* / g)^2) dt,   then   x' = x + v' dt
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import jax
import jax.numpy as jnp

EMERGENCY = 9.0
"""SUMO's strongest braking of a passenger car [m/s^2]."""

CLOSEST = 1e-3
"""Gap at which the model is cut off [m]."""


@dataclass(frozen=True)
class IDM:
    """What the drivers of one type have in common.

    Attributes:
        accel: a, largest acceleration [m/s^2].
        decel: b, comfortable braking [m/s^2].
        tau: T, time headway [s].
    """

    accel: float
    decel: float
    tau: float


def follow(
    driver: IDM,
    speed: jax.Array,
    leader: jax.Array,
    gap: jax.Array,
    min_gap: jax.Array,
    desired: jax.Array,
    dt: float,
) -> jax.Array:
    """Speed after one step, of any number of cars.

    Args:
        driver: the type.
        speed: v.
        leader: u.
        gap: g.
        min_gap: s0 [m].
        desired: v0 [m/s].
        dt: length of the step [s].
    """
    per_speed = 0.5 / math.sqrt(driver.accel * driver.decel)
    wish = min_gap + jnp.maximum(0.0, speed * (driver.tau + (speed - leader) * per_speed))
    close = wish / jnp.maximum(gap, CLOSEST)
    free = jnp.square(speed / desired)
    new = speed + dt * driver.accel * (1.0 - free * free - close * close)
    return jnp.maximum(new, jnp.maximum(0.0, speed - EMERGENCY * dt))


def obey(driver: IDM, target: jax.Array, speed: jax.Array, safe: jax.Array, dt: float) -> jax.Array:
    """Speed of a car that is told one: it brakes comfortably, or as hard as safety needs.

    Args:
        driver: the type.
        target: the speed it is told [m/s].
        speed: its speed now.
        safe: what `follow` gives.
        dt: length of the step [s].
    """
    slowest = jnp.minimum(safe, jnp.maximum(0.0, speed - driver.decel * dt))
    return jnp.maximum(jnp.minimum(target, safe), slowest)
