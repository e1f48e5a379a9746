"""Highway ramp: every tenth car of the main road is advised, for the good of all (cmdp-spec, 7.3).

A main road of 400 m and a ramp of 100 m share a merge section of 100 m with two lanes, one for
each, which end as a zipper in an exit of 30 m. Decentralised: one agent per advised car on the
road, one shared policy; a PettingZoo parallel environment whose agents come and go.

    observation   distance to the zipper (behind it: 500 m), speed; distance of fronts and speed of
                  the leader; of the follower; distance to the zipper and speed of the first ramp
                  car before it. Distances/500 m (absent: 1), speeds/30 m/s (absent: 0), clipped to
                  0..1, mapped to -1..1; then the visible features
    acceleration  -1..1: up to +1 and down to -1.5 m/s^2, at every simulation step of the hold
    speed         level 0..9, target 30 level/9 m/s, no faster than the road allows
    reward        mean over the hold's steps of (cars that left - 50 collided cars), same for all
    score         mean speed of all cars over the measured part [m/s]: mean over steps of the mean
                  over cars; those that have collided are gone from the road and count as standing
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar, NamedTuple, Unpack

import numpy as np

from mbtl.contexts import Value
from mbtl.sumo import network
from mbtl.zoo.cmdps.contextual import Observation, Stepped
from mbtl.zoo.cmdps.traffic import advisory
from mbtl.zoo.cmdps.traffic.advisory import Actions, Advice, Drivers, Seen
from mbtl.zoo.cmdps.traffic.simulation import Settings, TrafficTeam

MAIN, MERGE, EXIT, RAMP = 400.0, 100.0, 30.0, 100.0


class Demand(NamedTuple):
    """Cars that come to a road, evenly spaced.

    Attributes:
        flow: cars per hour.
        speed: at which they enter [m/s].
    """

    flow: float
    speed: float


DEMAND = {"main": Demand(2000.0, 10.0), "ramp": Demand(300.0, 0.0)}
FIRST = 1.0
"""Second in which the first car of each road comes."""
ZIPPER_GAPS = 8.0, math.hypot(8.0, 3.2)
"""Metres between the ends of the merge lanes, of the main road and of the ramp, and the exit, in
the compiled network; no road has them, but SUMO adds them to the time a car takes to pass."""
EVERY = 10
"""One main-road car in so many is advised, beginning with the first that enters."""
LANE_CHANGE_MODE = 512
"""None of SUMO's own changes. They are sought only where cars are advised: those behind a slow one
would fill the lane of the ramp. The reference has none either (its code; not in the paper)."""
CAR = advisory.LENGTH + advisory.MIN_GAP
LEVELS, TOP_SPEED = 10, 30.0
SPEED_UP, SLOW_DOWN = 1.0, 1.5
COLLISION = 50.0
SCALE = 500.0, 30.0
"""Divisors of distances [m] and speeds [m/s] in an observation."""
_REACH = SCALE[0]
_NOBODY = _REACH, 0.0
_LONGEST = 40.0
"""Seconds by which the longest hold can outlast the end of the measured part."""

_AHEAD = {"main": MAIN + MERGE, "ramp": RAMP + MERGE, "merge": MERGE, "exit": 0.0}
"""Distance from the start of each edge to the zipper [m]."""


class Ramp(TrafficTeam):
    """The ramp with either kind of advice; `RampAcc` and `RampVel` are the CMDPs' own.

    Attributes:
        agents: advised cars on the road, in the order in which they entered.
        possible_agents: the cars of the main road; those of them that are advised depends on who
            finds room to enter.
    """

    FEATURES: ClassVar[Mapping[str, float]] = {"hold": 1.0}  # s
    HIDDEN = frozenset(FEATURES)
    STEP = advisory.STEP
    HORIZON = advisory.HORIZON
    ACTIONS: ClassVar[Actions] = "acceleration"
    metadata: ClassVar[dict[str, Any]] = {**TrafficTeam.metadata, "name": "mbtl-ramp"}
    most_agents = math.ceil((MAIN + MERGE + EXIT) / CAR / EVERY)

    def __init__(
        self,
        context: Mapping[str, Value] | None = None,
        *,
        obs: Seen = "fresh",
        noise: float = advisory.NOISE,
        **settings: Unpack[Settings],
    ) -> None:
        """Arguments as in `mbtl.zoo.cmdps.traffic.ring.Ring`."""
        advisory.check_seen(obs)
        super().__init__(context, **settings)
        self.hold = advisory.hold_steps(self.features["hold"])
        self._obs, self._noise = obs, noise
        self._observation_space = self._space([-1.0] * 8, [1.0] * 8)
        self._action_space = advisory.action_space(self.ACTIONS, LEVELS)
        self._routes, self.possible_agents, self._last_chances = _demand()

    @property
    def episode_steps(self) -> int:
        """Holds that fill the controlled time."""
        return advisory.decisions(self.features["hold"], self.horizon)

    # ---- episodes ----------------------------------------------------------------------------

    @property
    def controlled(self) -> frozenset[str]:
        """The advised cars that have entered."""
        return frozenset(self._advised)

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Observation], dict[str, dict[str, Any]]]:
        """Start with empty roads and let traffic build up for 100 s."""
        if seed is not None:
            self._seed(seed)
        self.simulation.start(self._routes, self._draw_seed())
        self._drivers = Drivers(self.np_random, self._noise)
        self._main_cars, self._advised, self._entered = 0, set[str](), set[str]()
        self._gone, self._wanted, self._missed = 0, 0, 0
        self._steps, self._means, self._collided = -advisory.WARM_UP, 0.0, 0
        self._seen: dict[str, Observation] = {}
        self._steered: set[str] = set()
        self._left = self.episode_steps
        with self.simulation.guard() as api:
            for _ in range(advisory.WARM_UP):
                self._advance(api, {})
            self._look(api)
        return {car: self._seen[car] for car in self.agents}, {car: {} for car in self.agents}

    def step(self, actions: Mapping[str, Any]) -> Stepped:
        """Follow one instruction per advised car for the hold.

        An agent that leaves the road within the hold is terminated; one that enters drives by
        itself until it is in `agents`. A car without an action drives by itself, so that `step({})`
        is traffic without advice.

        Raises:
            InvalidInput: no episode is running, or an action is no speed level.
            SimulationFailed: the simulator has stopped.
        """
        self._check_running()
        acting = self.agents
        with self.simulation.guard() as api:
            reward = self._follow(api, actions)
            self._left -= 1
            while self._left > 0 and not self.agents:  # nobody to decide: traffic goes on
                self._follow(api, {})
                self._left -= 1
        ended = self._left == 0
        newcomers = [] if ended else [car for car in self.agents if car not in acting]
        everyone = [*acting, *newcomers]
        gone = {car: car not in self.agents for car in acting}
        terminated, truncated = self._ends(ended)
        info: dict[str, Any] = self.summary if ended else {}
        if ended:
            self._finish()
        return (
            {car: self._seen[car] for car in everyone},
            {car: reward if car in gone else 0.0 for car in everyone},
            {car: terminated or gone.get(car, False) for car in everyone},
            {car: truncated and not gone.get(car, False) for car in everyone},
            dict.fromkeys(everyone, info),
        )

    @property
    def score(self) -> float:
        """Mean speed of all cars over the measured part so far [m/s]; 0 before it begins."""
        measured = self._steps - advisory.UNMEASURED
        return self._means / measured if measured > 0 else 0.0

    @property
    def summary(self) -> dict[str, float]:
        """The score, and what tells whether it was bought by keeping cars out.

        Of the measured part so far: `throughput`, cars per hour that reached the end, and
        `dropped`, the share of those that came that found no room to enter. Of the whole episode:
        `collided` cars.
        """
        hours = max(self._steps - advisory.UNMEASURED, 1) * advisory.STEP / 3600.0
        return {
            "score": self.score,
            "throughput": self._gone / hours,
            "dropped": self._missed / max(self._wanted, 1),
            "collided": self._collided,
        }

    # ---- inside ------------------------------------------------------------------------------

    def _options(self) -> list[str]:
        return advisory.OPTIONS

    def _network(self) -> Path:
        return _ramp()

    def _follow(self, api: Any, actions: Mapping[str, Any]) -> float:
        """One hold; the mean reward of its steps."""
        advice = {car: self._advice(actions[car]) for car in self.agents if car in actions}
        for car in self.agents:
            if car not in advice:
                api.vehicle.setSpeed(car, -1.0)
            elif car not in self._steered:
                self._steered.add(car)
                api.vehicle.setSpeedMode(car, advisory.SPEED_MODE)
        total = 0.0
        for k in range(self.hold):
            total += self._advance(api, advice)
            if k == 0 and self._obs == "stale":
                self._look(api)
        stale = dict(self._seen)
        self._look(api)
        if self._obs == "stale":  # cars that came later have nothing older
            self._seen.update(stale)
        return total / self.hold

    def _advice(self, action: Any) -> Advice:
        if self.ACTIONS == "speed":
            target = TOP_SPEED * advisory.level_of(action, LEVELS) / (LEVELS - 1)
            return Advice(min(target, advisory.ROAD_LIMIT))
        push = min(max(float(np.asarray(action).reshape(-1)[0]), -1.0), 1.0)
        return Advice(acceleration=push * (SPEED_UP if push > 0 else SLOW_DOWN))

    def _advance(self, api: Any, advice: Mapping[str, Advice]) -> float:
        """One simulation step; its reward."""
        vehicle, simulation = api.vehicle, api.simulation
        if advice:
            present = set(vehicle.getIDList())
            for car, told in advice.items():
                if car in present:
                    vehicle.setSpeed(car, told.speed(vehicle.getSpeed(car)))
        api.simulationStep()
        self._steps += 1
        for car in simulation.getDepartedIDList():
            self._enrol(api, car)
        cars = vehicle.getIDList()
        steady = self._advised if self._steps > 0 else ()
        speeds = self._drivers.step(api, cars, steady)
        collided: int = simulation.getCollidingVehiclesNumber()
        self._collided += collided
        arrived: int = simulation.getArrivedNumber()
        if self._steps > advisory.UNMEASURED:
            if speeds:
                self._means += sum(speeds) / (len(speeds) + self._collided)
            late = self._last_chances.get(self._steps + advisory.WARM_UP - 1, ())
            self._gone += arrived
            self._wanted += len(late)
            self._missed += sum(car not in self._entered for car in late)
        return float(arrived) - COLLISION * collided

    def _enrol(self, api: Any, car: str) -> None:
        """A car has entered."""
        self._entered.add(car)
        api.vehicle.setLaneChangeMode(car, LANE_CHANGE_MODE)
        if car.startswith("main"):
            if self._main_cars % EVERY == 0:
                self._advised.add(car)
            self._main_cars += 1

    def _look(self, api: Any) -> None:
        """Find the advised cars on the road and what each of them sees."""
        vehicle = api.vehicle
        cars = vehicle.getIDList()
        ramp_cars = [_distance(vehicle, car) for car in cars if car.startswith("ramp")]
        waiting = [(d, car) for d, car in zip(ramp_cars, _ramp_ids(cars), strict=True) if d > 0]
        first = min(waiting, default=None)
        merging = _NOBODY if first is None else (first[0], vehicle.getSpeed(first[1]))
        self.agents = sorted((c for c in cars if c in self._advised), key=self._order)
        for car in self.agents:
            ahead = _distance(vehicle, car)
            raw = (
                *(ahead or _REACH, vehicle.getSpeed(car)),
                *_neighbour(vehicle, vehicle.getLeader(car, _REACH)),
                *_neighbour(vehicle, vehicle.getFollower(car, _REACH)),
                *(merging if ahead else _NOBODY),
            )
            share = np.array(raw) / np.array(SCALE * 4)
            seen = 2.0 * np.clip(share, 0.0, 1.0) - 1.0
            self._seen[car] = np.array([*seen, *self.visible], dtype=np.float32)

    def _order(self, car: str) -> int:
        return int(car.removeprefix("main"))


class RampAcc(Ramp):
    """`ramp-acc`: an acceleration is advised."""


class RampVel(Ramp):
    """`ramp-vel`: a speed is advised."""

    ACTIONS: ClassVar[Actions] = "speed"


def _ramp_ids(cars: Any) -> list[str]:
    return [car for car in cars if car.startswith("ramp")]


def _distance(vehicle: Any, car: str) -> float:
    """From the front of a car to the zipper [m]; 0 behind it."""
    start = _AHEAD.get(vehicle.getRoadID(car), 0.0)
    ahead = start - float(vehicle.getLanePosition(car))
    return max(0.0, ahead)


def _neighbour(vehicle: Any, found: Any) -> tuple[float, float]:
    """Distance of fronts and speed of a leader or follower; SUMO gives the gap beyond the least."""
    if not found or not found[0]:
        return _NOBODY
    fronts = found[1] + advisory.MIN_GAP + advisory.LENGTH
    return max(0.0, fronts), float(vehicle.getSpeed(found[0]))


def _ramp() -> Path:
    slant = RAMP / np.sqrt(2.0)
    places = {
        "start": (0.0, 0.0, "priority"),
        "foot": (MAIN - slant, -slant, "priority"),
        "join": (MAIN, 0.0, "priority"),
        "zipper": (MAIN + MERGE, 0.0, "zipper"),
        "end": (MAIN + MERGE + EXIT, 0.0, "priority"),
    }
    nodes = "".join(
        f'<node id="{id}" x="{x:.3f}" y="{y:.3f}" type="{kind}"/>'
        for id, (x, y, kind) in places.items()
    )
    edges = "".join(
        f'<edge id="{id}" from="{a}" to="{b}" numLanes="{lanes}" length="{length:g}" '
        f'speed="{advisory.ROAD_LIMIT}"/>'
        for id, a, b, lanes, length in (
            ("main", "start", "join", 1, MAIN),
            ("ramp", "foot", "join", 1, RAMP),
            ("merge", "join", "zipper", 2, MERGE),
            ("exit", "zipper", "end", 1, EXIT),
        )
    )
    links = "".join(
        f'<connection from="{a}" to="{b}" fromLane="{i}" toLane="{j}"/>'
        for a, b, i, j in (
            ("main", "merge", 0, 1),
            ("ramp", "merge", 0, 0),
            ("merge", "exit", 0, 0),
            ("merge", "exit", 1, 0),
        )
    )
    return network(
        {
            "nodes": f"<nodes>{nodes}</nodes>",
            "edges": f"<edges>{edges}</edges>",
            "connections": f"<connections>{links}</connections>",
        },
        "--no-internal-links",
    )


def _demand() -> tuple[str, list[str], dict[int, list[str]]]:
    """XML of all cars of an episode, those of the main road, and when they give up entering.

    The last maps simulation steps, counted from the start, to the cars whose last try is then.
    """
    steps = advisory.WARM_UP + advisory.UNMEASURED + advisory.MEASURED
    seconds = steps * advisory.STEP + _LONGEST
    cars = []
    for road, demand in DEMAND.items():
        times = np.arange(FIRST, seconds, 3600.0 / demand.flow)
        cars += [(time, road, k, demand.speed) for k, time in enumerate(times.tolist())]
    rows = "".join(
        f'<vehicle id="{road}{k}" type="human" route="{road}" depart="{time:.2f}" '
        f'departSpeed="{speed:g}"/>'
        for time, road, k, speed in sorted(cars)
    )
    ways = "".join(f'<route id="{a}" edges="{a} merge exit"/>' for a in ("main", "ramp"))
    main = [f"main{k}" for _, road, k, _ in sorted(cars) if road == "main"]
    last_chances: dict[int, list[str]] = {}
    for time, road, k, _ in cars:
        step = round((time + advisory.PATIENCE) / advisory.STEP)
        last_chances.setdefault(step, []).append(f"{road}{k}")
    text = f'<routes><vType id="human" {advisory.IDM}/>{ways}{rows}</routes>'
    return text, main, last_chances
