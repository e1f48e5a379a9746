"""Eco-driving: controlled cars approach a signal so that nobody stops for nothing (cmdp-spec, 6).

One lane, straight through one signal, no cross traffic. Decentralised: one agent per controlled car
in the region (approach, box, exit), one shared policy; a PettingZoo parallel environment whose
agents come and go. Cars outside the region, and human drivers, follow IDM.

    observation   39 numbers, `LAYOUT`, then the visible context, below
    action        acceleration a [m/s^2], -20..10; the target speed clip(v + 0.5 a, 0, limit) holds
                  for one step of 0.5 s
    reward        (v - 35 max(0, 1 - v) - 3 E)/15 with the agent's speed v [m/s] and its CO2 of the
                  step E [g] after the step; 0 in the step in which it leaves
    score         "everyone": mean speed over all cars and steps after the warm-up [m/s], on the
                  feeders, too; a car that wants to enter and cannot counts with 0, so that no jam
                  can win
                  "paper": mean over completed cars of their mean speed in the region [m/s]: all
                  drivers, those in the region in the warm-up left out; 0 if no car completes. It
                  does not see who waits outside, and rewards whoever lets few cars in

The last step's info and `summary` also hold both speeds (`mean_speed`, `trip_speed`), per completed
car `co2` [g] and `stops` (below 0.1 m/s after having been above 1), `throughput` [cars/h],
`completed`, `not_inserted` (cars that still wait to enter) and `collisions`. The spec's end of
jammed episodes (over 150 agents) cannot occur: the region holds fewer.

Visible context: "hidden" nothing (39 numbers); "multiplier" every varied feature over its unit, as
in all our environments (40 where one varies); "raw" the reference's block: penetration, approach
and box over 250 m, limit/15, green and red in seconds (44). The reference does not show the inflow,
nor does this environment unless the multiplier is asked for.

What SUMO (1.28) does here, for a twin of the lane; a test holds SUMO to it:

- A step that begins at t shows the signals of t, moves all cars from the state at t, with
  x' = x + 0.5 v', then lets cars enter, whose first move is a step later.
- v' is the least of IDM for the free road, for each leader and for a stop; braking reaches
  9 m/s^2. With a command v' = max(min(target, that), v - 0.5 decel), so a controlled car is never
  faster than its IDM (accel 2.6) and brakes with 4.5 at most.
- IDM has delta 4 and two inner steps of 0.25 s; in these the leader keeps its speed and the gap
  shrinks by 0.25 max(0, v - v_leader). Speeds stay >= 0, gaps >= 0.001.
- Leaders are the rearmost car on the next road (from the approach: on box and exit), unless a
  signal stops the car before it, and the nearest on the own road, where tails that overhang its end
  count. A tail overhangs the road from which the car came.
- Red and yellow stop a car whose braking distance in steps with b = max(decel, 3) fits before the
  line: 0.5 (n v - 0.25 b n (n + 1)), n = floor(2 v/b). It stops 1 m before the line, or nearer if
  it must (0.1 m at least): IDM with a standing leader at that point and minGap 0, not passing it in
  the step; at rest, where IDM would not move it, it closes what is left in one step. Any other car
  drives on. The lines are at the ends of the feeders and at 235.6 m.
- A car enters its feeder 0.1 m + its length from the start, at 5 m/s, in the first step that begins
  at its departure or later, in order, and only if the net gap to the last car is at least minGap +
  max(0, 5 tau + 5 (5 - v_leader)/(2 sqrt(accel decel))). It is gone once its front passes 485.5 m.
- A car that the ghost signal does not stop brakes for the main signal from the feeder already.
- A tail that still overhangs the other feeder makes a car stop 0.1 m before the ghost.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar, Literal, NamedTuple, TypeVar, Unpack

import numpy as np
from gymnasium.spaces import Box
from scipy.special import ndtr, ndtri

from mbtl.arrays import Array
from mbtl.canvas import Window
from mbtl.contexts import Value
from mbtl.errors import ContextMismatch, InvalidInput, check_known
from mbtl.sumo import network
from mbtl.zoo.cmdps.contextual import Observation, Stepped
from mbtl.zoo.cmdps.traffic.simulation import Settings, TrafficTeam

# ---- emissions: CO2 of a car from its speed and acceleration, after VT-CPFM (cmdp-spec, 6.3) -
#
# Notation: v speed [m/s], a acceleration [m/s^2], R resistance [N], P power [kW], F fuel [L/s].
#
#     R = 2.372 v^2 + 1.785 v + 1.785 N        drag, rolling, and the grade term N
#     P = (R + 3278 a) v / 3312
#     F = 7.8e-4 + 1.956e-5 P + 1e-6 P^2       P < 0: 7.8e-4, the engine idles
#     CO2 = 2350 F                             grams per second
#
# The road is level: N = 0. The spec gives no unit of v. We read metres per second throughout:
# cruising at 10 and 14 m/s then costs 1.9 g/s, and 3.8 g/s with +2 m/s^2 at 10 m/s; the reference's
# MOVES surrogate has 0-0.5, 1-2.8 and 9 g/s there, and kilometres per hour would make it 6, 26 and
# 33 g/s. One engine stands for the whole fleet, as the spec has constants for one.
#
# Only arithmetic, so that floats, NumPy arrays and JAX arrays all go through.


Number = TypeVar("Number", float, Array)

DRAG, ROLLING, INERTIA, EFFICIENCY = 2.372, 1.785, 3278.0, 3312.0
IDLE, LINEAR, SQUARE = 7.8e-4, 1.956e-5, 1e-6
CO2_PER_LITRE = 2350.0
"""Grams of CO2 from a litre of fuel."""
GRADE = 0.0


def power(speed: Number, acceleration: Number) -> Number:
    """Power at the wheels [kW]; negative where the car brakes."""
    resistance = DRAG * speed * speed + ROLLING * speed + ROLLING * GRADE
    return (resistance + INERTIA * acceleration) * speed / EFFICIENCY


def fuel_rate(speed: Number, acceleration: Number) -> Number:
    """Fuel [L/s]."""
    needed = power(speed, acceleration)
    positive = (needed + abs(needed)) / 2.0
    return IDLE + LINEAR * positive + SQUARE * positive * positive


def co2_rate(speed: Number, acceleration: Number) -> Number:
    """CO2 [g/s].

    Args:
        speed: v [m/s], >= 0.
        acceleration: a [m/s^2], of the same shape.
    """
    return CO2_PER_LITRE * fuel_rate(speed, acceleration)


# The eco-driving road: two feeders, a ghost signal, an approach, a box, an exit (cmdp-spec, 6.1)
#
# Everything is one lane. AB brings nine tenths of the cars straight on, AA the others from the
# side; the ghost signal lets one of them at a time into the region where cars are controlled:
#
#     AB 246 m                 ghost | approach 235.6 m | signal | box 14.4 m | exit 235.6 m |
#     AA 242.8 m /     0                  235.6             250                485.6   position [m]
#
# The junctions have no length of their own: the box is a road, and a car passes from the end of one
# road to the start of the next. Cars of AA do not slow down for their turn, and none waits at a
# green light for space behind it (SUMO's keepClear is off).
#
# Both signals have the cycle green g, yellow 3 s, red 35 s, yellow 3 s, from time 0. The main
# signal is red in the last two; the ghost gives AB the first two and AA the last two.


APPROACH, BOX, EXIT = 235.6, 14.4, 235.6
FEEDERS = {"AB": 246.0, "AA": 242.8}
"""Lengths [m]."""
SHARES = {"AB": 0.9, "AA": 0.1}
"""Of the inflow."""
LIMIT = 14.0
"""Speed limit everywhere [m/s]."""
YELLOW, RED = 3.0, 35.0
STEP = 0.5
"""Seconds of one simulation step."""

ROADS = ("approach", "box", "exit")
"""The controlled region, in the direction of travel."""
STARTS = (0.0, APPROACH, APPROACH + BOX)
"""Position of the start of each [m]."""
LENGTH = APPROACH + BOX + EXIT
"""Of the region [m]."""

_SHORTEST = 1.0


class Light(NamedTuple):
    """The main signal; seconds."""

    green: float

    @property
    def cycle(self) -> float:
        """Time from green to green."""
        return self.green + YELLOW + RED + YELLOW

    def phase(self, time: float) -> int:
        """0 green, 1 yellow, 2 red: what cars obey in the step that begins at `time`."""
        within = time % self.cycle
        return 0 if within < self.green else 1 if within < self.green + YELLOW else 2

    def changes(self, time: float) -> tuple[float, float, float]:
        """Seconds from `time` until green next begins or ends, and the two changes after."""
        within = time % self.cycle
        end, start = self.green - within, self.cycle - within
        if end > 0:
            return end, start, end + self.cycle
        return start, end + self.cycle, start + self.cycle


def light(green: float) -> Light:
    """The signal with this green.

    Raises:
        ContextMismatch: less than 1 s, or no multiple of the simulation step, on which SUMO would
            let the signals drift.
    """
    steps = green / STEP
    if not (math.isfinite(green) and green >= _SHORTEST and steps == round(steps)):
        raise ContextMismatch(
            f"green lasts at least {_SHORTEST:g} s, in multiples of {STEP} s, got {green!r}"
        )
    return Light(green)


def corridor(light: Light) -> Path:
    """The compiled network with both signals."""
    west, south = FEEDERS["AB"], FEEDERS["AA"]
    nodes = "".join(
        f'<node id="{id}" x="{x:g}" y="{y:g}" type="{kind}"/>'
        for id, x, y, kind in (
            ("west", -west, 0.0, "priority"),
            ("south", 0.0, -south, "priority"),
            ("ghost", 0.0, 0.0, "traffic_light"),
            ("main", APPROACH, 0.0, "traffic_light"),
            ("middle", APPROACH + BOX, 0.0, "priority"),
            ("end", LENGTH, 0.0, "priority"),
        )
    )
    edges = "".join(
        f'<edge id="{id}" from="{a}" to="{b}" numLanes="1" speed="{LIMIT:g}" length="{length:g}"/>'
        for id, a, b, length in (
            ("AB", "west", "ghost", west),
            ("AA", "south", "ghost", south),
            ("approach", "ghost", "main", APPROACH),
            ("box", "main", "middle", BOX),
            ("exit", "middle", "end", EXIT),
        )
    )
    links = "".join(
        f'<connection from="{a}" to="{b}" fromLane="0" toLane="0" keepClear="0"/>'
        for a, b in (("AB", "approach"), ("AA", "approach"), ("approach", "box"), ("box", "exit"))
    )
    return network(
        {
            "nodes": f"<nodes>{nodes}</nodes>",
            "edges": f"<edges>{edges}</edges>",
            "connections": f"<connections>{links}</connections>",
            "lights": f"<tlLogics>{_programs(light)}</tlLogics>",
        },
        "--no-internal-links",
    )


def _programs(light: Light) -> str:
    """Links of the ghost go clockwise from the south: AA, then AB."""
    seconds = (light.green, YELLOW, RED, YELLOW)
    programs = {"ghost": ("rG", "ry", "Gr", "yr"), "main": ("G", "y", "r", "r")}
    return "".join(
        f'<tlLogic id="{id}" programID="0" offset="0" type="static">'
        + "".join(
            f'<phase duration="{duration:g}" state="{state}"/>'
            for duration, state in zip(seconds, states, strict=True)
        )
        + "</tlLogic>"
        for id, states in programs.items()
    )


# ---- who drives on the eco-driving road, and when they come (cmdp-spec, 6.1) -----------------
#
# Arrivals are Poisson on each feeder; a car is controlled with probability `penetration`.
# Controlled cars are alike. Human drivers differ: the reference draws them from 2000 calibrated
# samples; here each parameter is drawn by itself from a normal distribution with the mean and the
# standard deviation of the samples, cut at 2 standard deviations: the last whole number that keeps
# every gap positive (the cut leaves 0.88 of the standard deviation). Cars and light trucks share
# drivers, as in the reference; trucks and buses have others.


class Driver(NamedTuple):
    """IDM of one car: metres, seconds."""

    min_gap: float
    tau: float
    accel: float
    decel: float


class Kind(NamedTuple):
    """A kind of vehicle: its share of the fleet, its length [m] and its drivers."""

    share: float
    length: float
    mean: Driver
    std: Driver


CUT = 2.0
"""Standard deviations at which the distributions end."""

_CARS = (Driver(2.20, 0.296, 0.744, 1.66), Driver(0.18, 0.041, 0.007, 0.08))
_TRUCKS = (Driver(1.30, 0.57, 0.746, 1.54), Driver(0.55, 0.14, 0.007, 0.22))

FLEET = {
    "car": Kind(0.425, 5.0, *_CARS),
    "light truck": Kind(0.472, 6.0, *_CARS),
    "truck": Kind(0.099, 7.1, *_TRUCKS),
    "bus": Kind(0.0035, 12.0, *_TRUCKS),
}
"""Of human drivers; the shares are made to add up to 1."""

CONTROLLED = Driver(min_gap=2.0, tau=1.0, accel=2.6, decel=4.5)
CONTROLLED_LENGTH = 5.0
DEPART_SPEED = 5.0


class Car(NamedTuple):
    """One car of an episode.

    Attributes:
        id: "car0", "car1", ... in the order of departure.
        feeder: "AB" or "AA".
        depart: when it wants to enter [s].
        controlled: whether it is an agent.
    """

    id: str
    feeder: str
    depart: float
    controlled: bool
    length: float
    driver: Driver


def truncated(rng: np.random.Generator, shape: tuple[int, ...]) -> Array:
    """Standard normal draws within `CUT`, by inversion: one uniform number each."""
    low = float(ndtr(-CUT))
    draws: Array = ndtri(rng.uniform(low, 1.0 - low, shape))
    return draws


def population(
    rng: np.random.Generator, inflow: float, penetration: float, seconds: float
) -> list[Car]:
    """The cars of one episode, in the order of departure.

    Args:
        rng: where all draws come from.
        inflow: cars per hour, both feeders together.
        penetration: probability that a car is controlled.
        seconds: until when cars come.
    """
    arrivals = [
        (time, feeder)
        for feeder in FEEDERS
        for time in _poisson(rng, inflow * SHARES[feeder] / 3600.0, seconds)
    ]
    n = len(arrivals)
    controlled = rng.random(n) < penetration
    kinds = list(FLEET.values())
    shares = np.array([kind.share for kind in kinds])
    which = rng.choice(len(kinds), n, p=shares / shares.sum())
    means, stds = np.array([k.mean for k in kinds]), np.array([k.std for k in kinds])
    drivers = means[which] + stds[which] * truncated(rng, (n, len(Driver._fields)))
    return [
        Car(f"car{k}", feeder, time, True, CONTROLLED_LENGTH, CONTROLLED)
        if controlled[k]
        else Car(f"car{k}", feeder, time, False, kinds[which[k]].length, Driver(*drivers[k]))
        for k, (time, feeder) in enumerate(sorted(arrivals))
    ]


def routes(cars: list[Car]) -> str:
    """XML of the cars: a vehicle type each, because a driver is one.

    Nobody exceeds the limit or dawdles: the speed factor is 1 without spread, and IDM has no noise.
    """
    ways = "".join(f'<route id="{f}" edges="{f} {" ".join(ROADS)}"/>' for f in FEEDERS)
    rows = "".join(
        f'<vType id="{car.id}" carFollowModel="IDM" length="{car.length:g}" '
        f'minGap="{car.driver.min_gap:.6f}" tau="{car.driver.tau:.6f}" '
        f'accel="{car.driver.accel:.6f}" decel="{car.driver.decel:.6f}" '
        'speedFactor="1" speedDev="0"/>'
        f'<vehicle id="{car.id}" type="{car.id}" route="{car.feeder}" depart="{car.depart:.3f}" '
        f'departSpeed="{DEPART_SPEED:g}"/>'
        for car in cars
    )
    return f"<routes>{ways}{rows}</routes>"


def _poisson(rng: np.random.Generator, rate: float, seconds: float) -> list[float]:
    """Arrival times in 0..seconds: given their number, they are uniform."""
    times: list[float] = np.sort(rng.uniform(0.0, seconds, rng.poisson(rate * seconds))).tolist()
    return times


# ---- trips through the eco-driving region: what scores and rewards are made of ---------------


HALTED, MOVING = 0.1, 1.0
"""A stop: slower than the first [m/s] after having been faster than the second."""

_LANES = tuple(f"{road}_0" for road in reversed(ROADS))
_FEEDERS = tuple(f"{road}_0" for road in FEEDERS)


class Trip:
    """One car in the region so far.

    Attributes:
        speed: now [m/s].
        co2: of this step [g].
        steps, distance, co2_sum, stops: so far; the distance is the sum of speeds x step [m].
    """

    __slots__ = ("_moving", "co2", "co2_sum", "distance", "speed", "steps", "stops")

    def __init__(self) -> None:
        """The car is not in the region yet; its first `move` is its entry."""
        self.speed = self.co2 = self.co2_sum = self.distance = 0.0
        self.steps = self.stops = 0
        self._moving = False

    def move(self, speed: float, acceleration: float) -> None:
        """One step that ended at this speed."""
        self.speed = speed
        self.co2 = co2_rate(speed, acceleration) * STEP
        self.co2_sum += self.co2
        self.distance += speed * STEP
        self.steps += 1
        if speed > MOVING:
            self._moving = True
        elif speed < HALTED and self._moving:
            self.stops += 1
            self._moving = False

    @property
    def mean_speed(self) -> float:
        """Over the steps in the region [m/s]."""
        return self.distance / (self.steps * STEP)


class Region:
    """All trips of an episode, and what all cars do before and between them.

    Attributes:
        roads: cars on exit, box and approach; on each, the foremost first.
        present: their trips, in the same order: from the end of the region to its start.
        completed: trips that went through and count.
    """

    def __init__(self) -> None:
        """Empty."""
        self.roads: list[list[str]] = [[], [], []]
        self.present: dict[str, Trip] = {}
        self.completed: list[Trip] = []
        self._uncounted: frozenset[str] = frozenset()
        self._speeds, self._cars = 0.0, 0

    def begin(self) -> None:
        """The measurement begins: cars that are in the region are no trips that count."""
        self._uncounted = frozenset(self.present)
        self._speeds, self._cars = 0.0, 0

    def update(self, api: Any) -> None:
        """Read the state after a simulation step: a call per lane and a call per car."""
        ids, speed_of = api.lane.getLastStepVehicleIDs, api.vehicle.getSpeed
        before, after = self.present, {}
        self.roads = [ids(lane)[::-1] for lane in _LANES]
        for road in self.roads:
            for car in road:
                speed = speed_of(car)
                trip = before.pop(car, None)
                if trip is None:
                    trip = Trip()
                    acceleration = api.vehicle.getAcceleration(car)
                else:
                    acceleration = (speed - trip.speed) / STEP
                trip.move(speed, acceleration)
                after[car] = trip
        self.present = after
        for lane in _FEEDERS:
            cars = api.lane.getLastStepVehicleNumber(lane)
            self._speeds += cars * api.lane.getLastStepMeanSpeed(lane)
            self._cars += cars
        self._speeds += sum(trip.speed for trip in after.values())
        self._cars += len(after) + len(api.simulation.getPendingVehicles())
        self.completed += [trip for car, trip in before.items() if car not in self._uncounted]

    def summary(self, seconds: float) -> dict[str, float]:
        """Means over the completed trips, but for the first; 0 where there is none.

        Args:
            seconds: of the measurement.

        Returns:
            mean_speed: over all cars and steps, those outside the region too [m/s], where a car
            that waits to enter stands; trip_speed: in the region [m/s]; co2: [g] per car; stops:
            per car; throughput: cars per hour; completed: cars.
        """
        n = len(self.completed)
        share = 1.0 / n if n else 0.0
        return {
            "mean_speed": self._speeds / max(self._cars, 1),
            "trip_speed": share * sum(trip.mean_speed for trip in self.completed),
            "co2": share * sum(trip.co2_sum for trip in self.completed),
            "stops": share * sum(trip.stops for trip in self.completed),
            "throughput": 3600.0 * n / seconds,
            "completed": float(n),
        }


# ---- the whole -------------------------------------------------------------------------------


Score = Literal["everyone", "paper"]

WARM_UP = 50
"""Steps before the first decision."""
HARDEST, STRONGEST = -20.0, 10.0
"""Bounds of the action [m/s^2]; SUMO's are narrower."""
CRAWL, CRAWL_COST, CO2_COST, REWARD_SCALE = 1.0, 35.0, 3.0, 15.0
SPEED_SCALE, LENGTH_SCALE, TIME_SCALE = 15.0, 250.0, 100.0
ABSENT = (45.0 / SPEED_SCALE, LENGTH / LENGTH_SCALE, 0.0, 0.0)
"""What is seen of a neighbour that is not there: faster than any, and a region away. The reference
has 30 km; over 250 m that is 120, and a network of tanh sees nothing beside it."""

LAYOUT = {
    "speed": slice(0, 1),  # over 15 m/s
    "distance": slice(1, 2),  # to the stop line, over 250 m; negative behind it
    "phase": slice(2, 5),  # green, yellow, red
    "changes": slice(5, 8),  # time to the next three begins or ends of green, over 100 s
    "road": slice(8, 11),  # approach, box, exit
    "lane": slice(11, 12),  # 0
    "destination": slice(12, 15),  # left, straight, right: straight
    "leader": slice(15, 19),  # speed over 15 m/s, net gap over 250 m, two blinkers (off)
    "follower": slice(19, 23),
    "left": slice(23, 31),  # leader and follower: the car itself, as there is one lane
    "right": slice(31, 39),
}
"""Where each part of an observation is. Neighbours are the nearest cars within the region."""

SIZE = 39

SCORES = {"everyone": "mean_speed", "paper": "trip_speed"}
"""What an episode can be worth, and the measure that says it; the first is the default."""

_ONE_HOT = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
_LANE = (0.0, *_ONE_HOT[1])  # the only lane, and straight on


class Eco(TrafficTeam):
    """Eco-driving in one context.

    Attributes:
        agents: controlled cars in the region, the foremost first.
        possible_agents: every controlled car of this episode; a reset draws them anew.
        summary: measures of the last episode that has ended; empty before.
    """

    FEATURES: ClassVar[Mapping[str, float]] = {
        "penetration": 0.2,  # share of cars that are controlled
        "inflow": 400.0,  # cars per hour
        "green": 35.0,  # s
    }
    HIDDEN = frozenset({"inflow"})
    STEP = STEP
    HORIZON = 1500
    WINDOW = Window(-FEEDERS["AB"] - 4.0, -12.0, LENGTH + 4.0, 9.0)
    metadata: ClassVar[dict[str, Any]] = {**TrafficTeam.metadata, "name": "mbtl-eco"}
    most_agents = math.ceil(LENGTH / (CONTROLLED_LENGTH + CONTROLLED.min_gap))

    def __init__(
        self,
        context: Mapping[str, Value] | None = None,
        *,
        score: Score = "everyone",
        **settings: Unpack[Settings],
    ) -> None:
        """Arguments as in `Traffic`, and one more; the horizon counts steps after the warm-up.

        Args:
            context: features that differ from the nominal ones.
            score: what an episode is worth, see the module.
            **settings: see `Traffic`.

        Raises:
            ContextMismatch: a penetration outside (0, 1], or a green that no signal can show.
            UnknownName: no such score.
        """
        check_known("score", score, SCORES)
        self.scored = score
        check_context(context or {})
        super().__init__(context, **settings)
        self._light = light(self.features["green"])
        if settings.get("visibility") == "raw":
            share = self.features["penetration"]
            self.visible = (share, 1.0, LIMIT / SPEED_SCALE, self._light.green, RED)
        most = max(*ABSENT, 2.0 * self._light.cycle / TIME_SCALE)
        self._observation_space = self._space([-1.0] * SIZE, [most] * SIZE)
        self._action_space = Box(HARDEST, STRONGEST, (1,), np.float32)
        self.summary: dict[str, float] = {}

    # ---- episodes ----------------------------------------------------------------------------

    @property
    def controlled(self) -> frozenset[str]:
        """The controlled cars of this episode."""
        return self._controlled

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Observation], dict[str, dict[str, Any]]]:
        """Draw cars and drivers, and drive until there is an agent.

        An episode in which no controlled car ever comes is over when this returns: it has no
        agents, and `summary` holds its measures.
        """
        if seed is not None:
            self._seed(seed)
        share, inflow = self.features["penetration"], self.features["inflow"]
        cars = population(self.np_random, inflow, share, (WARM_UP + self.horizon) * STEP)
        self._length = {car.id: car.length for car in cars}
        self.possible_agents = [car.id for car in cars if car.controlled]
        self._controlled = frozenset(self.possible_agents)
        self.simulation.start(routes(cars), self._draw_seed())
        self._region = Region()
        self._left = self.horizon
        with self.simulation.guard() as api:
            for _ in range(WARM_UP):
                api.simulationStep()
                self._region.update(api)
            self._region.begin()
            self._find_agents()
            self._wait(api)
            seen = self._look(api)
            self._end(api)
        return seen, {car: {} for car in self.agents}

    def step(self, actions: Mapping[str, Any]) -> Stepped:
        """Accelerate the agents for one step.

        A car without an action drives by itself, so that `step({})` is traffic without control. An
        agent that leaves the region is terminated. While there is none, traffic goes on.

        Raises:
            InvalidInput: no episode is running, or an action is not a finite number.
            SimulationFailed: the simulator has stopped.
        """
        self._check_running()
        acting, last_seen = self.agents, self._seen
        commands = {car: _acceleration(actions[car]) for car in acting if car in actions}
        present = self._region.present
        with self.simulation.guard() as api:
            for car, acceleration in commands.items():
                target = min(max(present[car].speed + STEP * acceleration, 0.0), LIMIT)
                api.vehicle.slowDown(car, target, 0.0)  # for this step only
            self._advance(api)
            present = self._region.present
            rewards = {car: reward(present[car]) if car in present else 0.0 for car in acting}
            gone = {car: car not in present for car in acting}
            self._wait(api)
            seen = self._look(api)
            info = self._end(api)
        ended = self._left == 0
        newcomers = [] if ended else [car for car in self.agents if car not in rewards]
        everyone = [*acting, *newcomers]
        terminated, truncated = self._ends(ended)
        return (
            {car: seen[car] if car in seen else last_seen[car] for car in everyone},
            {car: rewards.get(car, 0.0) for car in everyone},
            {car: terminated or gone.get(car, False) for car in everyone},
            {car: truncated and not gone.get(car, False) for car in everyone},
            dict.fromkeys(everyone, info),
        )

    # ---- inside ------------------------------------------------------------------------------

    def _network(self) -> Path:
        return corridor(light(self.features["green"]))

    def _options(self) -> list[str]:
        return ["--collision.action", "warn", "--collision.mingap-factor", "0"]

    def _advance(self, api: Any) -> None:
        api.simulationStep()
        self._left -= 1
        self._region.update(api)
        self._find_agents()

    def _wait(self, api: Any) -> None:
        """Let traffic go on while there is nobody to decide."""
        while self._left > 0 and not self.agents:
            self._advance(api)
            if self.watcher is not None:
                self.watcher()

    def _find_agents(self) -> None:
        self.agents = [car for car in self._region.present if car in self._controlled]

    def _end(self, api: Any) -> dict[str, Any]:
        """At the horizon: the measures, and the end of the simulation."""
        if self._left > 0:
            return {}
        found = self._region.summary(self.horizon * STEP)
        self.summary = {"score": found[SCORES[self.scored]], **found} | {
            "not_inserted": float(len(api.simulation.getPendingVehicles())),
            "collisions": float(api.simulation.getParameter("", "stats.safety.collisions") or 0),
        }
        self._finish()
        return dict(self.summary)

    def _look(self, api: Any) -> dict[str, Observation]:
        """What each agent sees."""
        self._seen: dict[str, Observation] = {}
        if not self.agents:
            return self._seen
        position_of = api.vehicle.getLanePosition
        place = [
            (car, road, STARTS[road] + position_of(car))
            for road, cars in zip((2, 1, 0), self._region.roads, strict=True)
            for car in cars
        ]
        now = (WARM_UP + self.horizon - self._left) * STEP
        changes = [seconds / TIME_SCALE for seconds in self._light.changes(now)]
        signal = (*_ONE_HOT[self._light.phase(now)], *changes)
        for k, (car, road, x) in enumerate(place):
            if car not in self._controlled:
                continue
            leader = follower = ABSENT
            if k > 0:
                other, _, y = place[k - 1]
                leader = self._neighbour(other, y - self._length[other] - x)
            if k + 1 < len(place):
                other, _, y = place[k + 1]
                follower = self._neighbour(other, x - self._length[car] - y)
            speed = self._region.present[car].speed / SPEED_SCALE
            own = (speed, (APPROACH - x) / LENGTH_SCALE)
            sides = (speed, 0.0, 0.0, 0.0) * 4
            near = (*leader, *follower, *sides)
            seen = (*own, *signal, *_ONE_HOT[road], *_LANE, *near, *self.visible)
            self._seen[car] = np.array(seen, dtype=np.float32)
        return self._seen

    def _neighbour(self, car: str, gap: float) -> tuple[float, float, float, float]:
        return self._region.present[car].speed / SPEED_SCALE, gap / LENGTH_SCALE, 0.0, 0.0


def reward(trip: Trip) -> float:
    """Reward of an agent's last step (cmdp-spec, 6.2)."""
    crawling = max(0.0, CRAWL - trip.speed)
    return (trip.speed - CRAWL_COST * crawling - CO2_COST * trip.co2) / REWARD_SCALE


def check_context(context: Mapping[str, Value]) -> None:
    """Refuse what `full_context` could only call not positive."""
    share, green = context.get("penetration", 1.0), context.get("green", 1.0)
    if isinstance(share, (int, float)) and not 0.0 < share <= 1.0:
        raise ContextMismatch(f"penetration is a share in (0, 1], got {share!r}")
    if isinstance(green, (int, float)):
        light(green)


def _acceleration(action: Any) -> float:
    value = float(np.asarray(action, dtype=float).reshape(-1)[0])
    if not math.isfinite(value):
        raise InvalidInput(f"an acceleration is a finite number, got {action!r}")
    return value
