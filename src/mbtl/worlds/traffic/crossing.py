"""Traffic signal, twin of `mbtl.cmdps.traffic.signal` (cmdp-spec, 5): same cars, rules and numbers.

Cars come on a lane from which their turn is allowed and stay there: nobody changes lanes, which is
what the twin leaves out. Green phases let no two streams cross, so behind the stop line only the
car before it matters to a driver, until it is well away.

Notation (shapes): n simulations; arrays of cars are (rows, 16, n), lane 4 k + i is lane i of the
k-th approach, and row 0 is its foremost car. x is the front of a car, counted from the beginning of
its road [m], v its speed [m/s]. W cars of a lane enter during a decision at most.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import ClassVar, Literal, NamedTuple, get_args

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from mbtl.worlds import random
from mbtl.worlds.environments import Discrete, TimeLimit
from mbtl.worlds.traffic import crossing_demand, lane
from mbtl.worlds.traffic.crossing_demand import APPROACHES, LANES, LEFT, NEVER, RIGHT
from mbtl.worlds.traffic.crossing_state import (
    VACANT,
    CrossingParams,
    CrossingState,
    Queues,
    Totals,
    Turn,
    moved_up,
    there,
)
from mbtl.worlds.traffic.krauss import Krauss
from mbtl.worlds.world import Moved, Seeded, Seen

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
        usual = 1.0 - np.asarray(crossing_demand.crowded_share(params.inflow), np.float64)
        each = jax.tree.map(lambda x: np.repeat(np.asarray(x), 2, axis=0), params)
        modes = np.tile(np.array([0, 1], np.int32), len(usual))
        return each._replace(crowded=modes), np.stack([usual, 1.0 - usual], axis=1)

    # ---- episodes ----------------------------------------------------------------------------

    def start(self, seeds: jax.Array, params: CrossingParams) -> CrossingState:
        """Empty roads."""
        n, none = len(seeds), jnp.zeros(len(seeds))
        most = crossing_demand.most_per_lane(self.cars, self.straight)
        return CrossingState(
            queues=Queues(*(jnp.full((self.rows, _ALL, n), nobody) for nobody in VACANT)),
            plan=crossing_demand.plan(
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
            after,
            now.come + enters,
            now.time + moves,
            now.lost + jnp.where(moves, lost, 0.0),
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
