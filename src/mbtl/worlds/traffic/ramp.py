"""Highway ramp, twin of `mbtl.cmdps.traffic.ramp` (cmdp-spec, 7.3): same cars, rules and numbers.

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
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp

from mbtl.worlds import random
from mbtl.worlds.environments import Box, Discrete, TimeLimit
from mbtl.worlds.traffic import lane
from mbtl.worlds.traffic.lane import Incomer
from mbtl.worlds.traffic.ramp_speeds import Drivers
from mbtl.worlds.traffic.ramp_state import (
    NO_CAR,
    RAMP_CAR,
    VACANT,
    Counts,
    Flow,
    Look,
    Queue,
    RampParams,
    RampState,
    Roads,
    empty,
    there,
)
from mbtl.worlds.traffic.ramp_view import look, numbers
from mbtl.worlds.world import Moved, Seeded, Seen

_FACTORS, _NOISE = 4, (5, 6, 7)  # streams of random numbers; noise of main, side and end
_EPSILON = 0.1  # metres: SUMO lets tails enter, and fronts leave, that far from a road's end
_FEW = 6  # rows of `side` that are computed while no simulation needs more
_END_ROWS = 8


@dataclass(frozen=True)
class RampTwin(Seeded):
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
    mixes: bool = False
    params: type[RampParams] = RampParams

    def decisions(self, params: RampParams) -> int:
        """Enough holds to fill the controlled time."""
        return math.ceil(self.total_steps / int(params.hold))

    # ---- episodes ----------------------------------------------------------------------------

    def start(self, seeds: jax.Array, params: RampParams) -> RampState:
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
            counts=Counts(zero, none, none, none, none),
            look=Look(nobody, jnp.zeros((self.n_features, self.agents, n))),
            seed=seeds,
            steps=jnp.int32(0),
        )
        state = jax.lax.fori_loop(
            0, self.warm_up, lambda _, state: self._advance(state, human=True)[0], state
        )
        warm: RampState = state._replace(look=self._look(state))
        return warm

    def observe(self, state: RampState, params: RampParams) -> Seen:
        """The layout of `mbtl.cmdps.traffic.ramp`, then the visible features."""
        physical = numbers(state.look, self.scale)
        shape = physical.shape[:2]
        visible = jnp.broadcast_to(params.visible, (*shape, *params.visible.shape))
        obs = jnp.concatenate([physical, visible], axis=-1).astype(jnp.float32)
        return Seen(obs, (state.look.car != NO_CAR).T)

    def step(self, state: RampState, action: jax.Array, params: RampParams) -> Moved:
        """Follow one instruction per agent for the hold."""
        action = action.reshape(len(state.seed), self.agents).T
        if isinstance(self.action, Discrete):
            told = self.top_speed * action / (self.action.n - 1)
            told = jnp.minimum(told, self.roads.limit)
        else:
            told = action * jnp.where(action > 0.0, *self.push)
        told = jnp.where(state.look.car != NO_CAR, told, jnp.inf)
        return self._hold(self._instructed(state, told), params)

    def drive(self, state: RampState, params: RampParams) -> Moved:
        """All cars drive by themselves."""
        told = jnp.full((self.agents, len(state.seed)), jnp.inf)
        return self._hold(self._instructed(state, told), params)

    def score(self, state: RampState) -> jax.Array:
        """Mean speed of all cars over the measured part [m/s], those that collided standing."""
        return state.counts.speed / jnp.maximum(self._measured(state), 1)

    def measures(self, state: RampState) -> dict[str, jax.Array]:
        """(n,) what an episode is compared by; see `mbtl.cmdps.traffic.ramp.Ramp.summary`."""
        counts = state.counts
        hours = jnp.maximum(self._measured(state), 1) * (self.drivers.dt / 3600.0)
        return {
            "score": self.score(state),
            "throughput": counts.left / hours,
            "dropped": counts.missed / jnp.maximum(counts.wanted, 1),
            "collided": counts.collided,
        }

    # ---- inside ------------------------------------------------------------------------------

    def _measured(self, state: RampState) -> jax.Array:
        """Measured steps so far; 0 or less before."""
        return state.steps - self.warm_up - self.unmeasured

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

    def _hold(self, state: RampState, params: RampParams) -> Moved:
        agents = state.look.car

        def one(_: int, carry: tuple[RampState, jax.Array]) -> tuple[RampState, jax.Array]:
            state, reward = self._advance(carry[0], human=False)
            return state, carry[1] + reward

        first: Any = (state, jnp.zeros(len(state.seed)))
        if self.stale:
            first = one(0, first)
        early = self._look(first[0])
        state, reward = jax.lax.fori_loop(int(self.stale), params.hold, one, first)
        now = self._look(state)
        if self.stale:  # cars that came later have nothing older
            now = now._replace(raw=jnp.where(early.car == now.car, early.raw, now.raw))
        acting, mean = agents != NO_CAR, reward / params.hold
        done = acting & (now.car != agents)
        return Moved(state._replace(look=now), jnp.where(acting, mean, 0.0).T, done.T)

    def _advance(self, state: RampState, *, human: bool) -> tuple[RampState, jax.Array]:
        """One simulation step and its reward, (n,)."""

        def cut(side: Queue) -> Queue:
            return Queue(*(field[:_FEW] for field in side))

        def short(state: RampState) -> Any:
            new, reward = self._step(state._replace(side=cut(state.side)), human)
            side = jax.tree.map(lambda all, few: all.at[:_FEW].set(few), state.side, new.side)
            return new._replace(side=side), reward

        def long(state: RampState) -> Any:
            return self._step(state, human)

        many = there(state.side)[_FEW - 1].any()  # one car at most comes in a step
        found: tuple[RampState, jax.Array] = jax.lax.cond(many, long, short, state)
        return found

    def _step(self, state: RampState, human: bool) -> tuple[RampState, jax.Array]:
        """The same, with the rows that the state has."""
        constant = isinstance(self.action, Discrete)
        speeds = self.drivers.speeds(state.main, state.side, state.end, constant)
        queues = zip((state.main, state.side, state.end), speeds, strict=True)
        main, side, end = (self._moved(queue, speed) for queue, speed in queues)
        wants, last_chance = self._demand(state.steps)
        waiting = state.waiting | wants
        enters = waiting & jnp.stack([self._room(queue, k) for k, queue in enumerate((main, side))])
        missed = waiting & ~enters & last_chance
        left = end.x[0] > self.roads.end - _EPSILON
        passes = jnp.stack([main.x[0] > 0.0, side.x[0] > 0.0])
        newcomers = self._newcomers(state)

        def rearranged(main: Queue, side: Queue, end: Queue) -> tuple[Queue, Queue, Queue]:
            return (
                self._with(main, passes[0], enters[0], newcomers[0]),
                self._with(side, passes[1], enters[1], newcomers[1]),
                _joined(main, side, end, passes, left),
            )

        # conditional also because XLA would else fuse the motion above into every shifted row
        happens = (passes | enters).any() | left.any()
        main, side, end = jax.lax.cond(happens, rearranged, lambda *same: same, main, side, end)
        (main, side, end), collided = self._without_collided((main, side, end))
        counts = self._counted(state, (main, side, end), left, missed, last_chance, collided)
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

    def _moved(self, queue: Queue, speed: jax.Array) -> Queue:
        is_car = there(queue)
        x = jnp.where(is_car, queue.x + self.drivers.dt * speed, lane.EMPTY)
        return queue._replace(x=x, speed=jnp.where(is_car, speed, 0.0))

    def _demand(self, step: jax.Array) -> tuple[jax.Array, jax.Array]:
        """(2, 1) a car comes; the one before it that still waits has its last chance."""

        def at(flow: Flow, step: jax.Array) -> jax.Array:
            since = step - flow.first
            return (since >= 0) & (since % flow.every == 0)

        comes = [at(flow, step) for flow in self.flows]
        goes = [at(flow, step - flow.patience) for flow in self.flows]
        return jnp.stack(comes)[:, None], jnp.stack(goes)[:, None]

    def _room(self, queue: Queue, k: int) -> jax.Array:
        """(n,) a car can enter."""
        drivers, speed = self.drivers, self.flows[k].speed
        count = there(queue).sum(axis=0)
        last = jnp.maximum(count - 1, 0)
        gap = lane.at(queue.x, last) - drivers.length - self._entry(k)
        braking = (speed - lane.at(queue.speed, last)) * speed * drivers.per_speed
        needed = drivers.min_gap + jnp.maximum(0.0, speed * drivers.model.tau + braking)
        # every row of the ramp is there to be computed or it is not full
        rows = math.ceil((self._before(k) + self.roads.merge) / (drivers.length + drivers.min_gap))
        return (count == 0) | ((gap >= needed) & (count < rows))

    def _before(self, k: int) -> float:
        return (self.roads.main, self.roads.side)[k]

    def _entry(self, k: int) -> float:
        """Where the front of a car is that has entered."""
        return self.drivers.length + _EPSILON - self._before(k) - self.roads.merge

    def _newcomers(self, state: RampState) -> list[Queue]:
        """The cars that enter in this step if there is room, of either road."""
        spread = 1.0 + self.speed_factor * random.normal(state.seed, _FACTORS, state.steps, 2)
        desired = self.roads.limit * jnp.clip(spread, 0.2, 2.0)
        cars = (state.entered, jnp.full_like(state.entered, RAMP_CAR))
        return [
            Queue(
                x=jnp.full_like(desired[k], self._entry(k)),
                speed=jnp.full_like(desired[k], self.flows[k].speed),
                desired=jnp.minimum(desired[k], self.max_speed),
                told=jnp.full_like(desired[k], jnp.inf),
                car=cars[k],
            )
            for k in (0, 1)
        ]

    def _with(self, queue: Queue, gone: jax.Array, comes: jax.Array, car: Queue) -> Queue:
        """Without the foremost car, if it has gone, and with a last one, if it comes."""
        row = there(queue).sum(axis=0) - gone
        return lane.shifted(queue, VACANT, gone, Incomer(comes, row, car))

    def _without_collided(self, queues: tuple[Queue, ...]) -> tuple[tuple[Queue, ...], jax.Array]:
        """SUMO removes cars that are closer than half the least gap; and how many, (n,)."""
        masks = []
        for queue in queues:
            gap = lane.one_ahead(queue.x - self.drivers.length, lane.FREE) - queue.x
            hits = there(queue) & (gap < 0.5 * self.drivers.min_gap)
            masks.append(hits | lane.one_behind(hits, False))
        collided = sum(mask.sum(axis=0) for mask in masks)
        removed: tuple[Queue, ...] = jax.lax.cond(
            (collided > 0).any(),
            lambda: tuple(_without(q, mask) for q, mask in zip(queues, masks, strict=True)),
            lambda: queues,
        )
        return removed, jnp.asarray(collided)

    def _counted(
        self,
        state: RampState,
        queues: tuple[Queue, ...],
        left: jax.Array,
        missed: jax.Array,
        last_chance: jax.Array,
        collided: jax.Array,
    ) -> Counts:
        """With this step."""
        counts, measured = state.counts, self._measured(state) >= 0
        cars = sum(there(queue).sum(axis=0) for queue in queues)
        total = sum(queue.speed.sum(axis=0) for queue in queues)
        gone = counts.collided + collided
        mean = jnp.where(cars > 0, total / jnp.maximum(cars + gone, 1), 0.0)
        return Counts(
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
        z = random.normal(seed, stream, moment, max(rows, _MOST_SIDE))[:rows]
        steady = (queue.car < 0) & (queue.car != RAMP_CAR)
        if not human:
            steady |= (queue.car >= 0) & (queue.car % self.every == 0)
        disturbed = jnp.maximum(0.0, queue.speed + self.noise * self.drivers.dt * z)
        return queue._replace(speed=jnp.where(steady, queue.speed, disturbed))


_MOST_SIDE = 32
"""So many random numbers, at least, are of one step, however few rows are computed."""


def _joined(main: Queue, side: Queue, end: Queue, passes: jax.Array, left: jax.Array) -> Queue:
    """The cars behind the zipper with those that have passed it."""
    heads = [Queue(*(field[0] for field in queue)) for queue in (main, side)]
    main_first = passes[0] & (~passes[1] | (heads[0].x >= heads[1].x))
    row = there(end).sum(axis=0) - left

    def chosen(first: jax.Array) -> Any:
        return jax.tree.map(lambda a, b: jnp.where(first, a, b), *heads)

    between = Incomer(passes.any(axis=0), row, chosen(main_first))
    last = Incomer(passes.all(axis=0), row + 1, chosen(~main_first))
    return lane.shifted(end, VACANT, left, last, between)


def _without(queue: Queue, gone: jax.Array) -> Queue:
    """The queue without some cars, closed up."""
    order = jnp.argsort(gone, axis=0, stable=True)
    vacated = jnp.take_along_axis(gone, order, axis=0)
    take: Callable[[jax.Array, Any], jax.Array] = lambda field, nobody: jnp.where(  # noqa: E731
        vacated, jnp.asarray(nobody, field.dtype), jnp.take_along_axis(field, order, axis=0)
    )
    return Queue(*(take(field, nobody) for field, nobody in zip(queue, VACANT, strict=True)))
