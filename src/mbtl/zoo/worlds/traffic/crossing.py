"""Traffic signal, twin of `zoo.cmdps.traffic.signal` (cmdp-spec, 5): same cars, rules and numbers.

Cars come on a lane from which their turn is allowed and stay there: nobody changes lanes, which is
what the twin leaves out. Green phases let no two streams cross, so behind the stop line only the
car before it matters to a driver, until it is well away.

Notation (shapes): n simulations; arrays of cars are (rows, 16, n), lane 4 k + i is lane i of the
k-th approach, and row 0 is its foremost car. x is the front of a car, counted from the beginning of
its road [m], v its speed [m/s]. W cars of a lane enter during a decision at most.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import ClassVar, Literal, NamedTuple, get_args

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from mbtl.engine.worlds import random
from mbtl.engine.worlds.environments import Discrete, TimeLimit
from mbtl.engine.worlds.world import Moved, Seeded, Seen
from mbtl.zoo.worlds.traffic import lane
from mbtl.zoo.worlds.traffic.idm import EMERGENCY

# ---- car-following of Krauss, as SUMO integrates it in steps of one second -------------------
#
# Notation: v speed and u the leader's [m/s]; g gap from bumper to bumper, less the smallest one
# [m]; b braking. A step lasts one second, which is also the driver's reaction time, so that speeds
# are metres per step.
#
#     a driver can stop within s metres from speed v    if v <= n b + (s - h) / (n + 1),
#     h = n (n - 1) b / 2 + n b,   n = floor(-1/2 + sqrt(1 + 8 s / b) / 2)
#     behind a leader                                   s = g + metres(u)


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


# What the signal twin knows of intersections


class CrossingParams(NamedTuple):
    """One context, or one per simulation.

    Attributes:
        length: of every approach [m].
        inflow: cars of an episode.
        speed: limit on the roads [m/s].
        crowded: mode of demand, see `crossing_demand.departures`; -1: as it comes.
        visible: (v,) or (n, v) features appended to each observation.
    """

    length: jax.Array
    inflow: jax.Array
    speed: jax.Array
    crowded: jax.Array
    visible: jax.Array


@dataclass(frozen=True)
class Turn:
    """What a car does in the box.

    Attributes:
        speed: limit there [m/s].
        metres: its way through it.
    """

    speed: float
    metres: float


class Queues(NamedTuple):
    """The cars of all lanes, (rows, 16, n); row 0 is the foremost one.

    Attributes:
        x: front [m]; `lane.EMPTY`: there is no car.
        v: [m/s].
        waited: seconds for which a car has stood on its way.
        right: 1 if it turns right, else 0.
    """

    x: jax.Array
    v: jax.Array
    waited: jax.Array
    right: jax.Array


class Totals(NamedTuple):
    """Sums over the decisions of an episode, (n,).

    Attributes:
        waiting: of the seconds for which cars on the approaches had stood.
        queue: cars that stood.
        speed: of the cars on the approaches [m/s].
        cars: on the approaches.
        decisions: so many.
        lost: seconds that cars on the approaches lost, see `CrossingTwin.score`, and those that
            cars waited before they entered.
    """

    waiting: jax.Array
    queue: jax.Array
    speed: jax.Array
    cars: jax.Array
    decisions: jax.Array
    lost: jax.Array


class CrossingState(NamedTuple):
    """n intersections.

    Attributes:
        queues: the cars.
        plan: (K, 16, n) who comes, see `crossing_demand.plan`.
        entered: (16, n) cars of each lane that have come so far.
        phase: (n,) that has green; -1: none had so far.
        held: (n,) decisions for which it has had it.
        time: (n,) seconds since the beginning.
        waiting: (n,) what was added to `totals.waiting` last.
        totals: over the decisions so far.
        cells: (n, 80) what was seen last.
        seed: (n,) uint32.
        steps: decisions since the beginning, of all.
    """

    queues: Queues
    plan: jax.Array
    entered: jax.Array
    phase: jax.Array
    held: jax.Array
    time: jax.Array
    waiting: jax.Array
    totals: Totals
    cells: jax.Array
    seed: jax.Array
    steps: jax.Array


VACANT = Queues(lane.EMPTY, 0.0, 0.0, 0.0)
"""Fields of an empty row."""


def there(x: jax.Array) -> jax.Array:
    """Whether a row holds a car."""
    return x > 0.5 * lane.EMPTY


def moved_up(queues: Queues, most: int) -> Queues:
    """Without the empty rows before the foremost car of each lane, of which there are so many."""
    rows = len(queues.x)
    first = jnp.where(there(queues.x), jnp.arange(rows)[:, None, None], rows).min(axis=0)
    gone = jnp.where(first < rows, first, 0)

    def by(step: int, field: jax.Array, nobody: float) -> jax.Array:
        if step >= rows:
            return field
        tail = jnp.full((step, *field.shape[1:]), nobody)
        return jnp.where(gone & step > 0, jnp.concatenate([field[step:], tail]), field)

    for bit in range(most.bit_length()):
        fields = zip(queues, VACANT, strict=True)
        queues = Queues(*(by(1 << bit, field, nobody) for field, nobody in fields))
    return queues


# ---- who comes to the intersection of the signal twin, when and on which lane ----------------
#
# As `zoo.cmdps.traffic.signal` draws them; lanes are those from which a car's turn is allowed, and
# cars that go straight take the one on which the fewest have come so far.
#
# Notation (shapes): n simulations, N cars of each at most, K of one lane, 16 lanes.


APPROACHES, LANES = 4, 4
LEFT = LANES - 1
"""The lane of an approach from which cars turn left."""

_TIMES, _PLACES, _TURNS, _SIDES = range(4, 8)  # streams of random numbers

CROWDED = 3.0
"""A draw with a number beyond this comes within three quarters of the time, or less."""
_BEYOND = math.exp(-(CROWDED**2))  # luck of such a number

NEVER = 1e6
"""When a car departs that does not exist [s]."""


RIGHT = 0.25
"""Added to the second in which a car departs if it turns right: one number per car is enough."""


def most_per_lane(cars: int, straight: float) -> int:
    """K, so many that a lane gets more by luck of five deviations only."""
    share = (straight + 0.5 * (1.0 - straight)) / (APPROACHES * LEFT)
    mean = cars * max(share, 0.5 * (1.0 - straight) / APPROACHES)
    return math.ceil(mean + 5.0 * math.sqrt(mean)) + 4


def crowded_share(cars: jax.Array) -> jax.Array:
    """Probability of a crowded draw: its largest number is beyond `CROWDED`."""
    return -jnp.expm1(cars * math.log1p(-_BEYOND))


def departures(
    seeds: jax.Array, cars: jax.Array, most: int, seconds: float, crowded: jax.Array | int = -1
) -> jax.Array:
    """(N, n) whole seconds, ascending; `NEVER` beyond the number of cars.

    Args:
        seeds: (n,) uint32.
        cars: how many come, a scalar or (n,).
        most: N.
        seconds: the episode's.
        crowded: 1: only a draw that is, 0: only one that is not, -1: as it comes; as `cars`.
    """
    there = jnp.arange(most)[:, None] < jnp.asarray(cars)
    luck = random.uniform(seeds, _TIMES, jnp.uint32(0), most)
    # the least luck makes the largest number; in a crowded draw the first car has it
    least = -jnp.expm1(jnp.log1p(-luck[0] * crowded_share(jnp.asarray(cars))) / cars)
    floor = jnp.where(crowded == 1, least, jnp.where(crowded == 0, _BEYOND, 0.0))
    luck = luck.at[0].set(jnp.where(crowded == 1, 0.0, luck[0]))
    luck = floor + (1.0 - floor) * luck
    draws = jnp.sqrt(-jnp.log(luck))  # Weibull of shape 2
    ordered = jnp.sort(jnp.where(there, draws, jnp.inf), axis=0)
    low = jnp.floor(ordered[1])
    high = jnp.ceil(jnp.where(there, draws, 0.0).max(axis=0))
    times = jnp.rint((ordered - low) / (high - low) * seconds)
    return jnp.where(there, jnp.clip(times, 0.0, seconds), NEVER)


def plan(
    seeds: jax.Array,
    cars: jax.Array,
    most: int,
    per_lane: int,
    seconds: float,
    straight: float,
    crowded: jax.Array | int = -1,
) -> jax.Array:
    """(K, 16, n) when the cars of a lane depart, one after the other, and `RIGHT` if they turn so.

    `NEVER`: there is no such car. Arguments as in `departures`, with K and the share straight on.
    """
    times = departures(seeds, cars, most, seconds, crowded)
    moment = jnp.uint32(0)
    ahead = random.uniform(seeds, _TURNS, moment, most) < straight
    entry = jnp.floor(random.uniform(seeds, _PLACES, moment, most) * APPROACHES).astype(jnp.int32)
    left = ~ahead & (random.uniform(seeds, _SIDES, moment, most) < 0.5)
    right = ~ahead & ~left
    n = times.shape[1]
    lanes = jnp.arange(APPROACHES * LANES)[:, None]

    def one(count: jax.Array, car: tuple[jax.Array, ...]) -> tuple[jax.Array, jax.Array]:
        time, entry, left, right = car
        first = entry * LANES
        counts = jnp.take_along_axis(count, first + jnp.arange(LEFT)[:, None], axis=0)
        fewest = jnp.argmin(counts, axis=0).astype(jnp.int32)
        lane = first + jnp.where(left, LEFT, jnp.where(right, 0, fewest))
        number = jnp.take_along_axis(count, lane[None], axis=0)[0]
        number = jnp.where(time < NEVER, number, per_lane)
        count = count + ((lanes == lane) & (time < NEVER))
        return count, jnp.stack([number, lane])

    none = jnp.zeros((APPROACHES * LANES, n), jnp.int32)
    _, found = jax.lax.scan(one, none, (times, entry, left, right))
    number, lane, which = found[:, 0], found[:, 1], jnp.arange(n)[None]
    size = (per_lane, APPROACHES * LANES, n)
    place = (number, lane, jnp.broadcast_to(which, number.shape))
    return jnp.full(size, NEVER).at[place].set(times + jnp.where(right, RIGHT, 0.0), mode="drop")


# ---- the whole -------------------------------------------------------------------------------


_LUCK = 8  # stream of random numbers
_ALL = APPROACHES * LANES
_FAR = 1e6  # where nothing is to be minded [m]
_COME = 8
"""W: at 10 m/s cars enter 17 m apart at least, which takes two seconds."""


Score = Literal["delay", "paper"]
"""What an episode is worth: seconds of delay per car, or the paper's sum of accumulated waiting."""
Way = Literal["fixed_time", "actuated"]
FIXED = (0, 0, 0, 1, 2, 2, 2, 3)
"""A fixed cycle, a phase per decision: 30 s for cars that go straight, 10 s for left turns."""
_GAP, _LONGEST = 40.0, 5
"""An actuated light keeps green while a car is that near [m], for so many decisions at most."""


class _Second(NamedTuple):
    """What changes within a decision.

    Attributes:
        queues: the cars.
        come: (16, n) cars that have come since the decision.
        time: (n,) seconds since the beginning of the episode.
        lost: (n,) as in `Totals`, since the decision.
    """

    queues: Queues
    come: jax.Array
    time: jax.Array
    lost: jax.Array


@dataclass(frozen=True)
class CrossingTwin(Seeded):
    """One intersection; constants are those of the SUMO environment.

    Attributes:
        driver: the car-following model of all.
        car: length of a car [m].
        min_gap: of a standing queue [m].
        max_speed: of a car [m/s].
        entry_speed: at most [m/s].
        clearance: from the start of the road to the back of a car that enters [m].
        left: turn from the innermost lane.
        right: turn from the outermost one.
        straight: share of the cars that go straight.
        green: seconds.
        yellow: seconds before it, if the phase changes.
        total_seconds: of an episode.
        cells: (10,) upper edges of the cells on the nominal approach [m].
        nominal_length: of an approach [m].
        halted: a car that is not faster stands [m/s].
        easing: a car that accelerates more does not wait [m/s^2].
        jam: score at which an episode ends.
        scored: what an episode is worth.
        way: who decides where nobody else does: a fixed cycle, or whoever looks for gaps.
        action: a phase.
        cars: of an episode at most.
        rows: cars of a lane at most; while there are as many, none enters.
        few: rows that are computed while no simulation needs more, ascending.
        away: metres behind the turn, or the stop line, from where nobody minds a car any more.
        time_limit: how the end of an episode is reported.
    """

    driver: Krauss
    car: float
    min_gap: float
    max_speed: float
    entry_speed: float
    clearance: float
    left: Turn
    right: Turn
    straight: float
    green: int
    yellow: int
    total_seconds: int
    cells: tuple[float, ...]
    nominal_length: float
    halted: float
    easing: float
    jam: float
    action: Discrete
    cars: int
    rows: int
    few: tuple[int, ...] = (12, 24)
    away: float = 40.0
    time_limit: TimeLimit = "truncation"
    agents: int = 1
    scored: Score = "delay"
    way: Way = "fixed_time"
    drives: bool = False
    ways: ClassVar[tuple[str, ...]] = get_args(Way)
    n_features: int = 80
    params: type[CrossingParams] = CrossingParams

    def decisions(self, params: CrossingParams) -> int:
        """Of an episode in which one phase has green all the time; others have fewer."""
        return self.total_seconds // self.green

    def strata(self, params: CrossingParams) -> tuple[CrossingParams, NDArray[np.float64]]:
        """Each context in the two modes of demand, (C x 2, ...), and their shares, (C, 2)."""
        usual = 1.0 - np.asarray(crowded_share(params.inflow), np.float64)
        each = jax.tree.map(lambda x: np.repeat(np.asarray(x), 2, axis=0), params)
        modes = np.tile(np.array([0, 1], np.int32), len(usual))
        return each._replace(crowded=modes), np.stack([usual, 1.0 - usual], axis=1)

    # ---- episodes ----------------------------------------------------------------------------

    def start(self, seeds: jax.Array, params: CrossingParams) -> CrossingState:
        """Empty roads."""
        n, none = len(seeds), jnp.zeros(len(seeds))
        most = most_per_lane(self.cars, self.straight)
        return CrossingState(
            queues=Queues(*(jnp.full((self.rows, _ALL, n), nobody) for nobody in VACANT)),
            plan=plan(
                seeds,
                params.inflow,
                self.cars,
                most,
                float(self.total_seconds),
                self.straight,
                params.crowded,
            ),
            entered=jnp.zeros((_ALL, n), jnp.int32),
            phase=jnp.full(n, -1, jnp.int32),
            held=jnp.zeros(n, jnp.int32),
            time=none,
            waiting=none,
            totals=Totals(*[none] * len(Totals._fields)),
            cells=jnp.zeros((n, self.n_features)),
            seed=seeds,
            steps=jnp.int32(0),
        )

    def observe(self, state: CrossingState, params: CrossingParams) -> Seen:
        """A cell is 1 where a car is: 8 groups x 10 cells; then the visible features."""
        shape = (len(state.cells), params.visible.shape[-1])
        visible = jnp.broadcast_to(params.visible, shape).astype(jnp.float32)
        obs = jnp.concatenate([state.cells, visible], axis=1)
        return Seen(obs[:, None], ~self.over(state)[:, None])

    def step(self, state: CrossingState, action: jax.Array, params: CrossingParams) -> Moved:
        """Green to one phase for 10 s, after 4 s of yellow if another had it."""
        phase = action.reshape(-1).astype(jnp.int32)
        need = there(state.queues.x).sum(axis=0).max() + _COME
        level = sum((need >= size).astype(jnp.int32) for size in self.few)
        sizes = [partial(self._decision, size) for size in (*self.few, self.rows)]
        moved: Moved = jax.lax.switch(level, sizes, state, phase, params)
        return moved

    def drive(self, state: CrossingState, params: CrossingParams) -> Moved:
        """A decision of the light's own, by its `way`."""
        if self.way == "fixed_time":
            phase = jnp.asarray(FIXED)[state.steps % len(FIXED)]
            phase = jnp.broadcast_to(phase, state.phase.shape)
        else:
            phase = self._actuated(state, params)
        return self.step(state, phase[:, None], params)

    def _actuated(self, state: CrossingState, params: CrossingParams) -> jax.Array:
        """(n,) the phase as it is while its cars come, then the next for which some are there."""
        left = params.length - state.queues.x
        on_road = there(state.queues.x) & (left >= 0.0)
        greens = jnp.asarray(_greens())
        near, some = (
            (greens[:, :, None] & cars.any(axis=0)).any(axis=1)  # (4, n)
            for cars in (on_road & (left < _GAP), on_road)
        )
        now = jnp.maximum(state.phase, 0)
        keeps = jnp.take_along_axis(near, now[None], axis=0)[0] & (state.held < _LONGEST)
        turns = (now + jnp.arange(1, len(greens))[:, None]) % len(greens)
        asks = jnp.take_along_axis(some, turns, axis=0)
        following = jnp.take_along_axis(turns, asks.argmax(axis=0)[None], axis=0)[0]
        return jnp.where(keeps | ~asks.any(axis=0), now, following).astype(jnp.int32)

    def over(self, state: CrossingState) -> jax.Array:
        """The time is up, or there is a jam."""
        return (state.time >= self.total_seconds) | (self.score(state) <= self.jam)

    def score(self, state: CrossingState) -> jax.Array:
        """What `Signal` says of its two scores; both only fall."""
        return -self.delay(state) if self.scored == "delay" else -self.waiting(state)

    def waiting(self, state: CrossingState) -> jax.Array:
        """Accumulated waiting of the cars, summed over decisions, over the episode's seconds."""
        return state.totals.waiting / self.total_seconds

    def delay(self, state: CrossingState) -> jax.Array:
        """Seconds per car of the demand that were lost before the stop line so far.

        On the approach a second counts 1 - v/limit; a second of waiting to enter counts 1.
        """
        number = jnp.arange(len(state.plan))[:, None, None]
        outside = (number >= state.entered) & (state.plan < NEVER)
        waits = jnp.where(outside, jnp.maximum(state.time - jnp.floor(state.plan), 0.0), 0.0)
        cars = (state.plan < NEVER).sum(axis=(0, 1))
        return (state.totals.lost + waits.sum(axis=(0, 1))) / jnp.maximum(cars, 1)

    def measures(self, state: CrossingState) -> dict[str, jax.Array]:
        """(n,) what an episode is compared by, as the environment's `info` has it."""
        totals = state.totals
        due = (state.plan <= state.time).sum(axis=(0, 1))
        return {
            "score": self.score(state),
            "delay": self.delay(state),
            "waiting": self.waiting(state),
            "mean_queue": totals.queue / jnp.maximum(totals.decisions, 1.0),
            "mean_speed": totals.speed / jnp.maximum(totals.cars, 1.0),
            "not_inserted": due - state.entered.sum(axis=0),
        }

    # ---- a decision --------------------------------------------------------------------------

    def _decision(
        self, rows: int, state: CrossingState, phase: jax.Array, params: CrossingParams
    ) -> Moved:
        """`step` where so many rows are enough."""
        running = ~self.over(state)
        changes = running & (state.phase >= 0) & (state.phase != phase)
        queues = Queues(*(field[:rows] for field in state.queues))
        soon = state.entered + jnp.arange(_COME)[:, None, None]
        coming = jnp.take_along_axis(state.plan, soon, axis=0, mode="fill", fill_value=NEVER)
        count = there(queues.x).sum(axis=0)
        nothing = jnp.zeros_like(state.time)
        now = _Second(queues, jnp.zeros_like(state.entered), state.time, nothing)
        first = state.steps * (self.yellow + self.green)

        def second(shows: jax.Array, moves: jax.Array, k: jax.Array, now: _Second) -> _Second:
            size = rows * _ALL, self.rows * _ALL
            luck = random.uniform(state.seed, _LUCK, first + k, *size).reshape(queues.x.shape)
            moves = moves & (now.time < self.total_seconds)
            return self._second(now, shows, moves, luck, coming, count, params)

        dark = jnp.zeros((_ALL, len(phase)), bool)
        now = jax.lax.fori_loop(0, self.yellow, partial(second, dark, changes), now)
        shows = jnp.asarray(_greens())[phase].T
        end = self.yellow + self.green
        now = jax.lax.fori_loop(self.yellow, end, partial(second, shows, running), now)

        on_road = there(now.queues.x) & (now.queues.x <= params.length)
        moved, reward = self._booked(state, now, on_road, running)
        cells = self._cells(now.queues.x, on_road, params)
        over = self.over(moved)
        queues = moved_up(now.queues, end)
        queues = queues._replace(x=jnp.where(over, lane.EMPTY, queues.x))  # nobody minds them now
        moved = moved._replace(
            queues=Queues(
                *(old.at[:rows].set(new) for old, new in zip(state.queues, queues, strict=True))
            ),
            entered=state.entered + now.come,
            phase=jnp.where(running, phase, state.phase),
            held=jnp.where(changes | (state.phase < 0), 1, state.held + running),
            cells=jnp.where(running[:, None], cells, state.cells),
            steps=state.steps + 1,
        )
        jammed = running & (self.score(moved) <= self.jam)
        return Moved(moved, reward[:, None], jammed[:, None])

    def _second(
        self,
        now: _Second,
        green: jax.Array,
        moves: jax.Array,
        luck: jax.Array,
        coming: jax.Array,
        count: jax.Array,
        params: CrossingParams,
    ) -> _Second:
        """One simulation step of those that move: cars drive, then some enter.

        Args:
            now: before it.
            green: (16, n) lanes that have green.
            moves: (n,).
            luck: (rows, 16, n) of the drivers.
            coming: (W, 16, n) the cars of `plan` that come next.
            count: (16, n) cars that were there at the decision, those that have left included.
            params: of the contexts.
        """
        queues = now.queues
        v = self._speeds(queues, green, luck, params)
        _, metres = self._turns(queues.right)
        x = queues.x + v
        x = jnp.where(there(queues.x) & (x < params.length + metres + self.away), x, lane.EMPTY)
        stands = (v <= self.halted) & (v - queues.v <= self.easing)
        waited = queues.waited + stands

        # the last car has the smallest x of all
        tail = jnp.where(there(x), x, _FAR).min(axis=0)
        row = jnp.arange(len(x))[:, None, None]
        place = count + now.come
        slow = jnp.where(row == place - 1, v, 0.0).sum(axis=0)
        entry = jnp.minimum(self.entry_speed, params.speed)
        room = tail - (self.car + self.min_gap + self.clearance + self.car)
        free = self.driver.able_to_stop(room + self.driver.metres(slow)) >= entry
        next_ = jnp.where(jnp.arange(_COME)[:, None, None] == now.come, coming, 0.0).sum(axis=0)
        due = (next_ <= now.time + 0.5) & (now.come < _COME)
        enters = due & free & (place < len(x) - 1) & moves
        turns_right = jnp.where(next_ > jnp.floor(next_), 1.0, 0.0)
        new = (row == place) & enters

        def kept(came: jax.Array | float, after: jax.Array, before: jax.Array) -> jax.Array:
            return jnp.where(new, came, jnp.where(moves, after, before))

        after = Queues(
            x=kept(self.clearance + self.car, x, queues.x),
            v=kept(entry, v, queues.v),
            waited=kept(0.0, waited, queues.waited),
            right=jnp.where(new, turns_right, queues.right),
        )
        on_road = there(after.x) & (after.x <= params.length)
        limit = jnp.minimum(params.speed, self.max_speed)
        lost = jnp.where(on_road, 1.0 - after.v / limit, 0.0).sum(axis=(0, 1))
        lost += jnp.where(enters, now.time - jnp.floor(next_), 0.0).sum(axis=0)
        return _Second(
            after, now.come + enters, now.time + moves, now.lost + jnp.where(moves, lost, 0.0)
        )

    def _speeds(
        self, queues: Queues, green: jax.Array, luck: jax.Array, params: CrossingParams
    ) -> jax.Array:
        """(rows, 16, n) of the next step."""
        (x, v, _, right), driver = queues, self.driver
        limit = jnp.minimum(params.speed, self.max_speed)
        # the last row is always empty, so that nobody is ahead of row 0
        ahead, leader, turn = (jnp.roll(field, 1, axis=0) for field in (x, v, right))
        back = ahead - self.car
        minded = there(ahead) & ((turn == right) | (back <= params.length))
        room = jnp.where(minded, back - self.min_gap - x + driver.metres(leader), _FAR)

        left = params.length - x
        braking = driver.metres(v)
        stop = left - jnp.clip(left - braking, lane.LEAST_FROM_LINE, lane.STOP_FROM_LINE)
        halts = (left >= 0.0) & ~green & (left >= braking)
        room = jnp.minimum(room, jnp.where(halts, stop, _FAR))

        speed, metres = self._turns(right)
        speed = jnp.minimum(speed, limit)
        turning = (left < 0.0) & (left > -metres)
        most = jnp.minimum(driver.able_to_stop(room), jnp.where(turning, speed, limit))
        before = jnp.minimum(most, driver.slowing(left, speed))
        return driver.next_speed(v, jnp.where(left >= 0.0, before, most), luck)

    def _turns(self, right: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Limit [m/s] and way [m] in the box, both as if there were none for who goes straight."""
        is_left = jnp.asarray(np.arange(_ALL) % LANES == LEFT)[:, None]
        speed = jnp.where(is_left, self.left.speed, _FAR)
        metres = jnp.where(is_left, self.left.metres, 0.0)
        turns = right > 0.0
        return jnp.where(turns, self.right.speed, speed), jnp.where(
            turns, self.right.metres, metres
        )

    def _booked(
        self, state: CrossingState, now: _Second, on_road: jax.Array, running: jax.Array
    ) -> tuple[CrossingState, jax.Array]:
        """With the sums at the end of a decision, and its reward."""

        def added(total: jax.Array, what: jax.Array) -> jax.Array:
            found = jnp.where(on_road, what, 0.0).sum(axis=(0, 1))
            return total + jnp.where(running, found, 0.0)

        queues, totals = now.queues, state.totals
        one = jnp.ones_like(queues.v)
        waiting = added(jnp.zeros_like(state.waiting), queues.waited)
        waiting = jnp.where(running, waiting, state.waiting)
        sums = Totals(
            waiting=totals.waiting + jnp.where(running, waiting, 0.0),
            queue=added(totals.queue, one * (queues.v < self.halted)),
            speed=added(totals.speed, queues.v),
            cars=added(totals.cars, one),
            decisions=totals.decisions + running,
            lost=totals.lost + now.lost,
        )
        booked = state._replace(time=now.time, waiting=waiting, totals=sums)
        return booked, state.waiting - waiting

    def _cells(self, x: jax.Array, on_road: jax.Array, params: CrossingParams) -> jax.Array:
        """(n, 80) whether there is a car, group by group."""
        scaled = (params.length - x) * (self.nominal_length / params.length)
        scaled = jnp.where(on_road, scaled, -1.0)
        edges = (0.0, *self.cells[:-1], _FAR)
        inside = [((scaled >= low) & (scaled < high)).any(axis=0) for low, high in pairwise(edges)]
        cells = jnp.stack(inside).reshape(len(inside), APPROACHES, LANES, -1)
        groups = jnp.stack([cells[:, :, :LEFT].any(axis=2), cells[:, :, LEFT]], axis=2)
        return groups.transpose(3, 1, 2, 0).reshape(x.shape[2], -1).astype(jnp.float32)


def _greens() -> NDArray[np.bool_]:
    """(4, 16) lanes that have green in each phase: north-south, its left turns, east-west, ..."""
    approach, number = np.divmod(np.arange(_ALL), LANES)
    return np.array(
        [(approach % 2 == k) & ((number == LEFT) == left) for k in (1, 0) for left in (False, True)]
    )


assert RIGHT < 0.5  # or cars that turn right would come a second late
