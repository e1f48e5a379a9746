"""How fast the cars of the ramp twin drive next: leaders, the zipper and advice.

Notation as in `mbtl.worlds.traffic.ramp`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import jax
import jax.numpy as jnp

from mbtl.worlds.traffic import lane
from mbtl.worlds.traffic.idm import EMERGENCY, IDM, follow, obey
from mbtl.worlds.traffic.ramp_state import Queue, Roads, there
from mbtl.worlds.traffic.zipper import Approach, Zipper

_STANDS = 0.1  # m/s
_LINE = 0.1  # metres before the zipper at which a car stops that finds a tail behind it


@dataclass(frozen=True)
class Drivers:
    """All cars.

    Attributes:
        model: of car-following.
        length: of a car [m].
        min_gap: s0 [m].
        dt: seconds of a simulation step.
        zipper: who lets whom in.
        roads: lengths.
        impatience: of drivers at the zipper who could still stop, 0..1.
    """

    model: IDM
    length: float
    min_gap: float
    dt: float
    roads: Roads
    impatience: float
    zipper: Zipper = field(init=False)

    def __post_init__(self) -> None:
        """The zipper's rule has the same constants."""
        rule = Zipper(self.model, self.length, self.min_gap, self.impatience, self.dt)
        object.__setattr__(self, "zipper", rule)

    @property
    def per_speed(self) -> float:
        """1 / (2 sqrt(a b)) [s/m]."""
        return 0.5 / math.sqrt(self.model.accel * self.model.decel)

    def speeds(
        self, main: Queue, side: Queue, end: Queue, constant: bool
    ) -> tuple[jax.Array, jax.Array, jax.Array]:
        """Speeds of all cars in this step, advice included.

        Args:
            main: cars of the main road.
            side: cars of the ramp.
            end: cars behind the zipper.
            constant: advice is a speed, not an acceleration.
        """
        closed = self._closed(end)
        window = math.ceil(self.roads.merge / (self.length + self.min_gap)) + 1
        safe, approaches = [], []
        for queue, gap, others in zip((main, side), self.roads.gaps, (True, False), strict=True):
            behind = self._behind(queue)
            head = self._head(queue, end, closed, others)
            safe.append(jnp.concatenate([jnp.minimum(behind[:1], head[None]), behind[1:]]))
            told = self._target(queue, constant)
            approaches.append(self._approach(queue, behind, told, closed, gap, window))
        for k, foes in ((0, 1), (1, 0)):
            let_in = self.zipper.speeds(approaches[k], approaches[foes])
            rows = len(let_in)
            first = jnp.minimum(safe[k][:rows], let_in)
            safe[k] = jnp.concatenate([first, safe[k][rows:]]) if rows < len(safe[k]) else first
        queues = zip((main, side, end), (*safe, self._behind(end)), strict=True)
        new = [self._told(queue, speed, constant) for queue, speed in queues]
        return new[0], new[1], new[2]

    def _behind(self, queue: Queue) -> jax.Array:
        """Speed behind the car before on the same road; the foremost is free."""
        tail = lane.one_ahead(queue.x - self.length, lane.FREE)
        leader = lane.one_ahead(queue.speed, self.roads.limit)
        return self._follow(queue, leader, tail - queue.x)

    def _follow(self, queue: Queue, leader: jax.Array, gap: jax.Array) -> jax.Array:
        own = follow(
            self.model, queue.speed, leader, gap, jnp.float32(self.min_gap), queue.desired, self.dt
        )
        return jnp.minimum(own, queue.desired)

    def _head(self, queue: Queue, end: Queue, closed: jax.Array, from_main: bool) -> jax.Array:
        """(n,) speed of the foremost car of a road behind the last one behind the zipper.

        Where that one came from the other lane and its tail is still there, it is no leader yet.
        """
        head = Queue(*(row[0] for row in queue))
        count = there(end).sum(axis=0)
        last = jnp.maximum(count - 1, 0)
        tail = lane.at(end.x, last) - self.length
        same = (lane.at(end.car, last) >= 0) == from_main
        gap, line = tail - head.x, -head.x
        inside = ~same & (tail < 0.0) & (gap < self.min_gap)
        stop = self.zipper.halt(head.speed, line - _LINE, head.desired)
        onward = jnp.where(inside, stop, self._follow(head, lane.at(end.speed, last), gap))
        faster = head.speed + self.model.accel * self.dt
        sees = self.zipper.braked(faster) + faster * (self.model.tau + self.dt)
        near = (line < jnp.maximum(self.roads.merge, sees)) | (same & (tail < 0.0))
        speed = jnp.where((count > 0) & near, onward, jnp.inf)
        waits = self.zipper.keep_clear(head.speed, line, head.desired)
        return jnp.where(closed, jnp.minimum(speed, waits), speed)

    def _closed(self, end: Queue) -> jax.Array:
        """(n,) behind the zipper a car stands, and there is no room for another one before it."""
        is_car = there(end)
        k = jnp.arange(len(end.x))[:, None]
        last = jnp.where(is_car & (end.speed < _STANDS), k, -1).max(axis=0)
        between = is_car.sum(axis=0) - 1 - last
        space = lane.at(end.x, jnp.maximum(last, 0)) - self.length
        return (last >= 0) & (space < (between + 1) * (self.length + self.min_gap))

    def _approach(
        self,
        queue: Queue,
        behind: jax.Array,
        told: jax.Array,
        closed: jax.Array,
        gap: float,
        window: int,
    ) -> Approach:
        """Of the cars that can be in the merge section."""
        x, speed, desired = (f[:window] for f in (queue.x, queue.speed, queue.desired))
        k = jnp.arange(len(x))[:, None]
        behind = jnp.where(k > 0, behind[:window], jnp.inf)
        kept = closed & (-x >= self.zipper.braked(speed) + _LINE)
        return self.zipper.approach(
            (x >= -self.roads.merge) & ~kept, -x, speed, desired, behind, told[:window], gap
        )

    def _told(self, queue: Queue, safe: jax.Array, constant: bool) -> jax.Array:
        """Speed of cars that obey as far as is safe."""
        safe = jnp.maximum(safe, jnp.maximum(0.0, queue.speed - EMERGENCY * self.dt))
        target = self._target(queue, constant)
        return obey(self.model, target, queue.speed, safe, self.dt)

    def _target(self, queue: Queue, constant: bool) -> jax.Array:
        """The advised speed, as far as a car can brake and accelerate to it."""
        target = queue.told if constant else queue.speed + queue.told * self.dt
        slowest = jnp.maximum(0.0, queue.speed - self.model.decel * self.dt)
        return jnp.clip(target, slowest, queue.speed + self.model.accel * self.dt)
