"""Eco-driving road, twin of `zoo.cmdps.traffic.eco` (cmdp-spec, 6): same cars, rules and numbers.

Notation (shapes): n simulations, A places for agents; arrays of cars are (rows, n). `main` holds
the cars of the straight feeder and of the region behind it, `side` those of the side feeder; a car
that passes the ghost light moves from there into `main`, in the order of positions. x counts from
the ghost light, negative on the feeders.

Agents are the controlled cars in the region; the foremost A of them, so that beyond A cars a
controlled car drives by itself until there is a place. A place belongs to one car until it leaves
the region; the car that enters next takes the next place in turn.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import ClassVar, Literal, NamedTuple, get_args

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from mbtl.engine.worlds import random
from mbtl.engine.worlds.environments import Box, Law, TimeLimit
from mbtl.engine.worlds.world import Moved, Seeded, Seen, everyone
from mbtl.errors import InvalidInput, check_known
from mbtl.zoo.worlds.traffic import lane
from mbtl.zoo.worlds.traffic.lane import Ahead, Cars, Incomer

# Two traffic lights of one cycle: the main one, and the ghost that takes turns with it upstream
#
#     green g | yellow | red | yellow        from time 0; the main light is red in the last two
#
# The ghost shows the same to the straight feeder; to the side feeder it shows green in the third.


@dataclass(frozen=True)
class Light:
    """What all contexts share; `green` is an argument, a scalar or (n,), as are the results.

    Attributes:
        yellow: seconds.
        red: seconds from the end of one yellow to the beginning of the next.
    """

    yellow: float
    red: float

    def cycle(self, green: jax.Array) -> jax.Array:
        """Seconds from green to green."""
        return green + (2.0 * self.yellow + self.red)

    def straight(self, green: jax.Array, time: jax.Array) -> jax.Array:
        """Whether the main light, and the ghost to the straight feeder, show green."""
        return self._within(green, time) < green

    def side(self, green: jax.Array, time: jax.Array) -> jax.Array:
        """Whether the ghost shows green to the side feeder."""
        since = self._within(green, time) - green - self.yellow
        return (since >= 0.0) & (since < self.red)

    def seen(self, green: jax.Array, time: jax.Array) -> tuple[jax.Array, ...]:
        """The main light as cars see it.

        Returns:
            Green, yellow, red (one of them is 1), then the seconds until green next begins or ends
            and until the two changes after.
        """
        within, cycle = self._within(green, time), self.cycle(green)
        end, start = green - within, cycle - within
        shows_green, shows_red = end > 0.0, within >= green + self.yellow
        changes = (
            jnp.where(shows_green, end, start),
            jnp.where(shows_green, start, end + cycle),
            jnp.where(shows_green, end, start) + cycle,
        )
        phase = (shows_green, ~shows_green & ~shows_red, shows_red)
        return (*(x.astype(jnp.float32) for x in phase), *changes)

    def _within(self, green: jax.Array, time: jax.Array) -> jax.Array:
        return jnp.mod(time, self.cycle(green))


# ---- who drives into a twin, and when: Poisson arrivals of drivers who differ ----------------
#
# Notation (shapes): n simulations, 2 feeders, the straight one first; arrays are (2, n).


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


# ---- what the eco-driving twin is made of: its constants, its contexts and its state ---------


class EcoParams(NamedTuple):
    """One context, or one per simulation.

    Attributes:
        penetration: probability that a car is controlled; a scalar or (n,), as the next two.
        inflow: cars per hour.
        green: [s].
        visible: (v,) or (n, v) features appended to each observation.
    """

    penetration: jax.Array
    inflow: jax.Array
    green: jax.Array
    visible: jax.Array


class Trip(NamedTuple):
    """What is kept of each car of `main`, (rows, n), beside how it drives.

    Attributes:
        side: it comes from the side feeder; int32, 0 or 1.
        place: of the agent; -1: it drives by itself.
        steps: in the region.
        distance: driven there [m].
        co2: emitted there [g].
        stops: there.
        moving: it has been fast since its last stop; int32, 0 or 1.
        counts: it was not in the region in the warm-up; int32, 0 or 1.
    """

    side: jax.Array
    place: jax.Array
    steps: jax.Array
    distance: jax.Array
    co2: jax.Array
    stops: jax.Array
    moving: jax.Array
    counts: jax.Array


class Totals(NamedTuple):
    """Sums over completed cars, (n,): those that came after the warm-up and have left the region.

    The last two are over all cars and the steps after the warm-up.

    Attributes:
        completed: cars.
        speed: of their mean speeds [m/s].
        co2: [g].
        stops: stops.
        speeds: of all cars on the road, step by step [m/s].
        cars: all that were on the road or had waited to enter it, step by step.
    """

    completed: jax.Array
    speed: jax.Array
    co2: jax.Array
    stops: jax.Array
    speeds: jax.Array
    cars: jax.Array


class EcoState(NamedTuple):
    """n roads.

    Attributes:
        main: cars of the straight feeder and the region.
        trip: of the same cars.
        side: cars of the side feeder.
        due: (2, n) when the next car of each feeder wants to enter [s].
        waiting: that car, (2, n).
        entered: (2, n) cars that have entered.
        inflow: (n,) cars per hour that want to.
        row: (A, n) where in `main` each agent is; -1: nobody has the place.
        first: (n,) place of the foremost agent.
        totals: what the measures are made of.
        seed: (n,) uint32.
        steps: simulation steps since the warm-up began.
    """

    main: Cars
    trip: Trip
    side: Cars
    due: jax.Array
    waiting: Car
    entered: jax.Array
    inflow: jax.Array
    row: jax.Array
    first: jax.Array
    totals: Totals
    seed: jax.Array
    steps: jax.Array


class Road(NamedTuple):
    """Positions of the road, in metres from the ghost light.

    Attributes:
        feeders: lengths of the straight and the side feeder.
        line: the stop line of the main light.
        box: end of the box.
        end: of the region.
        limit: speed limit [m/s].
        entry_speed: [m/s].
    """

    feeders: tuple[float, float]
    line: float
    box: float
    end: float
    limit: float
    entry_speed: float


class Costs(NamedTuple):
    """Reward of an agent: (v - crawling max(0, crawl - v) - co2 E) / scale, E in g per step."""

    crawl: float
    crawling: float
    co2: float
    scale: float


class Stops(NamedTuple):
    """A stop: slower than the first [m/s] after having been faster than the second."""

    halted: float
    moving: float


class Look(NamedTuple):
    """How an agent sees: divisors of speeds, lengths and times, and who is not there."""

    speed: float
    length: float
    time: float
    absent: tuple[float, float, float, float]


# ---- what agents of the eco-driving twin see: `mbtl.zoo.cmdps.traffic.eco.LAYOUT` ----------------


_SIDES = 4  # neighbours on other lanes: as there are none, the car itself


def view(
    road: Road,
    light: Light,
    look: Look,
    dt: float,
    state: EcoState,
    params: EcoParams,
    simulation: jax.Array,
    place: jax.Array,
) -> jax.Array:
    """(..., f) observations of some agents; nonsense where there is none.

    Args:
        road: geometry.
        light: the signals.
        look: scales.
        dt: seconds of a step.
        state: of n roads.
        params: of their contexts.
        simulation: (...) the road of each agent.
        place: (...) its place there.
    """
    main, mine = state.main, jnp.maximum(state.row[place, simulation], 0)
    ahead, behind = jnp.maximum(mine - 1, 0), jnp.minimum(mine + 1, main.x.shape[0] - 1)

    def of(field: jax.Array, row: jax.Array) -> jax.Array:
        return field.at[row, simulation].get(mode="promise_in_bounds")

    def neighbour(there: jax.Array, speed: jax.Array, gap: jax.Array) -> list[jax.Array]:
        seen = (speed / look.speed, gap / look.length, jnp.float32(0.0), jnp.float32(0.0))
        return [jnp.where(there, x, a) for x, a in zip(seen, look.absent, strict=True)]

    x, speed, next_x = of(main.x, mine), of(main.speed, mine), of(main.x, behind)
    own_tail = x - of(main.length, mine)
    tail_ahead = of(main.x, ahead) - of(main.length, ahead)
    green = params.green if params.green.ndim == 0 else params.green[simulation]
    signal = light.seen(green, state.steps * dt)
    numbers = [
        speed / look.speed,
        (road.line - x) / look.length,
        *signal[:3],
        *(seconds / look.time for seconds in signal[3:]),
        x <= road.line,
        (x > road.line) & (x <= road.box),
        x > road.box,
        *map(jnp.float32, (0.0, 0.0, 1.0, 0.0)),  # the only lane, and straight on
        *neighbour(mine > 0, of(main.speed, ahead), tail_ahead - x),
        *neighbour((behind > mine) & (next_x > 0.0), of(main.speed, behind), own_tail - next_x),
        *[speed / look.speed, *map(jnp.float32, (0.0, 0.0, 0.0))] * _SIDES,
    ]
    shape = mine.shape
    columns = [jnp.broadcast_to(column, shape).astype(jnp.float32) for column in numbers]
    visible = params.visible if params.visible.ndim == 1 else params.visible[simulation]
    shown = jnp.broadcast_to(visible, (*shape, visible.shape[-1]))
    return jnp.concatenate([jnp.stack(columns, axis=-1), shown], axis=-1)


# How fast cars of the eco-driving twin drive next: leaders on three roads, and two lights
#
# A driver follows the nearest car or tail on its own road, and, unless a light stops it before, the
# last one on the next road; from the approach also the last one on the exit, and from the feeders
# the main light.


class Last(NamedTuple):
    """The last car whose front is beyond the start of a road, (n,).

    Attributes:
        tail: its back [m]; without a car it is far away.
        speed: [m/s].
        side: it came from the side feeder.
        there: it, or its tail, is on the road.
    """

    tail: jax.Array
    speed: jax.Array
    side: jax.Array
    there: jax.Array


def last_on(main: Cars, side: jax.Array, start: float, end: float) -> Last:
    """The last car on the road from `start` to `end`.

    Args:
        main: cars.
        side: (rows, n) where they came from.
        start: position [m].
        end: position [m].
    """
    count = (main.x > start).sum(axis=0)
    row = jnp.maximum(count - 1, 0)
    tail = lane.at(main.x, row) - lane.at(main.length, row)
    there = (count > 0) & (tail < end)
    return Last(tail, lane.at(main.speed, row), lane.at(side, row) > 0, there)


def speeds(
    road: Road,
    dt: float,
    main: Cars,
    from_side: jax.Array,
    side: Cars,
    go: jax.Array,
    side_go: jax.Array,
) -> tuple[jax.Array, jax.Array]:
    """Speeds after this step of cars that drive by themselves, of `main` and `side`.

    Args:
        road: geometry.
        dt: seconds of the step.
        main: (rows, n).
        from_side: (rows, n) which of them came from the side feeder.
        side: (side_rows, n).
        go: the main light, and the ghost to the straight feeder, show green; a scalar or (n,).
        side_go: the ghost shows green to the side feeder.
    """
    approach = last_on(main, from_side, 0.0, road.line)
    box = last_on(main, from_side, road.line, road.box)
    leaving = last_on(main, from_side, road.box, road.end)

    x = main.x
    feeder, before, within = x <= 0.0, x <= road.line, x <= road.box
    ends = jnp.where(feeder, 0.0, jnp.where(before, road.line, road.box))
    tail = lane.one_ahead(x - main.length, lane.FREE)
    overhangs = ~(feeder & (lane.one_ahead(from_side, 0) > 0)) | (
        lane.one_ahead(x, lane.FREE) <= 0.0
    )
    own = Ahead(
        tail - x, lane.one_ahead(main.speed, road.limit), ((tail < ends) & overhangs) | ~within
    )
    v = lane.follow(main, own, main.min_gap, road.limit, dt)

    can_stop, stop = lane.halt(main, ends - x, dt)
    stopped = before & ~go & can_stop
    blocked = feeder & ~stopped & approach.there & approach.side & (approach.tail < 0.0)
    halts, stop = _blocked(stopped, stop, blocked, x)
    next_tail = jnp.where(feeder, approach.tail, jnp.where(before, box.tail, leaving.tail))
    next_speed = jnp.where(feeder, approach.speed, jnp.where(before, box.speed, leaving.speed))
    next_there = jnp.where(feeder, approach.there, jnp.where(before, box.there, leaving.there))
    v = _onward(
        main, v, halts, stop, Ahead(next_tail - x, next_speed, next_there & within), road, dt
    )

    far = Ahead(
        jnp.where(feeder, road.line - lane.STOP_FROM_LINE, leaving.tail) - x,
        jnp.where(feeder, 0.0, leaving.speed),
        before & ~halts & jnp.where(feeder, ~go, leaving.there),
    )
    far_gap = jnp.where(feeder, 0.0, main.min_gap)
    v = jnp.minimum(v, lane.follow(main, far, far_gap, road.limit, dt))
    v_side = _side_speeds(road, dt, side, approach, go, side_go)
    return lane.bounded(main, v, dt), lane.bounded(side, v_side, dt)


def _side_speeds(
    road: Road, dt: float, side: Cars, approach: Last, go: jax.Array, side_go: jax.Array
) -> jax.Array:
    tail = lane.one_ahead(side.x - side.length, approach.tail)
    speed = lane.one_ahead(side.speed, approach.speed)
    there = lane.one_ahead(jnp.ones(side.x.shape, bool), approach.side & (approach.tail < 0.0))
    v = lane.follow(side, Ahead(tail - side.x, speed, there), side.min_gap, road.limit, dt)
    can_stop, stop = lane.halt(side, -side.x, dt)
    blocked = approach.there & ~approach.side & (approach.tail < 0.0)
    stopped = ~side_go & can_stop
    halts, stop = _blocked(stopped, stop, ~stopped & blocked, side.x)
    onward = Ahead(approach.tail - side.x, approach.speed, approach.there)
    v = _onward(side, v, halts, stop, onward, road, dt)
    line = Ahead(road.line - lane.STOP_FROM_LINE - side.x, jnp.float32(0.0), ~go & ~halts)
    return jnp.minimum(v, lane.follow(side, line, jnp.float32(0.0), road.limit, dt))


def _blocked(
    stopped: jax.Array, stop: Ahead, blocked: jax.Array, x: jax.Array
) -> tuple[jax.Array, Ahead]:
    """With a stop at the ghost where a tail that is still in the other feeder bars the way."""
    near = jnp.maximum(0.0, -lane.LEAST_FROM_LINE - x)
    return stopped | blocked, stop._replace(gap=jnp.where(blocked, near, stop.gap))


def _onward(
    cars: Cars, v: jax.Array, halts: jax.Array, stop: Ahead, onward: Ahead, road: Road, dt: float
) -> jax.Array:
    """The lesser of `v` and what the light, or behind it the next road, allows."""
    ahead = Ahead(
        jnp.where(halts, stop.gap, onward.gap),
        jnp.where(halts, stop.speed, onward.speed),
        halts | onward.there,
    )
    min_gap = jnp.where(halts, 0.0, cars.min_gap)
    followed = lane.follow(cars, ahead, min_gap, road.limit, dt)
    allowed = jnp.where(halts, lane.halting(cars, followed, stop.gap, dt), followed)
    return jnp.minimum(v, allowed)


# ---- what agents of the eco-driving twin can be taught by; none of these is the score --------
#
#     paper     (v - crawling max(0, crawl - v) - co2 E) / scale of the own car (cmdp-spec, 6.2)
#     delay     v / limit - 1 of the own car
#     platoon   the same, summed over the own car and those behind it up to the next agent, as far
#               as they are in the region
#     road      the same, with those who are behind on the straight feeder
#
# The sum of v over a trip is its length whatever the speed, so that `paper` hardly asks for speed;
# the sum of `delay` is the time lost. Delay of the platoon counts those who cannot overtake. As the
# score sees cars in the region only, it pays to keep others out of it; under `road` it does not.


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
    return _placed(before, following) - _placed(before, first)


def _placed(field: jax.Array, rows: jax.Array) -> jax.Array:
    return jnp.take_along_axis(field, rows, axis=0, mode="promise_in_bounds")


# ---- hand-written rules of eco-driving as networks, so that a training can begin with one ----
#
#     glide   arrive at the light when it turns green, slowly first; see docs/eco-driving.md
#
# The files hold layers of tanh that `evidence/eco_clone.py` has fitted to the rule; they see the
# 39 numbers of an agent and advise a speed as a share of the limit.


Layers = tuple[tuple[NDArray[np.float32], NDArray[np.float32]], ...]

RULES = ("glide",)
FOLDER = Path(__file__).parent / "rules"


@cache
def layers(name: str) -> Layers:
    """Weights (n_in, n_out) and biases of each layer.

    Raises:
        UnknownName: there is no such rule.
    """
    check_known("rule of eco-driving", name, RULES)
    with np.load(FOLDER / f"{name}.npz", allow_pickle=False) as file:
        return tuple((file[f"weight_{k}"], file[f"bias_{k}"]) for k in range(len(file.files) // 2))


# ---- the whole -------------------------------------------------------------------------------


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

    def rule(self, name: str) -> Layers:
        """See `mbtl.engine.worlds.world.World`; they advise speeds."""
        if self.law is None:
            raise InvalidInput(f"the rule {name!r} advises speeds; train with actions='speed'")
        return layers(name)

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
        """The layout of `mbtl.zoo.cmdps.traffic.eco.LAYOUT`, then the visible features."""
        return everyone(self, state, params)

    def acting(self, state: EcoState) -> jax.Array:
        """See `mbtl.engine.worlds.world.Crowd`."""
        return (state.row >= 0).T

    def views(
        self, state: EcoState, params: EcoParams, simulation: jax.Array, place: jax.Array
    ) -> jax.Array:
        """See `mbtl.engine.worlds.world.Crowd`."""
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
        """(n,) what an episode is compared by, in the units of `mbtl.zoo.cmdps.traffic.eco`."""
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
            reward = _at(paper(self.costs, speed, co2), state.row)
        elif self.reward == "delay":
            reward = _at(delay(self.road.limit, speed), state.row)
        else:
            start = 0.0 if self.reward == "platoon" else 0.5 * lane.EMPTY
            lost = jnp.where(state.main.x > start, delay(self.road.limit, speed), 0.0)
            reward = of_platoons(lost, state.row)
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
            x=jnp.stack(fronts), speed=jnp.full_like(car.length, road.entry_speed), **car._asdict()
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
