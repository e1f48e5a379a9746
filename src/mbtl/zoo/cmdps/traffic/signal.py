"""Traffic signal: choose the green phase of one four-way intersection (cmdp-spec, 5).

Four approaches of four lanes: the innermost turns left, the outermost goes straight or right, the
others straight. A green lasts 10 s, after 4 s of yellow if the phase changes.

    observation   80 cells, 1 where a car is: 8 groups (W, N, E, S; each: other lanes, left lane)
                  x 10 distances from the stop line; then the visible features
    action        0 north-south, 1 north-south left, 2 east-west, 3 east-west left
    reward        previous minus present total W of accumulated waiting time [s] over the cars on
                  the approaches; cars that have left are dropped (the reference keeps some)
    score         "delay": -(seconds lost before the stop line) per car of the demand: a second on
                  the approach counts 1 - v/limit, and one of waiting to enter counts 1
                  "paper": -(sum of W over all decisions) / 5400, which does not see who waits to
                  enter and has no unit of its own

Beside policies stand two lights of SUMO's own (`follow`): "fixed_time", 30 s of green for cars that
go straight and 10 s for left turns, and "actuated", which keeps green while cars come (SUMO's
defaults, 5 to 50 s).
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar, Literal, NamedTuple, Unpack

import numpy as np
from gymnasium.spaces import Discrete

from mbtl.arrays import Array, Indices
from mbtl.canvas import Window
from mbtl.contexts import Value
from mbtl.errors import ContextMismatch, InvalidInput, check_known
from mbtl.sumo import CARS, network
from mbtl.zoo.cmdps.contextual import Observation
from mbtl.zoo.cmdps.traffic.simulation import Settings, TrafficEnv

# ---- cars of the traffic-signal family: when they come and where they go (cmdp-spec, 5) ------
#
# n departure times are Weibull(2) draws, stretched linearly so that the whole numbers around the
# second smallest and the largest become 0 and the end of the episode, and rounded to seconds. The
# largest lies below 3, or with 12 % of the draws of 1000 cars (27 % of 2500) below 4: then the same
# cars come within three quarters of the time, and the peak is a third higher.


STRAIGHT_SHARE = 0.75
SHAPE = 2.0
LENGTH, DECELERATION = 5.0, 4.5
MIN_GAP, ACCELERATION, SIGMA, MAX_SPEED = 2.5, 1.0, 0.5, 25.0
"""Of all cars, with a reaction time of 1 s."""

_CROWDED = 3.0
"""A draw with a number beyond this comes within three quarters of the time, or less."""

CLEARANCE = 0.1
"""From the start of the road to a car that enters [m]."""

_CHECKS = "collision leaderGap followerGap junction stop arrivalSpeed speedLimit"
"""All of SUMO's that apply but one: it would drop cars that enter a short road on a lane from which
they cannot change, and the demand would depend on the length. Such cars brake for their turn."""

APPROACHES = ("W", "N", "E", "S")
"""In the order of the observation, and clockwise: the exit after next lies straight ahead."""


def crowded_share(n: int) -> float:
    """Probability of a crowded draw of n cars: its largest number is beyond `_CROWDED`."""
    return float(-np.expm1(n * np.log1p(-np.exp(-(_CROWDED**SHAPE)))))


def departures(
    rng: np.random.Generator, n: int, seconds: int, *, crowded: bool | None = None
) -> Array:
    """(n,) sorted departure times, whole seconds in 0..seconds; n >= 2.

    Args:
        rng: draws them.
        n: number of cars.
        seconds: length of the episode.
        crowded: only a draw that is, or is not; None: as it comes.
    """
    draws = np.sort(rng.weibull(SHAPE, n))
    while crowded is not None and bool(draws[-1] > _CROWDED) is not crowded:
        draws = np.sort(rng.weibull(SHAPE, n))
    low, high = np.floor(draws[1]), np.ceil(draws[-1])
    stretched: Array = (draws - low) / (high - low) * seconds
    return np.clip(np.rint(stretched), 0, seconds)


def directions(rng: np.random.Generator, n: int) -> list[tuple[str, str]]:
    """(approach, exit) of n cars: straight on, or left and right alike."""
    straight = rng.random(n) < STRAIGHT_SHARE
    entry = rng.integers(4, size=n)
    turn = np.where(rng.integers(2, size=n) == 0, 1, 3)
    leave = (entry + np.where(straight, 2, turn)) % 4
    return [(APPROACHES[i], APPROACHES[j]) for i, j in zip(entry, leave, strict=True)]


def entry_speed(speed_limit: float) -> float:
    """Speed with which cars enter [m/s]."""
    return min(10.0, speed_limit)


def stopping_distance(speed: float) -> float:
    """Road [m] that a car entering at `speed` fills: itself, a step of reaction, steps of braking.

    SUMO drops cars that enter a road which is not longer.
    """
    steps = int(speed / DECELERATION)
    braking = steps * speed - DECELERATION * steps * (steps + 1) / 2.0
    return LENGTH + CLEARANCE + speed + braking


def routes(
    rng: np.random.Generator,
    n: int,
    seconds: int,
    speed_limit: float,
    *,
    crowded: bool | None = None,
) -> str:
    """XML of one episode's cars; arguments as in `departures`."""
    ways = "".join(
        f'<route id="{a}{b}" edges="{a}_in {b}_out"/>'
        for a in APPROACHES
        for b in APPROACHES
        if a != b
    )
    times = departures(rng, n, seconds, crowded=crowded).tolist()
    cars = "".join(
        f'<vehicle id="{k}" type="car" route="{a}{b}" depart="{time:.0f}" departLane="random" '
        f'departSpeed="{entry_speed(speed_limit):g}" insertionChecks="{_CHECKS}"/>'
        for k, (time, (a, b)) in enumerate(zip(times, directions(rng, n), strict=True))
    )
    kind = (
        f'<vType id="car" carFollowModel="Krauss" accel="{ACCELERATION:g}" '
        f'decel="{DECELERATION:g}" length="{LENGTH:g}" minGap="{MIN_GAP:g}" sigma="{SIGMA:g}" '
        f'tau="1" maxSpeed="{MAX_SPEED:g}" '
        f'speedFactor="1" speedDev="0"/>'
    )
    return f"<routes>{kind}{ways}{cars}</routes>"


# ---- the whole -------------------------------------------------------------------------------


SECONDS = 5400
GREEN, YELLOW = 10, 4
LANES = 4
LEFT_LANE = LANES - 1
CELLS = np.array([7.0, 14.0, 21.0, 28.0, 40.0, 60.0, 100.0, 160.0, 400.0, 750.0])
"""Upper edges of the cells on the nominal approach [m]; they scale with its length."""
BOX = 16.8
"""Half width of the intersection [m]."""
RIGHT_SPEED, LEFT_SPEED = 6.51, 11.36
RIGHT_WAY, LEFT_WAY = 9.0, 30.0
"""Of cars through the box [m], as the twin has it; SUMO draws its own."""
HALTED = 0.1
"""Cars that are not faster stand [m/s]."""
SHORTEST = 7.5
"""A car and the gap before it [m]."""
PATIENCE = 120
"""Seconds for which a car stands at the stop line of a lane without its turn; then it goes where
the lane leads. On short roads cars that each want the other's lane would else stand there for ever,
and nobody behind them could move: there is no teleport. Nothing leaves the demand."""

Score = Literal["delay", "paper"]


class Limits(NamedTuple):
    """Of a score; both only fall within an episode.

    Attributes:
        lowest: of performance 0, the CMDPs' floor: no jam is worse than another. An episode that
            has come to it tells its score so far at once, as `info["final_score"]`: who only
            evaluates need not see the rest.
        jam: where an episode ends as a jam: SUMO needs ten times as long for hundreds of cars that
            stand as for traffic that flows. Not earlier: whoever tries phases at random in dense
            traffic is soon at `lowest` and still has the peak to learn.
        unit: of the score.
    """

    lowest: float
    jam: float
    unit: str


SCORES: Mapping[str, Limits] = {
    "delay": Limits(-120.0, -600.0, "s of delay per car"),
    "paper": Limits(-100.0, -1000.0, "(accumulated waiting per second)"),
}
"""The first is the default. The paper's lower bound is -100; the published values cannot hold any
below it (docs/differences.md)."""
WAYS: Mapping[str, int] = {"fixed_time": 0, "actuated": 3}
"""Lights of SUMO's own, and its numbers of their kinds."""
_CYCLE = (30.0, 10.0, 30.0, 10.0)
"""Seconds of green of the phases of a fixed cycle."""
_SHORTEST_GREEN, _LONGEST_GREEN = 5.0, 50.0
"""SUMO's defaults of actuated lights [s]."""

_PHASES = (("NS", False), ("NS", True), ("WE", False), ("WE", True))
PHASES = len(_PHASES)
_PLACES = {"W": (-1, 0), "N": (0, 1), "E": (1, 0), "S": (0, -1)}
_LANES = [(f"{a}_in_{lane}", 2 * k + (lane == LEFT_LANE)) for k, a in enumerate(APPROACHES)
          for lane in range(LANES)]  # fmt: skip


class Signal(TrafficEnv):
    """One isolated intersection under a demand that rises and falls within 90 minutes."""

    FEATURES: ClassVar[Mapping[str, float]] = {
        "length": 750.0,  # m, of every approach
        "inflow": 1000.0,  # cars per episode
        "speed": 14.0,  # m/s, limit on the roads
    }
    HIDDEN = frozenset(FEATURES)
    STEP = 1.0
    HORIZON = SECONDS // GREEN
    WINDOW = Window(-110.0, -110.0, 110.0, 110.0)
    LEGEND = CARS
    ways: ClassVar[tuple[str, ...]] = tuple(WAYS)

    def __init__(
        self,
        context: Mapping[str, Value] | None = None,
        *,
        score: Score = "delay",
        jam: float | None = None,
        **settings: Unpack[Settings],
    ) -> None:
        """Arguments as in `Traffic`, and two more.

        An episode that changes phases has fewer decisions than `horizon`, down to 386.

        Args:
            context: features that differ from the nominal ones.
            score: what an episode is worth, see the module.
            jam: score at which an episode is given up; None: see `Limits`. -inf: never.
            **settings: see `Traffic`.

        Raises:
            ContextMismatch: a road too short to stop on, or an inflow that is no number of cars.
            InvalidInput: a jam that every episode is.
            UnknownName: no such score.
        """
        check_known("score", score, SCORES)
        self.scored, self._limits = score, SCORES[score]
        self.SCORE = self._limits.unit
        jam = self._limits.jam if jam is None else jam
        if not jam < 0.0:
            raise InvalidInput(f"jam takes numbers < 0, got {jam!r}; -inf: no jam ends early")
        super().__init__(context, **settings)
        self._jam = jam
        self._limit = min(self.features["speed"], MAX_SPEED)
        self._edges = CELLS * (self.features["length"] / self.FEATURES["length"])
        self.observation_space = self._space([0.0] * 80, [1.0] * 80)
        self.action_space = Discrete(PHASES)

    # ---- episodes ----------------------------------------------------------------------------

    @property
    def strata(self) -> tuple[float, float]:
        """Probabilities of the two modes of demand: usual, and crowded (see `demand`)."""
        crowded = crowded_share(int(self.features["inflow"]))
        return 1.0 - crowded, crowded

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an empty intersection with the demand of a new draw.

        Args:
            seed: of the draw.
            options: {"stratum": k} draws demand of one mode only, see `strata`.

        Raises:
            InvalidInput: there is no such mode.
        """
        super().reset(seed=seed)
        cars = int(self.features["inflow"])
        speed = self.features["speed"]
        stratum = (options or {}).get("stratum")
        if stratum not in (None, 0, 1):
            raise InvalidInput(f"stratum is 0 (usual demand) or 1 (crowded), got {stratum!r}")
        crowded = None if stratum is None else stratum == 1
        trips = routes(self.np_random, cars, SECONDS, speed, crowded=crowded)
        self.simulation.start(trips, self._draw_seed())
        self._phase: int | None = None
        self._way, self._lost = "", 0.0
        self._time, self._decisions = 0, 0
        self._waiting, self._waiting_sum, self._queue_sum = 0.0, 0.0, 0.0
        self._speed_sum, self._seen, self._missed_turns = 0.0, 0, 0
        with self.simulation.guard() as api:
            self._states = _light_states(api.trafficlight.getControlledLinks("centre"))
            observation = self._observe(api)
        self._left = self.horizon
        return observation, {}

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Give green to one phase for 10 s.

        Raises:
            InvalidInput: no episode is running, or there is no such phase.
            SimulationFailed: the simulator has stopped.
        """
        self._check_running()
        phase = int(action)
        if phase != action or not 0 <= phase < PHASES:
            raise InvalidInput(f"a phase is 0, 1, 2 or 3, got {action!r}")
        with self.simulation.guard() as api:
            self._release(api)
            if self._phase not in (None, phase):
                self._show(api, self._states[self._phase].replace("G", "y"), YELLOW)
            self._phase = phase
            self._show(api, self._states[phase], GREEN)
            return self._decided(api)

    def follow(self, way: str) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Ten seconds of a light of SUMO's own, from the beginning of the episode on.

        Args:
            way: one of `ways`.

        Raises:
            InvalidInput: no episode is running.
            UnknownName: there is no such light.
            SimulationFailed: the simulator has stopped.
        """
        self._check_running()
        check_known("light", way, WAYS)
        with self.simulation.guard() as api:
            if self._way != way:
                api.trafficlight.setProgramLogic("centre", self._program(api, way))
                self._way = way
            self._release(api)
            self._drive(api, GREEN)
            return self._decided(api)

    # ---- inside ------------------------------------------------------------------------------

    def _decided(self, api: Any) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """What a step returns."""
        observation, info = self._observe(api), {}
        reward = self._account(api)
        self._left -= 1
        score = self._score
        jammed = score <= self._jam
        ended = self._time >= SECONDS or self._left == 0 or jammed
        if score <= self._limits.lowest:
            info = {"final_score": score}
        if ended:
            info |= {**self._summary(api), "jammed": jammed}
            self._finish()
        return observation, reward, *self._ends(ended), info

    @property
    def _score(self) -> float:
        """Of the episode so far; it only falls."""
        return -self._delay if self.scored == "delay" else -self._waited

    @property
    def _waited(self) -> float:
        """Accumulated waiting, summed over the decisions so far, over the episode's seconds."""
        return self._waiting_sum / SECONDS

    @property
    def _delay(self) -> float:
        """Seconds per car of the demand that were lost before the stop line so far."""
        return self._lost / self.features["inflow"]

    def _show(self, api: Any, state: str, seconds: int) -> None:
        """Let the light show `state`, no longer than the episode lasts."""
        if self._time < SECONDS:
            api.trafficlight.setRedYellowGreenState("centre", state)
            self._drive(api, seconds)

    def _drive(self, api: Any, seconds: int) -> None:
        """Simulate second by second, no longer than the episode lasts, and book what is lost."""
        on, end = api.lane, min(self._time + seconds, SECONDS)
        while self._time < end:
            self._time += 1
            api.simulationStep(float(self._time))
            self._lost += len(api.simulation.getPendingVehicles())
            for lane, _ in _LANES:  # of a whole edge SUMO's mean is another one
                if cars := on.getLastStepVehicleNumber(lane):
                    self._lost += cars * (1.0 - on.getLastStepMeanSpeed(lane) / self._limit)

    def _program(self, api: Any, way: str) -> Any:
        """A light of SUMO's own, as SUMO wants it."""
        light, phases = api.trafficlight, []
        for green, state in zip(_CYCLE, self._states, strict=True):
            bounds = (green, green) if way == "fixed_time" else (_SHORTEST_GREEN, _LONGEST_GREEN)
            phases.append(light.Phase(green, state, *bounds))
            phases.append(light.Phase(YELLOW, state.replace("G", "y"), YELLOW, YELLOW))
        return light.Logic(way, WAYS[way], 0, phases)

    def _observe(self, api: Any) -> Observation:
        cells = np.zeros((8, len(CELLS)), dtype=np.float32)
        ids, position = api.lane.getLastStepVehicleIDs, api.vehicle.getLanePosition
        self._cars: list[str] = []
        self._first: dict[str, str] = {}
        for lane, group in _LANES:
            cars = ids(lane)
            if cars:
                ahead = self.features["length"] - np.array([position(car) for car in cars])
                cells[group, cell_of(ahead, self._edges)] = 1.0
                self._cars.extend(cars)
                self._first[lane] = cars[int(ahead.argmin())]
        return np.array([*cells.reshape(-1), *self.visible], dtype=np.float32)

    def _release(self, api: Any) -> None:
        """End a jam: see `PATIENCE`."""
        vehicle = api.vehicle
        for lane, car in self._first.items():
            if vehicle.getWaitingTime(car) < PATIENCE:
                continue
            approach, target = vehicle.getRoute(car)
            exits = _exits(lane)
            if target not in exits:
                vehicle.setRoute(car, [approach, exits[0]])
                self._missed_turns += 1

    def _account(self, api: Any) -> float:
        """Book the waiting at the end of a decision; returns the reward."""
        vehicle = api.vehicle
        total = float(sum(map(vehicle.getAccumulatedWaitingTime, self._cars)))
        speeds = [vehicle.getSpeed(car) for car in self._cars]
        reward, self._waiting = self._waiting - total, total
        self._decisions += 1
        self._waiting_sum += total
        self._queue_sum += sum(speed < HALTED for speed in speeds)
        self._speed_sum += sum(speeds)
        self._seen += len(speeds)
        return reward

    def _summary(self, api: Any) -> dict[str, Any]:
        """Measures of the episode.

        score: see the module; delay and waiting: those of the two scores, positive; mean_queue:
        halted cars on the approaches at decisions; mean_speed: of the cars there [m/s];
        not_inserted: cars that still wait to enter; missed_turns: see `PATIENCE`; collisions.
        """
        statistic = api.simulation.getParameter("", "stats.safety.collisions")
        return {
            "score": self._score,
            "delay": self._delay,
            "waiting": self._waited,
            "mean_queue": self._queue_sum / self._decisions,
            "mean_speed": self._speed_sum / self._seen if self._seen else 0.0,
            "not_inserted": len(api.simulation.getPendingVehicles()),
            "missed_turns": self._missed_turns,
            "collisions": int(statistic or 0),
        }

    def _options(self) -> list[str]:
        return ["--waiting-time-memory", str(SECONDS), "--collision.action", "warn"]

    def _network(self) -> Path:
        check_context(self.features)
        return _crossing(self.features["length"], self.features["speed"])


def check_context(features: Mapping[str, float]) -> None:
    """Refuse what no intersection can be.

    Raises:
        ContextMismatch: a road too short to stop on, or an inflow that is no number of cars.
    """
    length, inflow = features["length"], features["inflow"]
    entry = entry_speed(features["speed"])
    stop = stopping_distance(entry)
    if length < SHORTEST or length <= stop:
        raise ContextMismatch(
            f"an approach must hold a car that enters at {entry:g} m/s and stops at the light, "
            f"more than {max(SHORTEST, stop):g} m, got a length of {length:g} m"
        )
    if inflow < 2 or not float(inflow).is_integer():
        raise ContextMismatch(f"inflow is a number of cars >= 2, got {inflow!r}")


def cell_of(distance: Array, edges: Array) -> Indices:
    """Index of the cell in which a car is; a car at an edge is in the farther one.

    Args:
        distance: (n,) of fronts from the stop line [m].
        edges: (10,) upper edges of the cells [m].
    """
    return np.minimum(np.searchsorted(edges, distance, side="right"), len(edges) - 1)


def _exits(lane: str) -> list[str]:
    """Edges to which a lane leads, straight ahead first."""
    k, number = APPROACHES.index(lane[0]), int(lane[-1])
    turns = {LEFT_LANE: (1,), 0: (2, 3)}.get(number, (2,))  # clockwise, see `_connections`
    return [f"{APPROACHES[(k + turn) % 4]}_out" for turn in turns]


def _light_states(links: Any) -> list[str]:
    """State of the light in each phase, one letter per link."""
    lanes = [link[0][0] if link else "" for link in links]
    return [
        "".join(
            "G" if lane[:1] in axis and (lane[-1:] == str(LEFT_LANE)) == left else "r"
            for lane in lanes
        )
        for axis, left in _PHASES
    ]


def _crossing(length: float, speed: float) -> Path:
    reach = length + BOX
    nodes = '<node id="centre" x="0" y="0" type="traffic_light"/>' + "".join(
        f'<node id="{a}" x="{x * reach:.3f}" y="{y * reach:.3f}" type="priority"/>'
        for a, (x, y) in _PLACES.items()
    )
    road = f'numLanes="{LANES}" speed="{speed:g}" length="{length:g}"'
    edges = "".join(
        f'<edge id="{a}_in" from="{a}" to="centre" {road}/>'
        f'<edge id="{a}_out" from="centre" to="{a}" {road}/>'
        for a in APPROACHES
    )
    return network(
        {
            "nodes": f"<nodes>{nodes}</nodes>",
            "edges": f"<edges>{edges}</edges>",
            "connections": f"<connections>{''.join(map(_connections, range(4)))}</connections>",
        }
    )


def _connections(k: int) -> str:
    """Links of one approach; clockwise: the next approach lies to the left."""
    here, left, ahead, right = (APPROACHES[(k + turn) % 4] for turn in range(4))

    def link(to: str, lane: int, speed: str = "") -> str:
        ends = f'from="{here}_in" to="{to}_out" fromLane="{lane}" toLane="{lane}"'
        return f"<connection {ends} {speed}/>"

    straight = "".join(link(ahead, lane) for lane in range(LEFT_LANE))
    turns = link(right, 0, f'speed="{RIGHT_SPEED}"')
    return straight + turns + link(left, LEFT_LANE, f'speed="{LEFT_SPEED}"')
