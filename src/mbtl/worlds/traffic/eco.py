"""Eco-driving road, twin of `mbtl.cmdps.traffic.eco` (cmdp-spec, 6): same cars, rules and numbers.

Notation (shapes): n simulations, A places for agents; arrays of cars are (rows, n). `main` holds
the cars of the straight feeder and of the region behind it, `side` those of the side feeder; a car
that passes the ghost light moves from there into `main`, in the order of positions. x counts from
the ghost light, negative on the feeders.

Agents are the controlled cars in the region; the foremost A of them, so that beyond A cars a
controlled car drives by itself until there is a place. A place belongs to one car until it leaves
the region; the car that enters next takes the next place in turn.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar, Literal, get_args

import jax
import jax.numpy as jnp

from mbtl.errors import InvalidInput
from mbtl.worlds.environments import Box, Law, TimeLimit
from mbtl.worlds.traffic import eco_rewards, eco_rules, lane
from mbtl.worlds.traffic.arrivals import Car, Demand
from mbtl.worlds.traffic.eco_rewards import Reward
from mbtl.worlds.traffic.eco_speeds import speeds
from mbtl.worlds.traffic.eco_state import (
    Costs,
    EcoParams,
    EcoState,
    Look,
    Road,
    Stops,
    Totals,
    Trip,
)
from mbtl.worlds.traffic.eco_view import view
from mbtl.worlds.traffic.lane import Cars, Incomer
from mbtl.worlds.traffic.light import Light
from mbtl.worlds.world import Moved, Seeded, Seen, everyone

Score = Literal["everyone", "paper"]
"""What an episode is worth: the mean speed of all cars, those waiting to enter included, or of the
cars that completed their trip while they were in the region."""


@dataclass(frozen=True)
class EcoTwin(Seeded):
    """Cars on their way through a light; constants are those of the SUMO environment.

    Attributes:
        action: an acceleration [m/s^2]; in a lesson on speeds, a share of the limit.
        road: geometry.
        light: the signals.
        demand: who comes.
        co2_rate: (speed, acceleration) -> [g/s].
        costs: of the reward.
        stop: what counts as one.
        look: what an observation is made of.
        dt: seconds of a simulation step, which is also a decision.
        warm_up: steps without advice.
        horizon: decisions of an episode.
        rows: cars of the straight feeder and the region; while there are as many, none enters.
        side_rows: cars of the side feeder, likewise.
        agents: A.
        few: rows of `main` and `side` that are computed while no simulation needs more, ascending.
        scored: what an episode is worth.
        reward: what agents are taught by; it changes no score.
        law: what a lesson's actions are in accelerations; None: they are those.
        time_limit: how the end of an episode is reported.
    """

    action: Box
    road: Road
    light: Light
    demand: Demand
    co2_rate: Callable[[jax.Array, jax.Array], jax.Array]
    costs: Costs
    stop: Stops
    look: Look
    dt: float
    warm_up: int
    horizon: int
    rows: int
    side_rows: int
    agents: int
    few: tuple[tuple[int, int], ...] = ((28, 10), (64, 16))
    scored: Score = "everyone"
    reward: Reward = "paper"
    law: Law | None = None
    time_limit: TimeLimit = "truncation"
    n_features: int = 39
    params: type[EcoParams] = EcoParams
    rewards: ClassVar[tuple[str, ...]] = get_args(Reward)
    lessons: ClassVar[tuple[str, ...]] = ("speed",)

    def lesson(self, actions: str) -> EcoTwin:
        """The same road, where speeds are advised.

        What the bounds of an acceleration cut off of such advice is more than a car can do.
        """
        law = Law(self.road.limit / self.dt, _OWN_SPEED, -self.look.speed / self.dt, self.action)
        return replace(self, action=Box((0.0,), (1.0,)), law=law)

    def rule(self, name: str) -> eco_rules.Layers:
        """See `mbtl.worlds.rules.Rules`; they advise speeds."""
        if self.law is None:
            raise InvalidInput(f"the rule {name!r} advises speeds; train with actions='speed'")
        return eco_rules.layers(name)

    def decisions(self, params: EcoParams) -> int:
        """The same in every context."""
        return self.horizon

    # ---- episodes ----------------------------------------------------------------------------

    def start(self, seeds: jax.Array, params: EcoParams) -> EcoState:
        """An empty road, then the warm-up."""
        n = len(seeds)
        count, nothing = jnp.zeros(n, jnp.int32), jnp.zeros(n)
        entered = jnp.zeros((2, n), jnp.int32)
        due, waiting = self.demand.draw(seeds, entered, params.inflow, params.penetration)
        shape = (self.rows, n)
        state = EcoState(
            main=lane.empty(self.rows, n),
            trip=Trip(*(jnp.full(shape, value) for value in _UNBORN)),
            side=lane.empty(self.side_rows, n),
            due=due,
            waiting=waiting,
            entered=entered,
            inflow=jnp.broadcast_to(params.inflow, (n,)),
            row=jnp.full((self.agents, n), -1),
            first=count,
            totals=Totals(count, nothing, nothing, count, nothing, nothing),
            seed=seeds,
            steps=jnp.int32(0),
        )
        short = _cut(state, _FIRST_ROWS)
        warm: EcoState = jax.lax.fori_loop(
            0, self.warm_up, lambda _, state: self._step(state, None, params).state, short
        )
        state = _put(state, warm)
        return state._replace(trip=state.trip._replace(counts=jnp.int32(state.main.x <= 0.0)))

    def observe(self, state: EcoState, params: EcoParams) -> Seen:
        """The layout of `mbtl.cmdps.traffic.eco.LAYOUT`, then the visible features."""
        return everyone(self, state, params)

    def acting(self, state: EcoState) -> jax.Array:
        """See `mbtl.worlds.world.Crowd`."""
        return (state.row >= 0).T

    def views(
        self, state: EcoState, params: EcoParams, simulation: jax.Array, place: jax.Array
    ) -> jax.Array:
        """See `mbtl.worlds.world.Crowd`."""
        return view(self.road, self.light, self.look, self.dt, state, params, simulation, place)

    def step(self, state: EcoState, action: jax.Array, params: EcoParams) -> Moved:
        """One step in which agents do as they are told."""
        return self._advance(state, action[..., 0].T, params)

    def drive(self, state: EcoState, params: EcoParams) -> Moved:
        """One step in which all cars drive by themselves."""
        return self._advance(state, None, params)

    def score(self, state: EcoState) -> jax.Array:
        """Mean speed [m/s], of whom: see `Score`; 0 without any car."""
        return self.mean_speed(state) if self.scored == "everyone" else self.trip_speed(state)

    def trip_speed(self, state: EcoState) -> jax.Array:
        """Mean over completed cars of their mean speed in the region [m/s]; 0 without any."""
        return state.totals.speed / jnp.maximum(state.totals.completed, 1)

    def mean_speed(self, state: EcoState) -> jax.Array:
        """Mean over all cars and steps so far [m/s]; whoever waits to enter stands."""
        waits = self._waited(state.due, state.steps)

        def next_one(found: tuple[jax.Array, ...]) -> tuple[jax.Array, ...]:
            number, due, waited = found
            gap, _ = self.demand.draw(state.seed, number, state.inflow, jnp.float32(1.0))
            return number + 1, due + gap, waited + self._waited(due + gap, state.steps)

        def some_wait(found: tuple[jax.Array, ...]) -> jax.Array:
            return (self._waited(found[1], state.steps) > 0.0).any()

        queue = (state.entered + 1, state.due, waits)  # the cars behind the first are not drawn yet
        waits = jax.lax.while_loop(some_wait, next_one, queue)[2].sum(axis=0)
        return state.totals.speeds / jnp.maximum(state.totals.cars + waits, 1.0)

    def measures(self, state: EcoState) -> dict[str, jax.Array]:
        """(n,) what an episode is compared by, in the units of `mbtl.cmdps.traffic.trips`."""
        totals = state.totals
        cars = jnp.maximum(totals.completed, 1)
        hours = (state.steps - self.warm_up) * (self.dt / 3600.0)
        everyone, trips = self.mean_speed(state), self.trip_speed(state)
        return {
            "score": everyone if self.scored == "everyone" else trips,
            "mean_speed": everyone,
            "trip_speed": trips,
            "co2": totals.co2 / cars,
            "stops": totals.stops / cars,
            "throughput": totals.completed / hours,
            "completed": totals.completed,
        }

    # ---- inside ------------------------------------------------------------------------------

    def _advance(self, state: EcoState, told: jax.Array | None, params: EcoParams) -> Moved:
        """One simulation step; `told` is what is advised to the agents, (A, n)."""

        def shortened(size: tuple[int, int], state: EcoState) -> Moved:
            moved = self._step(_cut(state, size), told, params)
            return moved._replace(state=_put(state, moved.state))

        def crowded(size: tuple[int, int]) -> jax.Array:
            # each step adds at most two cars to `main` and one to `side`
            occupied = state.main.x[size[0] - 2] > 0.5 * lane.EMPTY
            return (occupied | (state.side.x[size[1] - 1] > 0.5 * lane.EMPTY)).any()

        sizes = [partial(shortened, size) for size in self.few]
        whole = partial(self._step, told=told, params=params)
        level = jnp.int32(sum(crowded(size) for size in self.few))
        moved: Moved = jax.lax.switch(level, [*sizes, whole], state)
        return moved

    def _step(self, state: EcoState, told: jax.Array | None, params: EcoParams) -> Moved:
        """The same, with the rows that the state has."""
        time = state.steps * self.dt
        speed, side_speed = self._speeds(state, told, time, params.green)
        main = lane.moved(state.main, speed, self.dt)
        side = lane.moved(state.side, side_speed, self.dt)
        leaves, passes = main.x[0] > self.road.end - _EPSILON, side.x[0] > 0.0
        co2 = self._co2(state.main.speed, speed)
        reward, done = self._rewards(state, speed, co2, leaves)

        started = self._driven(
            _UNBORN, side.x[0], side.speed[0], self._co2(state.side.speed[0], side.speed[0])
        )
        cars = (main, self._driven(state.trip, main.x, speed, co2))
        passing = Incomer(
            passes,
            (main.x > side.x[0]).sum(axis=0) - leaves,
            (Cars(*(field[0] for field in side)), started._replace(side=1)),
        )
        enters, car, tails = self._entering(state, main, side, time)
        entering = [
            Incomer(enters[k], tails[k], Cars(*(field[k] for field in car))) for k in (0, 1)
        ]
        entering_main = entering[0]._replace(
            row=tails[0] - leaves + passes, car=(entering[0].car, _UNBORN)
        )
        entering_side = entering[1]._replace(row=tails[1] - passes)

        def rearranged(cars: tuple[Cars, Trip], side: Cars) -> tuple[tuple[Cars, Trip], Cars]:
            return (
                lane.shifted(cars, (lane.NOBODY, _UNBORN), leaves, entering_main, passing),
                lane.shifted(side, lane.NOBODY, passes, entering_side),
            )

        # conditional also because XLA would else fuse the motion above into every shifted row
        (main, trip), side = jax.lax.cond(
            (leaves | passes | enters).any(), rearranged, lambda *same: same, cars, side
        )
        row, place, first = self._agents(state, main, trip.place, leaves)
        gap, newcomer = self.demand.draw(
            state.seed, state.entered + 1, params.inflow, params.penetration
        )
        waited = jnp.where(enters, self._waited(state.due, state.steps), 0.0).sum(axis=0)
        totals = self._counted(state, leaves)._replace(
            **self._on_the_road(state, main, side, waited)
        )
        state = EcoState(
            main=main,
            trip=trip._replace(place=place),
            side=side,
            due=state.due + jnp.where(enters, gap, 0.0),
            waiting=Car(
                *(jnp.where(enters, a, b) for a, b in zip(newcomer, state.waiting, strict=True))
            ),
            entered=state.entered + enters,
            inflow=state.inflow,
            row=row,
            first=first,
            totals=totals,
            seed=state.seed,
            steps=state.steps + 1,
        )
        return Moved(state, reward.T, done.T)

    def _speeds(
        self, state: EcoState, told: jax.Array | None, time: jax.Array, green: jax.Array
    ) -> tuple[jax.Array, jax.Array]:
        go, side_go = self.light.straight(green, time), self.light.side(green, time)
        main = state.main
        speed, side = speeds(self.road, self.dt, main, state.trip.side, state.side, go, side_go)
        if told is not None:
            if self.law is None:
                target = _at(main.speed, state.row) + self.dt * told
            else:
                target = self.road.limit * told
            target = jnp.clip(target, 0.0, self.road.limit)
            place = state.trip.place
            slowest = main.speed - self.dt * main.decel
            obeyed = jnp.maximum(jnp.minimum(speed, _at(target, place)), slowest)
            speed = lane.bounded(main, jnp.where(place >= 0, obeyed, speed), self.dt)
        return speed, side

    def _co2(self, before: jax.Array, after: jax.Array) -> jax.Array:
        """Of one step [g]."""
        return self.co2_rate(after, (after - before) / self.dt) * self.dt

    def _rewards(
        self, state: EcoState, speed: jax.Array, co2: jax.Array, leaves: jax.Array
    ) -> tuple[jax.Array, jax.Array]:
        """(A, n) rewards, and whose life ends."""
        if self.reward == "paper":
            reward = _at(eco_rewards.paper(self.costs, speed, co2), state.row)
        elif self.reward == "delay":
            reward = _at(eco_rewards.delay(self.road.limit, speed), state.row)
        else:
            start = 0.0 if self.reward == "platoon" else 0.5 * lane.EMPTY
            lost = jnp.where(state.main.x > start, eco_rewards.delay(self.road.limit, speed), 0.0)
            reward = eco_rewards.of_platoons(lost, state.row)
        done = (state.row == 0) & leaves
        return jnp.where((state.row >= 0) & ~done, reward, 0.0), done

    def _driven(self, trip: Trip, x: jax.Array, speed: jax.Array, co2: jax.Array) -> Trip:
        """Trips after a step that ended in the region, at this speed."""
        inside = x > 0.0
        was_moving = trip.moving > 0
        halted = inside & was_moving & (speed < self.stop.halted)
        moving = inside & ((speed > self.stop.moving) | (was_moving & ~halted))
        return trip._replace(
            steps=trip.steps + inside,
            distance=trip.distance + jnp.where(inside, self.dt * speed, 0.0),
            co2=trip.co2 + jnp.where(inside, co2, 0.0),
            stops=trip.stops + halted,
            moving=jnp.int32(moving),
        )

    def _counted(self, state: EcoState, leaves: jax.Array) -> Totals:
        """With the foremost car, if it has left and counts."""
        totals, trip = state.totals, Trip(*(field[0] for field in state.trip))
        counts = leaves & (trip.counts > 0)
        mean = trip.distance / (jnp.maximum(trip.steps, 1) * self.dt)
        return totals._replace(
            completed=totals.completed + counts,
            speed=totals.speed + jnp.where(counts, mean, 0.0),
            co2=totals.co2 + jnp.where(counts, trip.co2, 0.0),
            stops=totals.stops + jnp.where(counts, trip.stops, 0),
        )

    def _on_the_road(
        self, state: EcoState, main: Cars, side: Cars, waited: jax.Array
    ) -> dict[str, jax.Array]:
        """Totals with all cars after a step; `waited` are steps of those that have just entered."""
        totals, measured = state.totals, state.steps >= self.warm_up
        speeds, cars = jnp.float32(0.0), jnp.float32(0.0)
        for road in (main, side):
            there = road.x > 0.5 * lane.EMPTY
            speeds += jnp.where(there, road.speed, 0.0).sum(axis=0)
            cars += there.sum(axis=0)
        return {
            "speeds": totals.speeds + jnp.where(measured, speeds, 0.0),
            "cars": totals.cars + jnp.where(measured, cars + waited, 0.0),
        }

    def _waited(self, due: jax.Array, steps: jax.Array) -> jax.Array:
        """Steps after the warm-up, of the first `steps`, for which a car due then has waited."""
        first = jnp.maximum(jnp.ceil(due / self.dt), self.warm_up)
        return jnp.maximum(steps - first, 0.0)

    def _entering(
        self, state: EcoState, main: Cars, side: Cars, time: jax.Array
    ) -> tuple[jax.Array, Cars, list[jax.Array]]:
        """Whether the waiting car of each feeder enters, (2, n); it; the row behind the last."""
        road, car = self.road, state.waiting
        enters, fronts, tails = [], [], []
        for k, cars in enumerate((main, side)):
            mine = Car(*(field[k] for field in car))
            count = (cars.x > 0.5 * lane.EMPTY).sum(axis=0)
            last = jnp.maximum(count - 1, 0)
            front = mine.length + (_EPSILON - road.feeders[k])
            vacant = (count == 0) | (lane.at(cars.x, last) > 0.0)
            room = vacant | lane.room(cars, last, front, road.entry_speed, mine)
            free = count < (min(len(main.x), self.rows - _RESERVE), len(side.x))[k]
            enters.append((state.due[k] <= time) & room & free)
            fronts.append(front)
            tails.append(count)
        new = Cars(
            x=jnp.stack(fronts),
            speed=jnp.full_like(car.length, road.entry_speed),
            **car._asdict(),
        )
        return jnp.stack(enters), new, tails

    def _agents(
        self, state: EcoState, main: Cars, place: jax.Array, leaves: jax.Array
    ) -> tuple[jax.Array, jax.Array, jax.Array]:
        """Rows of agents, places of cars and the first place; at most one car gets a place.

        Args:
            state: before.
            main: cars after.
            place: (rows, n) of the same cars, so far.
            leaves: (n,) the foremost car has left.
        """
        row = jnp.where(state.row >= 0, state.row - leaves, -1)
        first = (state.first + (leaves & (state.trip.place[0] >= 0))) % self.agents
        taken, last = (row >= 0).sum(axis=0), row.max(axis=0)
        rows = len(main.x)
        k = jnp.arange(rows)[:, None]
        candidates = (main.controlled > 0) & (main.x > 0.0) & (k > last)
        new = jnp.where(candidates, k, rows).min(axis=0)
        comes = (new < rows) & (taken < self.agents)
        free = (first + taken) % self.agents
        row = jnp.where((jnp.arange(self.agents)[:, None] == free) & comes, new, row)
        return row, jnp.where((k == new) & comes, free, place), first


_EPSILON = 0.1  # metres: SUMO lets tails enter, and fronts leave, that far from a road's end
_FIRST_ROWS = (40, 10)  # of `main` and `side`: more cars do not come in the warm-up
_OWN_SPEED = 0  # where an observation has it
_RESERVE = 8  # rows kept for cars from the side feeder
_UNBORN = Trip(0, -1, 0, 0.0, 0.0, 0, 0, 1)


def _cut(state: EcoState, size: tuple[int, int]) -> EcoState:
    """The state with so many rows."""
    main, trip = jax.tree.map(lambda field: field[: size[0]], (state.main, state.trip))
    side = jax.tree.map(lambda field: field[: size[1]], state.side)
    return state._replace(main=main, trip=trip, side=side)


def _put(state: EcoState, few: EcoState) -> EcoState:
    """The second state, behind its rows those of the first."""
    main, trip, side = jax.tree.map(
        lambda all, rows: all.at[: len(rows)].set(rows),
        (state.main, state.trip, state.side),
        (few.main, few.trip, few.side),
    )
    return few._replace(main=main, trip=trip, side=side)


def _at(field: jax.Array, rows: jax.Array) -> jax.Array:
    """Entries of `rows`, (m, n); nonsense where a row is negative."""
    return jnp.take_along_axis(field, jnp.maximum(rows, 0), axis=0, mode="promise_in_bounds")
