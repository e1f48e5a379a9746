"""Car-following of Krauss, as SUMO integrates it in steps of one second.

Notation: v speed and u the leader's [m/s]; g gap from bumper to bumper, less the smallest one [m];
b braking. A step lasts one second, which is also the driver's reaction time, so that speeds are
metres per step.

    a driver can stop within s metres from speed v    if v <= n b + (s - h) / (n + 1),
    h = n (n - 1) b / 2 + n b,   n = floor(-1/2 + sqrt(1 + 8 s / b) / 2)
    behind a leader                                   s = g + metres(u)
"""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from mbtl.worlds.traffic.idm import EMERGENCY

_CLOSE = 1e-3  # SUMO keeps this much of every gap [m]


@dataclass(frozen=True)
class Krauss:
    """What all drivers of one type have in common.

    Attributes:
        accel: a [m/s^2].
        decel: b [m/s^2].
        sigma: how much of an acceleration a driver may miss, a share.
    """

    accel: float
    decel: float
    sigma: float

    def metres(self, speed: jax.Array) -> jax.Array:
        """Driven while braking from `speed` to a stop; the first step already brakes."""
        steps = jnp.floor(speed / self.decel)
        return steps * (speed - 0.5 * self.decel * (steps + 1.0))

    def able_to_stop(self, metres: jax.Array) -> jax.Array:
        """Largest speed from which a driver stops within so many metres [m/s]."""
        room = jnp.maximum(metres - _CLOSE, 0.0)
        n = jnp.floor(0.5 * jnp.sqrt(1.0 + (8.0 / self.decel) * room) - 0.5)
        held = 0.5 * self.decel * n * (n + 1.0)
        return n * self.decel + (room - held) / (n + 1.0)

    def slowing(self, metres: jax.Array, target: jax.Array) -> jax.Array:
        """Largest speed from which a driver is down to `target` after so many metres [m/s]."""
        b = self.decel
        spread = b + 2.0 * target
        y = (0.5 * (jnp.sqrt(spread * spread + 8.0 * b * metres) - b) - target) / b
        y = jnp.maximum(y, 0.0)
        whole = jnp.floor(y)
        more = (y > whole).astype(metres.dtype)
        needed = 0.5 * b * (whole * whole + whole) + whole * target + more * target
        gained = jnp.maximum(metres - needed, 0.0) / (whole + 1.0) + (whole + more) * b
        return jnp.where(metres < target, target, target + gained)

    def next_speed(self, speed: jax.Array, most: jax.Array, luck: jax.Array) -> jax.Array:
        """After one step.

        Args:
            speed: v.
            most: what roads, leaders and lights allow.
            luck: uniform in (0, 1), what the driver misses of an acceleration.
        """
        most = jnp.maximum(jnp.minimum(most, speed + self.accel), speed - EMERGENCY)
        most = jnp.maximum(most, 0.0)
        least = jnp.minimum(jnp.maximum(speed - self.decel, 0.0), most)
        missed = self.sigma * luck * jnp.minimum(most, 1.0) * self.accel
        return jnp.maximum(most - missed, least)
