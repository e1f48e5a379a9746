"""Highway ramp, twin of `zoo.cmdps.traffic.ramp` (cmdp-spec, 7.3): same cars, rules and numbers.

Notation (shapes): n simulations, A places for agents; arrays of cars are (rows, n). Three queues:
`main` and `side` are the cars of the two roads before the zipper, `end` those behind it. x counts
from the zipper, negative before it. Every `every`-th car that enters the main road is advised; its
place is the next one in turn, and stays its own until it leaves.

Not as in SUMO, because no measure differs: a driver follows one car, the one before him, where SUMO
has him look at the last one on each of the next roads, too; and drivers faster than they want to be
slow down at the ends of roads no more than elsewhere.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from mbtl.engine.worlds import random
from mbtl.engine.worlds.beats import HoldParams, Holds
from mbtl.engine.worlds.environments import Beats, Box, Discrete, TimeLimit
from mbtl.engine.worlds.world import Moved, Seen
from mbtl.zoo.worlds.traffic import idm, lane
from mbtl.zoo.worlds.traffic.idm import EMERGENCY, IDM, follow, obey
from mbtl.zoo.worlds.traffic.lane import EMPTY, Incomer

# ---- what the ramp twin is made of: its constants and its state ------------------------------


class Queue(NamedTuple):
    """Cars that follow one another, (rows, n); row 0 is the foremost, rows behind the last EMPTY.

    Attributes:
        x: front [m], 0 at the zipper.
        speed: [m/s].
        desired: v0 [m/s].
        told: advised speed [m/s] or acceleration [m/s^2]; infinite: it drives by itself.
        car: int32, its number among those that entered the main road; RAMP_CAR, or NO_CAR.
    """

    x: jax.Array
    speed: jax.Array
    desired: jax.Array
    told: jax.Array
    car: jax.Array


RAMP_CAR, NO_CAR = -1, -2
EPSILON = 0.1  # metres: SUMO lets tails enter, and fronts leave, that far from a road's end

VACANT = Queue(EMPTY, 0.0, 1.0, jnp.inf, NO_CAR)
"""Fields of a row without a car."""


def empty(rows: int, n: int) -> Queue:
    """No cars."""
    return Queue(*(jnp.full((rows, n), value) for value in VACANT))


def there(queue: Queue) -> jax.Array:
    """(rows, n) whether there is a car."""
    return queue.car != NO_CAR


class Look(NamedTuple):
    """What the advised drivers see.

    Attributes:
        car: (A, n) number of the car of each place; NO_CAR: nobody has it.
        raw: (8, A, n) in metres and m/s.
    """

    car: jax.Array
    raw: jax.Array


class Counts(NamedTuple):
    """Sums over the measured steps, (n,), but `collided`: over all of them.

    Attributes:
        steps: so many.
        speed: means over the cars [m/s].
        left: cars that reached the end.
        wanted: cars whose last chance to enter came.
        missed: those of them that found no room.
        collided: cars.
    """

    steps: jax.Array
    speed: jax.Array
    left: jax.Array
    wanted: jax.Array
    missed: jax.Array
    collided: jax.Array


class Held(NamedTuple):
    """What happened since the last decision.

    Attributes:
        reward: (n,) sum.
        early: what was seen after the first step.
        car: (A, n) who was told.
    """

    reward: jax.Array
    early: Look
    car: jax.Array


class RampState(NamedTuple):
    """n ramps.

    Attributes:
        main: cars on the main road before the zipper.
        side: cars from the ramp before the zipper.
        end: cars behind the zipper.
        waiting: (2, n) a car waits to enter the main road, the ramp.
        entered: (n,) cars that have entered the main road.
        counts: what score and measures are made of.
        look: at the last decision.
        seed: (n,) uint32.
        steps: simulation steps since the warm-up began.
    """

    main: Queue
    side: Queue
    end: Queue
    waiting: jax.Array
    entered: jax.Array
    counts: Counts
    look: Look
    seed: jax.Array
    steps: jax.Array


@dataclass(frozen=True)
class Roads:
    """Lengths in metres, speeds in m/s.

    Attributes:
        main: before the merge section.
        side: the ramp, likewise.
        merge: section in which the two lanes run side by side.
        end: behind the zipper.
        gaps: from the end of either merge lane to the start of the end, as the crow flies.
        limit: speed limit.
    """

    main: float
    side: float
    merge: float
    end: float
    gaps: tuple[float, float]
    limit: float

    def lane(self, k: int) -> float:
        """From the start of the main road, or of the ramp, to the zipper."""
        return (self.main, self.side)[k] + self.merge

    def entry(self, k: int, car: float) -> float:
        """Where the front of a car of that length is that has entered."""
        return car + EPSILON - self.lane(k)


@dataclass(frozen=True)
class Flow:
    """Cars that come evenly spaced; in simulation steps.

    Attributes:
        first: when the first one comes.
        every: between two.
        patience: steps in which a car that finds no room tries again, before it is dropped.
        speed: at which it enters [m/s].
    """

    first: int
    every: int
    patience: int
    speed: float

    def comes(self, step: jax.Array) -> jax.Array:
        """Whether a car comes in this step."""
        since = step - self.first
        return (since >= 0) & (since % self.every == 0)


# ---- cars of the ramp twin that enter, leave, pass the zipper or collide ---------------------


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


# ---- how cars of two lanes that become one let each other in, as SUMO 1.28 has them do -------
#
# A car within the merge section yields to a car of the other lane that would arrive shortly before
# it, or that it could not pass: it drives so as to arrive a second later. SUMO keeps an order of
# arrival (`Approach`) and asks three questions of each pair; all three change results. The rule for
# the speed was found by measurement, one car against one other, and a test holds SUMO to it.
#
# Notation (shapes): n simulations; e and f are rows of the two lanes. d: metres to the zipper, v
# and u: speeds of a car and of its foe [m/s], t: seconds from now.


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


# ---- how fast the cars of the ramp twin drive next: leaders, the zipper and advice -----------


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


# ---- what agents of the ramp twin see: the layout of `mbtl.zoo.cmdps.traffic.ramp` ---------------


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


# ---- the whole -------------------------------------------------------------------------------


_FACTORS, _NOISE = 4, (5, 6, 7)  # streams of random numbers; noise of main, side and end
_FEW = 6  # rows of `side` that are computed while no simulation needs more
_END_ROWS = 8


@dataclass(frozen=True)
class RampTwin(Holds):
    """Some advised cars among many; constants are those of the SUMO environment.

    Attributes:
        action: an acceleration in -1..1, or a speed level.
        roads: lengths and the limit.
        drivers: how cars move, of both kinds.
        flows: of the main road and the ramp.
        every: one car of the main road in so many is advised, beginning with the first.
        max_speed: of the cars [m/s].
        speed_factor: standard deviation of the desired speed around the limit, a share.
        noise: standard deviation of a human's acceleration [m/s^2].
        warm_up: simulation steps without advice.
        unmeasured: advised steps before the score counts.
        total_steps: advised steps; the last hold may go beyond.
        push: strongest advised acceleration and braking [m/s^2].
        top_speed: highest advised speed [m/s].
        collision: what a collided car takes from the reward.
        scale: divisors of distances and speeds in an observation.
        agents: A.
        time_limit: how the end of an episode is reported.
        stale: observe as after the first simulation step of the hold before.
    """

    action: Discrete | Box
    roads: Roads
    drivers: Drivers
    flows: tuple[Flow, Flow]
    every: int
    max_speed: float
    speed_factor: float
    noise: float
    warm_up: int
    unmeasured: int
    total_steps: int
    push: tuple[float, float]
    top_speed: float
    collision: float
    scale: tuple[float, float]
    agents: int
    time_limit: TimeLimit = "truncation"
    stale: bool = False
    n_features: int = 8
    params: type[HoldParams] = HoldParams

    # ---- episodes ----------------------------------------------------------------------------

    def start(self, seeds: jax.Array, params: HoldParams) -> RampState:
        """Empty roads, then the warm-up."""
        n = len(seeds)
        roads, shortest = self.roads, self.drivers.length + self.drivers.min_gap
        zero, nobody = jnp.zeros(n), jnp.full((self.agents, n), NO_CAR)
        none = jnp.zeros(n, jnp.int32)
        state = RampState(
            main=empty(math.ceil((roads.main + roads.merge) / shortest), n),
            side=empty(math.ceil((roads.side + roads.merge) / shortest), n),
            end=empty(_END_ROWS, n),
            waiting=jnp.zeros((2, n), bool),
            entered=none,
            counts=Counts(none, zero, none, none, none, none),
            look=Look(nobody, jnp.zeros((self.n_features, self.agents, n))),
            seed=seeds,
            steps=jnp.int32(0),
        )
        state = jax.lax.fori_loop(
            0, self.warm_up, lambda _, state: self._advance(state, human=True)[0], state
        )
        warm: RampState = state._replace(look=self._look(state))
        return warm

    def observe(self, state: RampState, params: HoldParams) -> Seen:
        """The layout of `mbtl.zoo.cmdps.traffic.ramp`, then the visible features."""
        physical = numbers(state.look, self.scale)
        features = params.visible[..., None, :]  # of all, or of each simulation
        visible = jnp.broadcast_to(features, (*physical.shape[:2], features.shape[-1]))
        obs = jnp.concatenate([physical, visible], axis=-1).astype(jnp.float32)
        return Seen(obs, (state.look.car != NO_CAR).T)

    def step(self, state: RampState, action: jax.Array, params: HoldParams) -> Moved:
        """Follow one instruction per agent for the hold."""
        return self._hold(self._instructed(state, self._told(state, action)), params)

    def drive(self, state: RampState, params: HoldParams) -> Moved:
        """All cars drive by themselves."""
        told = jnp.full((self.agents, len(state.seed)), jnp.inf)
        return self._hold(self._instructed(state, told), params)

    # ---- decisions that last differently long ------------------------------------------------

    def held(self, state: RampState) -> Held:
        """See `mbtl.engine.worlds.beats.Holds`."""
        return Held(jnp.zeros_like(state.counts.speed), state.look, state.look.car)

    def beat(
        self,
        state: RampState,
        held: Held,
        action: jax.Array,
        params: HoldParams,
        beats: Beats,
        now: jax.Array,
    ) -> tuple[Moved, Held]:
        """See `engine.worlds.beats.Holds`; where the episode is over cars drive on uncounted."""
        every, decisions = self.beats(params, beats)
        due, over = now % every == 0, now >= every * decisions
        anew = partial(jax.tree.map, partial(jnp.where, due))
        told = self._instructed(state, self._told(state, action))
        state = state._replace(main=anew(told.main, state.main), end=anew(told.end, state.end))
        held = anew(self.held(state), held)
        state, held = self._through(state, held, beats.steps, due, over)
        ends = ((now + 1) % every == 0) & ~over
        moved = self._decided(state, held, params)
        look = jax.tree.map(partial(jnp.where, ends), moved.state.look, state.look)
        reward = jnp.where(ends[:, None], moved.reward, 0.0)
        return Moved(state._replace(look=look), reward, ends[:, None] & moved.done), held

    def score(self, state: RampState) -> jax.Array:
        """Mean speed of all cars over the measured part [m/s], those that collided standing."""
        return state.counts.speed / jnp.maximum(state.counts.steps, 1)

    def measures(self, state: RampState) -> dict[str, jax.Array]:
        """(n,) what an episode is compared by; see `mbtl.zoo.cmdps.traffic.ramp.Ramp.summary`."""
        counts = state.counts
        hours = jnp.maximum(counts.steps, 1) * (self.drivers.dt / 3600.0)
        return {
            "score": self.score(state),
            "throughput": counts.left / hours,
            "dropped": counts.missed / jnp.maximum(counts.wanted, 1),
            "collided": counts.collided,
        }

    # ---- inside ------------------------------------------------------------------------------

    def _look(self, state: RampState) -> Look:
        return look(state, self.agents, self.every, self.drivers.length, self.scale[0])

    def _instructed(self, state: RampState, told: jax.Array) -> RampState:
        """With instructions of the agents, (A, n), given to their cars."""

        def of(queue: Queue) -> Queue:
            advised = (queue.car >= 0) & (queue.car % self.every == 0)
            place = jnp.maximum(queue.car, 0) // self.every % self.agents
            own = jnp.take_along_axis(told, place, axis=0, mode="promise_in_bounds")
            return queue._replace(told=jnp.where(advised, own, jnp.inf))

        return state._replace(main=of(state.main), end=of(state.end))

    def _told(self, state: RampState, action: jax.Array) -> jax.Array:
        """(A, n) a speed or an acceleration; infinite for a place without a car."""
        action = action.reshape(len(state.seed), self.agents).T
        if isinstance(self.action, Discrete):
            told = self.top_speed * action / (self.action.n - 1)
            told = jnp.minimum(told, self.roads.limit)
        else:
            told = action * jnp.where(action > 0.0, *self.push)
        return jnp.where(state.look.car != NO_CAR, told, jnp.inf)

    def _hold(self, state: RampState, params: HoldParams) -> Moved:
        """One decision of all ramps, as long in each."""
        all_, nobody = jnp.array(True), jnp.array(False)
        state, held = self._through(state, self.held(state), params.hold, all_, nobody)
        return self._decided(state, held, params)

    def _through(
        self, state: RampState, held: Held, steps: jax.Array | int, due: jax.Array, over: jax.Array
    ) -> tuple[RampState, Held]:
        """So many steps; a decision was `due` before them, and where it is `over` none counts."""

        def one(_: int, carry: tuple[RampState, jax.Array]) -> tuple[RampState, jax.Array]:
            state, reward = self._advance(carry[0], human=False, over=over)
            return state, carry[1] + reward

        carry: Any = (state, held.reward)
        if self.stale:
            carry = one(0, carry)
            early = jax.tree.map(partial(jnp.where, due), self._look(carry[0]), held.early)
            held = held._replace(early=early)
        state, reward = jax.lax.fori_loop(int(self.stale), steps, one, carry)
        return state, held._replace(reward=reward)

    def _decided(self, state: RampState, held: Held, params: HoldParams) -> Moved:
        """The end of a decision: what is seen, gained and over."""
        now = self._look(state)
        if self.stale:  # cars that came later have nothing older
            now = now._replace(raw=jnp.where(held.early.car == now.car, held.early.raw, now.raw))
        acting, mean = held.car != NO_CAR, held.reward / params.hold
        done = acting & (now.car != held.car)
        return Moved(state._replace(look=now), jnp.where(acting, mean, 0.0).T, done.T)

    def _advance(
        self, state: RampState, *, human: bool, over: jax.Array | bool = False
    ) -> tuple[RampState, jax.Array]:
        """One simulation step and its reward, (n,)."""

        def cut(side: Queue) -> Queue:
            return Queue(*(field[:_FEW] for field in side))

        def short(state: RampState) -> Any:
            new, reward = self._step(state._replace(side=cut(state.side)), human, over)
            side = jax.tree.map(lambda all, few: all.at[:_FEW].set(few), state.side, new.side)
            return new._replace(side=side), reward

        def long(state: RampState) -> Any:
            return self._step(state, human, over)

        many = there(state.side)[_FEW - 1].any()  # one car at most comes in a step
        found: tuple[RampState, jax.Array] = jax.lax.cond(many, long, short, state)
        return found

    def _step(
        self, state: RampState, human: bool, over: jax.Array | bool
    ) -> tuple[RampState, jax.Array]:
        """The same, with the rows that the state has."""
        constant = isinstance(self.action, Discrete)
        speeds = self.drivers.speeds(state.main, state.side, state.end, constant)
        queues = zip((state.main, state.side, state.end), speeds, strict=True)
        main, side, end = (driven(queue, speed, self.drivers.dt) for queue, speed in queues)
        wants, last_chance = self._demand(state.steps)
        waiting = state.waiting | wants
        enters = waiting & jnp.stack([self._room(queue, k) for k, queue in enumerate((main, side))])
        missed = waiting & ~enters & last_chance
        left = end.x[0] > self.roads.end - EPSILON
        passes = jnp.stack([main.x[0] > 0.0, side.x[0] > 0.0])
        newcomers = self._newcomers(state)

        def rearranged(main: Queue, side: Queue, end: Queue) -> tuple[Queue, Queue, Queue]:
            return (
                with_last(main, passes[0], enters[0], newcomers[0]),
                with_last(side, passes[1], enters[1], newcomers[1]),
                joined(main, side, end, passes, left),
            )

        # conditional also because XLA would else fuse the motion above into every shifted row
        happens = (passes | enters).any() | left.any()
        main, side, end = jax.lax.cond(happens, rearranged, lambda *same: same, main, side, end)
        least = 0.5 * self.drivers.min_gap  # SUMO removes cars that are closer
        (main, side, end), collided = without_collided(
            (main, side, end), self.drivers.length, least
        )
        counts = self._counted(
            state, (main, side, end), left, missed, last_chance, jnp.where(over, 0, collided), over
        )
        moment, queues = state.steps, zip((main, side, end), _NOISE, strict=True)
        main, side, end = (
            self._disturbed(queue, state.seed, stream, moment, human) for queue, stream in queues
        )
        state = state._replace(
            main=main,
            side=side,
            end=end,
            waiting=waiting & ~enters & ~missed,
            entered=state.entered + enters[0],
            counts=counts,
            steps=state.steps + 1,
        )
        return state, left - self.collision * collided

    def _demand(self, step: jax.Array) -> tuple[jax.Array, jax.Array]:
        """(2, 1) a car comes; the one before it that still waits has its last chance."""
        comes = [flow.comes(step) for flow in self.flows]
        goes = [flow.comes(step - flow.patience) for flow in self.flows]
        return jnp.stack(comes)[:, None], jnp.stack(goes)[:, None]

    def _room(self, queue: Queue, k: int) -> jax.Array:
        """(n,) a car can enter."""
        drivers, speed = self.drivers, self.flows[k].speed
        count = there(queue).sum(axis=0)
        last = jnp.maximum(count - 1, 0)
        gap = lane.at(queue.x, last) - drivers.length - self.roads.entry(k, drivers.length)
        braking = (speed - lane.at(queue.speed, last)) * speed * drivers.per_speed
        needed = drivers.min_gap + jnp.maximum(0.0, speed * drivers.model.tau + braking)
        # every row of the ramp is there to be computed or it is not full
        rows = math.ceil((self.roads.lane(k)) / (drivers.length + drivers.min_gap))
        return (count == 0) | ((gap >= needed) & (count < rows))

    def _newcomers(self, state: RampState) -> list[Queue]:
        """The cars that enter in this step if there is room, of either road."""
        spread = 1.0 + self.speed_factor * random.normal(state.seed, _FACTORS, state.steps, 2)
        desired = self.roads.limit * jnp.clip(spread, 0.2, 2.0)
        cars = (state.entered, jnp.full_like(state.entered, RAMP_CAR))
        return [
            Queue(
                x=jnp.full_like(desired[k], self.roads.entry(k, self.drivers.length)),
                speed=jnp.full_like(desired[k], self.flows[k].speed),
                desired=jnp.minimum(desired[k], self.max_speed),
                told=jnp.full_like(desired[k], jnp.inf),
                car=cars[k],
            )
            for k in (0, 1)
        ]

    def _counted(
        self,
        state: RampState,
        queues: tuple[Queue, ...],
        left: jax.Array,
        missed: jax.Array,
        last_chance: jax.Array,
        collided: jax.Array,
        over: jax.Array | bool,
    ) -> Counts:
        """With this step."""
        counts, begins = state.counts, self.warm_up + self.unmeasured
        measured = (state.steps >= begins) & jnp.logical_not(over)
        cars = sum(there(queue).sum(axis=0) for queue in queues)
        total = sum(queue.speed.sum(axis=0) for queue in queues)
        gone = counts.collided + collided
        mean = jnp.where(cars > 0, total / jnp.maximum(cars + gone, 1), 0.0)
        return Counts(
            steps=counts.steps + measured,
            speed=counts.speed + measured * mean,
            left=counts.left + measured * left,
            wanted=counts.wanted + measured * last_chance.sum(),
            missed=counts.missed + measured * missed.sum(axis=0),
            collided=gone,
        )

    def _disturbed(
        self, queue: Queue, seed: jax.Array, stream: int, moment: jax.Array, human: bool
    ) -> Queue:
        """With the noise of the drivers; advised ones have none, but in the warm-up."""
        if self.noise == 0.0:
            return queue
        rows = len(queue.x)
        z = random.coins(seed, stream, moment, max(rows, _MOST_SIDE))[:rows]
        steady = (queue.car < 0) & (queue.car != RAMP_CAR)
        if not human:
            steady |= (queue.car >= 0) & (queue.car % self.every == 0)
        disturbed = jnp.maximum(0.0, queue.speed + self.noise * self.drivers.dt * z)
        return queue._replace(speed=jnp.where(steady, queue.speed, disturbed))


_MOST_SIDE = 32
"""So many random numbers, at least, are of one step, however few rows are computed."""
