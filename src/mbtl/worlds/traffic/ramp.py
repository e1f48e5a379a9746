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
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp

from mbtl.worlds import random
from mbtl.worlds.beats import HoldParams, Holds
from mbtl.worlds.environments import Beats, Box, Discrete, TimeLimit
from mbtl.worlds.traffic import lane
from mbtl.worlds.traffic.ramp_queues import driven, joined, with_last, without_collided
from mbtl.worlds.traffic.ramp_speeds import Drivers
from mbtl.worlds.traffic.ramp_state import (
    EPSILON,
    NO_CAR,
    RAMP_CAR,
    Counts,
    Flow,
    Held,
    Look,
    Queue,
    RampState,
    Roads,
    empty,
    there,
)
from mbtl.worlds.traffic.ramp_view import look, numbers
from mbtl.worlds.world import Moved, Seen

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
        """The layout of `mbtl.cmdps.traffic.ramp`, then the visible features."""
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
        """See `mbtl.worlds.beats.Holding`."""
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
        """See `mbtl.worlds.beats.Holding`; where the episode is over cars drive on uncounted."""
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
        """(n,) what an episode is compared by; see `mbtl.cmdps.traffic.ramp.Ramp.summary`."""
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
        self,
        state: RampState,
        held: Held,
        steps: jax.Array | int,
        due: jax.Array,
        over: jax.Array,
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
