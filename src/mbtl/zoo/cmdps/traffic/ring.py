"""Ring road: one advised car among 22 keeps traffic from stopping and going (cmdp-spec, 7.2).

Notation: v speed of the advised car and u of its leader [m/s]; d front-to-front distance [m].

    observation   (v/10, u/10, d/300), clipped to 0..1, mapped to -1..1; then the visible features
    acceleration  a in -1..1, 0.5 a m/s^2, applied at every simulation step of the hold
    speed         level 0..9, target 10 level/9 m/s
    reward        mean over the hold of v, or -100 at a step in which cars collide, which also ends
                  the episode
    score         mean speed of all cars over the measured part [m/s]; from a collision to the end
                  of the time they stand
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar, Literal, Unpack

import numpy as np

from mbtl.contexts import Value
from mbtl.errors import SimulationFailed, check_known
from mbtl.sumo import network
from mbtl.zoo.cmdps.contextual import Observation
from mbtl.zoo.cmdps.traffic import advisory
from mbtl.zoo.cmdps.traffic.advisory import Actions, Advice, Drivers, Seen
from mbtl.zoo.cmdps.traffic.simulation import Settings, TrafficEnv

CARS = 22
CIRCUMFERENCE = 250.0
LEVELS = 10
TOP_SPEED = 10.0
REACH = 0.5
"""Largest acceleration that can be advised [m/s^2]."""
COLLISION = -100.0
CLOSEST = 0.1
"""Smallest gap that the advised car keeps [m]. The reference sets 0, where SUMO's IDM, at rest,
creeps forward by a centimetre a step until it touches its leader; 0.1 costs 0.005 m/s of flow."""

_HALF = CIRCUMFERENCE / 2.0
_IDS = [f"car{i}" for i in range(CARS)]
_ADVISED, _LEADER = _IDS[0], _IDS[1]
SCALE = (10.0, 10.0, 300.0)
"""Of speed, leader's speed and distance in an observation."""

Start = Literal["free", "uniform"]


class Ring(TrafficEnv):
    """The ring with either kind of advice; `RingAcc` and `RingVel` are the CMDPs' own.

    The reward is in m/s: the reference's running normalisation belongs to the training.
    """

    FEATURES: ClassVar[Mapping[str, float]] = {"hold": 1.0}  # s
    HIDDEN = frozenset(FEATURES)
    STEP = advisory.STEP
    HORIZON = advisory.HORIZON
    ACTIONS: ClassVar[Actions] = "acceleration"

    def __init__(
        self,
        context: Mapping[str, Value] | None = None,
        *,
        obs: Seen = "fresh",
        start: Start = "free",
        noise: float = advisory.NOISE,
        **settings: Unpack[Settings],
    ) -> None:
        """Nothing is simulated before `reset`.

        Args:
            context: the hold [s], a multiple of 0.1 s.
            obs: "fresh": the state at the decision. "stale": after the first simulation step of the
                hold before, as in the reference.
            start: cars at rest with random gaps, or with equal ones.
            noise: of the drivers [m/s^2].
            **settings: see `Traffic`. 400 s of control are fewer decisions than `horizon` at holds
                above 1 s.
        """
        advisory.check_seen(obs)
        check_known("start", start, ("free", "uniform"))
        super().__init__(context, **settings)
        self.hold = advisory.hold_steps(self.features["hold"])
        self._obs, self._start, self._noise = obs, start, noise
        self.observation_space = self._space([-1.0] * 3, [1.0] * 3)
        self.action_space = advisory.action_space(self.ACTIONS, LEVELS)

    @property
    def episode_steps(self) -> int:
        """Holds that fill the controlled time."""
        return advisory.decisions(self.features["hold"], self.horizon)

    # ---- episodes ----------------------------------------------------------------------------

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start 22 cars at rest and let them drive for 100 s."""
        super().reset(seed=seed)
        self.simulation.start(_routes(), self._draw_seed())
        self._drivers = Drivers(self.np_random, self._noise)
        self._steady: set[str] = set()
        self._controlled_steps, self._speed_sum, self._speeds_measured = 0, 0.0, 0
        with self.simulation.guard() as api:
            self._place(api)
            for _ in range(advisory.WARM_UP):
                api.simulationStep()
                self._drivers.step(api, _IDS, self._steady)
            if api.vehicle.getIDCount() != CARS:
                raise SimulationFailed("cars of the ring collided before any was advised")
            api.vehicle.setMinGap(_ADVISED, CLOSEST)
            api.vehicle.setSpeedMode(_ADVISED, advisory.SPEED_MODE)
            self._steady.add(_ADVISED)
            observation = self._observe(api)
        self._left = self.episode_steps
        return observation, {}

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Follow one instruction for the hold.

        Raises:
            InvalidInput: no episode is running, or the action is no speed level.
            SimulationFailed: the simulator has stopped.
        """
        return self._decide(self._advice(action))

    @property
    def controlled(self) -> frozenset[str]:
        """The advised car."""
        return frozenset([_ADVISED])

    def drive(self) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """One hold without advice: the unguided baseline."""
        return self._decide(None)

    # ---- inside ------------------------------------------------------------------------------

    def _advice(self, action: Any) -> Advice:
        if self.ACTIONS == "speed":
            return Advice(TOP_SPEED * advisory.level_of(action, LEVELS) / (LEVELS - 1))
        push = min(max(float(np.asarray(action).reshape(-1)[0]), -1.0), 1.0)
        return Advice(acceleration=REACH * push)

    def _decide(
        self, advice: Advice | None
    ) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        self._check_running()
        total, collided, first, steps = 0.0, False, None, 0
        with self.simulation.guard() as api:
            set_speed = api.vehicle.setSpeed
            speed = api.vehicle.getSpeed(_ADVISED)
            for _ in range(self.hold):
                set_speed(_ADVISED, -1.0 if advice is None else advice.speed(speed))
                api.simulationStep()
                steps += 1
                if api.simulation.getCollidingVehiclesNumber():
                    collided = True
                    total += COLLISION
                    break
                speeds = self._drivers.step(api, _IDS, self._steady)
                speed = speeds[0]
                total += speed
                self._measure(speeds)
                if first is None and self._obs == "stale":
                    first = self._observe(api)
            if collided:
                self._stand()
                observation = self._blind()
            else:
                observation = self._observe(api) if first is None else first
        self._left -= 1
        out_of_time = self._left == 0 and not collided
        info: dict[str, Any] = {}
        if self._left == 0 or collided:
            info = {"score": self.score, "collided": collided}
            self._finish()
        terminated, truncated = self._ends(out_of_time)
        return observation, total / steps, collided or terminated, truncated, info

    @property
    def score(self) -> float:
        """Mean speed of all cars over the measured part so far [m/s]; 0 before it begins."""
        return self._speed_sum / self._speeds_measured if self._speeds_measured else 0.0

    def _measure(self, speeds: list[float]) -> None:
        self._controlled_steps += 1
        if self._controlled_steps > advisory.UNMEASURED:
            self._speed_sum += sum(speeds)
            self._speeds_measured += CARS

    def _stand(self) -> None:
        """Count speeds of 0 for all the time that a collision leaves."""
        steps = self.episode_steps * self.hold
        self._speeds_measured = CARS * max(0, steps - advisory.UNMEASURED)

    def _observe(self, api: Any) -> Observation:
        vehicle = api.vehicle
        distance = (_position(vehicle, _LEADER) - _position(vehicle, _ADVISED)) % CIRCUMFERENCE
        raw = np.array([vehicle.getSpeed(_ADVISED), vehicle.getSpeed(_LEADER), distance])
        seen = 2.0 * np.clip(raw / np.array(SCALE), 0.0, 1.0) - 1.0
        self._last = np.array([*seen, *self.visible], dtype=np.float32)
        return self._last

    def _blind(self) -> Observation:
        """After a collision the cars are gone: what was seen last."""
        return self._last

    def _place(self, api: Any) -> None:
        need = advisory.LENGTH + advisory.MIN_GAP
        spare = CIRCUMFERENCE - CARS * need
        if self._start == "uniform":
            shares = np.full(CARS, 1.0 / CARS)
        else:
            shares = self.np_random.dirichlet(np.ones(CARS))
        fronts = np.cumsum(need + spare * shares) - 1e-6 * np.arange(CARS)
        for car, front in zip(_IDS, fronts.tolist(), strict=True):
            half, position = divmod(front % CIRCUMFERENCE, _HALF)
            route = "north" if half == 0 else "south"
            api.vehicle.add(car, route, "human", departPos=f"{position:.6f}", departSpeed="0")
        api.simulationStep()
        placed = api.vehicle.getIDCount()
        if placed != CARS:
            raise SimulationFailed(f"the ring takes {CARS} cars, SUMO placed {placed}")

    def _options(self) -> list[str]:
        return advisory.OPTIONS

    def _network(self) -> Path:
        return _ring()


class RingAcc(Ring):
    """`ring-acc`: an acceleration is advised."""


class RingVel(Ring):
    """`ring-vel`: a speed is advised."""

    ACTIONS: ClassVar[Actions] = "speed"


def _position(vehicle: Any, car: str) -> float:
    """Front of a car along the ring [m]."""
    half = 0.0 if vehicle.getRoadID(car) == "north" else _HALF
    return half + float(vehicle.getLanePosition(car))


def _ring() -> Path:
    """Two half circles without junction lanes, so that the length is exact."""
    radius = CIRCUMFERENCE / math.tau

    def arc(start: float) -> str:
        angles = np.linspace(start, start + math.pi, 25)
        return " ".join(f"{radius * math.cos(a):.3f},{radius * math.sin(a):.3f}" for a in angles)

    nodes = "".join(
        f'<node id="{id}" x="{x:.3f}" y="0" type="priority"/>'
        for id, x in (("east", radius), ("west", -radius))
    )
    edges = "".join(
        f'<edge id="{id}" from="{a}" to="{b}" numLanes="1" speed="{advisory.ROAD_LIMIT}" '
        f'length="{_HALF}" shape="{arc(start)}"/>'
        for id, a, b, start in (("north", "east", "west", 0.0), ("south", "west", "east", math.pi))
    )
    return network(
        {"nodes": f"<nodes>{nodes}</nodes>", "edges": f"<edges>{edges}</edges>"},
        "--no-internal-links",
    )


def _routes() -> str:
    laps = 'repeat="10000"'
    return (
        f'<routes><vType id="human" {advisory.IDM}/>'
        f'<route id="north" edges="north south" {laps}/>'
        f'<route id="south" edges="south north" {laps}/></routes>'
    )
