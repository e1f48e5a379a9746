"""How cars of two lanes that become one let each other in, as SUMO 1.28 has them do.

A car within the merge section yields to a car of the other lane that would arrive shortly before
it, or that it could not pass: it drives so as to arrive a second later. SUMO keeps an order of
arrival (`Approach`) and asks three questions of each pair; all three change results. The rule for
the speed was found by measurement, one car against one other, and a test holds SUMO to it.

Notation (shapes): n simulations; e and f are rows of the two lanes. d: metres to the zipper, v and
u: speeds of a car and of its foe [m/s], t: seconds from now.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp

from mbtl.worlds.traffic import idm
from mbtl.worlds.traffic.idm import IDM

_CLEAR = 4.0  # seconds of one car alone at the zipper
_ALONE = 1.0  # seconds after the foe at which a car means to arrive
_NEVER = 30.0  # seconds by which a foe that can stop may be late
_TINY, _SLOW = 1e-3, 0.1  # m/s


class Approach(NamedTuple):
    """When the cars of a lane will be at the zipper, (rows, n).

    Attributes:
        there: within the merge section and on its way.
        left: d.
        speed: v.
        desired: v0.
        time: of arrival.
        out: when the car will have passed.
        fast: speed at arrival.
        after: speed behind.
        eager: how much a driver counts on others to brake for it, 0..1.
    """

    there: jax.Array
    left: jax.Array
    speed: jax.Array
    desired: jax.Array
    time: jax.Array
    out: jax.Array
    fast: jax.Array
    after: jax.Array
    eager: jax.Array


@dataclass(frozen=True)
class Zipper:
    """The rule; constants are those of the drivers.

    Attributes:
        driver: the car-following model.
        length: of a car [m].
        min_gap: s0 [m].
        impatience: of drivers who could still stop, 0..1.
        dt: seconds of a simulation step.
    """

    driver: IDM
    length: float
    min_gap: float
    impatience: float
    dt: float

    def approach(
        self,
        there: jax.Array,
        left: jax.Array,
        speed: jax.Array,
        desired: jax.Array,
        behind: jax.Array,
        told: jax.Array,
        gap: float,
    ) -> Approach:
        """The approach of cars that mean to drive on; SUMO asks nobody to yield to others.

        Args:
            there: within the merge section and not kept from entering.
            left: d.
            speed: v.
            desired: v0.
            behind: speed at which each of them follows the one before it on its lane.
            told: the speed that it is advised; infinite without advice.
            gap: metres between the lanes and the road behind.
        """
        a, b, dt = self.driver.accel, self.driver.decel, self.dt
        free = jnp.minimum(speed + a * dt, desired)
        now = jnp.minimum(jnp.minimum(free, behind), told)
        fastest = jnp.minimum(jnp.sqrt(now * now + 2.0 * a * left), desired)
        fast = jnp.minimum(fastest, behind)
        rate = jnp.where(fast >= now, a, -b)
        changing = (fast - now) / rate
        way = 0.5 * changing * (fast + now)
        cruise = changing + (left - way) / jnp.maximum(jnp.maximum(now, fast), _SLOW)
        short = (jnp.sqrt(jnp.maximum(0.0, now * now + 2.0 * rate * left)) - now) / rate
        time = jnp.where(left >= way, cruise, short)
        soon = speed + dt * a * (1.0 - jnp.square(jnp.square(speed / desired)))
        after = jnp.minimum(jnp.sqrt(fast * fast + 2.0 * a * gap), jnp.minimum(desired, soon))
        out = time + (gap + self.length) / jnp.maximum(0.5 * (fast + after), _TINY)
        stops = (left > braking(speed, b, dt)) | (speed < b * dt)
        eager = jnp.where(stops, self.impatience, 1.0)
        return Approach(there & (now > 0.0), left, speed, desired, time, out, fast, after, eager)

    def speeds(self, cars: Approach, foes: Approach) -> jax.Array:
        """(e, n) the fastest that each car may drive so as to let its foes in; else infinite."""
        e = Approach(*(field[:, None] for field in cars))
        f = Approach(*(field[None] for field in foes))
        yields = e.there & f.there & self._meet(e, f) & self._goes_behind(e, f)
        return jnp.where(yields, self._patient(e, f), jnp.inf).min(axis=1)

    def _goes_behind(self, e: Approach, f: Approach) -> jax.Array:
        """Whether a car is behind its foe in the order of arrival, or of places where it can brake.

        A car can brake for another one ahead if a second of braking brings it to the other's speed.
        """
        b, ahead = self.driver.decel, e.left - f.left
        can = (ahead > 0.0) & (ahead > e.speed - b - f.speed)
        foe_can = (ahead < 0.0) & (-ahead > f.speed - b - e.speed)
        return ((f.time <= e.time) | can) & ~foe_can

    def _meet(self, e: Approach, f: Approach) -> jax.Array:
        """Whether one would be in the way of the other."""
        behind = (e.time - f.out < _CLEAR) | (f.after <= e.fast)
        late, speed = self._braking_foe(e, f)
        before = (late <= e.out + _CLEAR) | (e.after <= speed)
        return jnp.where(e.time < f.time, before, behind)

    def _braking_foe(self, e: Approach, f: Approach) -> tuple[jax.Array, jax.Array]:
        """When a foe that comes later would arrive if it braked for this car, and how fast."""
        rate = self.driver.decel * e.eager
        mean = f.left / jnp.maximum(f.time, _TINY)
        rest = f.left - mean * (e.time - self.dt)
        stops = 0.5 * mean * mean <= rest * rate
        between = f.time - e.time
        slower = mean - between * rate
        more = (slower - jnp.sqrt(jnp.maximum(0.0, mean * (slower - between * rate)))) / rate
        late = jnp.where(stops, _NEVER, more)
        return f.time + e.eager * late, jnp.where(stops, 0.0, slower - more * rate)

    def _patient(self, e: Approach, f: Approach) -> jax.Array:
        """Speed after one step of a car that means to arrive a second after its foe."""
        a, dt = self.driver.accel, self.dt
        final = jnp.minimum(f.desired, jnp.sqrt(f.speed * f.speed + 2.0 * a * f.left))
        arrives = f.left / jnp.maximum(0.5 * (f.speed + final), _TINY)
        time = jnp.maximum(1.0, jnp.ceil(arrives / dt) * dt) + _ALONE
        soon = jnp.minimum(e.speed + a * dt, e.desired)
        slack = e.left - soon * time
        later = e.speed + dt * 2.0 * slack / (time * time)
        gap = e.left - f.left - self.length
        follow = idm.follow(
            self.driver, e.speed, f.speed, gap, jnp.float32(self.min_gap), e.desired, dt
        )
        return jnp.maximum(follow, later)

    def keep_clear(self, speed: jax.Array, left: jax.Array, desired: jax.Array) -> jax.Array:
        """Speed of a car that waits before the zipper, a metre before it if it can."""
        off = jnp.maximum(_LEAST, jnp.minimum(_STOP, left - self.braked(speed)))
        return self.halt(speed, left - off, desired)

    def halt(self, speed: jax.Array, gap: jax.Array, desired: jax.Array) -> jax.Array:
        """Speed of a car that stops so many metres ahead."""
        stood = jnp.zeros_like(speed)
        new = idm.follow(self.driver, speed, stood, gap, jnp.float32(0.0), desired, self.dt)
        return jnp.where(gap < _ARRIVED, 0.0, new)

    def braked(self, speed: jax.Array) -> jax.Array:
        """Metres that comfortable braking to a stop takes."""
        return braking(speed, self.driver.decel, self.dt)


_ARRIVED, _LEAST, _STOP = 0.01, 0.1, 1.0  # metres


def braking(speed: jax.Array, decel: float, dt: float) -> jax.Array:
    """Metres that braking to a stop takes, step by step."""
    step = decel * dt
    n = jnp.floor(speed / step)
    return dt * n * (speed - 0.5 * step * (n + 1.0))
