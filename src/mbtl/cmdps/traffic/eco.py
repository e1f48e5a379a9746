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
from typing import Any, ClassVar, Literal, Unpack

import numpy as np
from gymnasium.spaces import Box

from mbtl.cmdps.canvas import Window
from mbtl.cmdps.contextual import Observation
from mbtl.cmdps.traffic.corridor import (
    APPROACH,
    FEEDERS,
    LENGTH,
    LIMIT,
    RED,
    STARTS,
    STEP,
    corridor,
    light,
)
from mbtl.cmdps.traffic.environment import Settings
from mbtl.cmdps.traffic.population import CONTROLLED, CONTROLLED_LENGTH, population, routes
from mbtl.cmdps.traffic.team import TrafficTeam
from mbtl.cmdps.traffic.trips import Region, Trip
from mbtl.contexts import Value
from mbtl.errors import ContextMismatch, InvalidInput, unknown_name

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
        if score not in SCORES:
            raise unknown_name("score", score, SCORES)
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

    def step(
        self, actions: Mapping[str, Any]
    ) -> tuple[
        dict[str, Observation],
        dict[str, float],
        dict[str, bool],
        dict[str, bool],
        dict[str, dict[str, Any]],
    ]:
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
