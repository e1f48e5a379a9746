"""A scenario of SUMO's as a Gymnasium environment, what its episodes measure, and its control.

An episode's last `info` tells `METRICS`, from SUMO's own outputs. All vehicles count that wanted to
depart: those that arrived, are on their way, or still wait to enter.

    delay        time loss on the way and delay of departure, per vehicle [s/veh]
    queue        vehicles that stand (below 0.1 m/s) or wait to enter, mean over time [veh]
    throughput   vehicles that arrived [veh/h]
    co2          by SUMO's emission model [kg/h]
    teleports    vehicles that SUMO took out of a jam, see its `--time-to-teleport`
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, ClassVar
from xml.etree import ElementTree

import gymnasium
import numpy as np
from gymnasium.spaces import Box, Discrete, MultiDiscrete

from mbtl.canvas import Image
from mbtl.contexts import Context
from mbtl.errors import InvalidInput, check_known
from mbtl.sumo.drawing import draw
from mbtl.sumo.scenario import Scenario, is_green
from mbtl.sumo.simulation import Simulation

METRICS = {
    "delay": "s/veh", "queue": "veh", "throughput": "veh/h", "co2": "kg/h", "teleports": "veh"
}  # fmt: skip
"""Unit by name."""


class Measured:
    """A folder in which SUMO writes what it measures.

    Attributes:
        folder: removed by `close`.
        options: of SUMO, that make it write there.
    """

    def __init__(self) -> None:
        self._made = TemporaryDirectory(prefix="mbtl-sumo-")
        self.folder, self.close = Path(self._made.name), self._made.cleanup
        self.options = {
            "tripinfo-output": str(self.folder / "trips.xml"),
            "tripinfo-output.write-undeparted": "true",
            "tripinfo-output.write-unfinished": "true",
            "statistic-output": str(self.folder / "statistics.xml"),
            "device.emissions.probability": "1",
        }

    def __getstate__(self) -> object:
        """There are no copies: one would remove the same folder."""
        raise TypeError("what SUMO writes in a folder cannot be copied or pickled")

    def metrics(self, seconds: float) -> dict[str, float]:
        """`METRICS` of a simulation that has ended after so many seconds."""
        trips = ElementTree.parse(self.folder / "trips.xml").findall("tripinfo")
        statistics = ElementTree.parse(self.folder / "statistics.xml")
        late, lost, stood = (
            sum(float(trip.get(name, 0)) for trip in trips)
            for name in ("departDelay", "timeLoss", "waitingTime")
        )
        arrived = sum(float(trip.get("arrival", -1)) >= 0 for trip in trips)
        emitted = sum(float(one.get("CO2_abs", 0)) for trip in trips for one in trip) / 1e6  # kg
        return {
            "delay": (lost + late) / max(len(trips), 1),
            "queue": (stood + late) / seconds,
            "throughput": arrived * 3600 / seconds,
            "co2": emitted * 3600 / seconds,
            "teleports": sum(float(one.get("total", 0)) for one in statistics.iter("teleports")),
        }


# ---- control -------------------------------------------------------------------------------------


class KeepOrGoOn:
    """Traffic lights by their own programmes: 0 keeps the green, 1 goes on through the yellow.

    A decision in yellow, or before the green has lasted its least, changes nothing. Seen are, from
    0 to 1: vehicles and halting vehicles on each lane that leads to the lights, as shares of what
    it holds; for each light which phase it shows, and whether 1 would go on. The reward is minus
    the vehicles that halt there or wait to enter, per lane.

    A class of your own has this one's attributes and methods, or inherits them. `sumo` is libsumo
    or a TraCI connection, which have the same functions.
    """

    ways: tuple[str, ...] = ("fixed time", "actuated")
    """Controllers of SUMO's own, which `act` takes by their names."""

    def __init__(
        self, scenario: Scenario, lights: Sequence[str] = (), min_green: float = 10.0
    ) -> None:
        """Nothing is simulated yet.

        Args:
            scenario: with the lights.
            lights: names of those to control; none: all.
            min_green: least seconds of a green.

        Raises:
            InvalidInput: the network has no light.
            UnknownName: it has no light of this name.
        """
        every = scenario.lights
        if not every:
            raise InvalidInput(
                "KeepOrGoOn needs a network with traffic lights, got none; give another control"
            )
        for name in lights:
            check_known("traffic light", name, every)
        self.lights, self.min_green = {name: every[name] for name in lights or every}, min_green
        self.lanes = sorted({lane for light in self.lights.values() for lane in light.lanes})
        size = 2 * len(self.lanes) + sum(light.phases + 1 for light in self.lights.values())
        self.observation_space = Box(0.0, 1.0, (size,))
        several = MultiDiscrete([2] * len(self.lights))
        self.action_space = several if len(self.lights) > 1 else Discrete(2)

    def begin(self, sumo: Any) -> None:
        """An episode has begun."""
        self._program = ""
        self._room = np.array([max(sumo.lane.getLength(lane) / 7.5, 1.0) for lane in self.lanes])

    def observe(self, sumo: Any) -> Any:
        """What the policy sees now."""
        cars = [sumo.lane.getLastStepVehicleNumber(lane) for lane in self.lanes]
        halting = [sumo.lane.getLastStepHaltingNumber(lane) for lane in self.lanes]
        self._waiting = sum(halting) + len(sumo.simulation.getPendingVehicles())
        seen = [*np.minimum([cars / self._room, halting / self._room], 1.0)]
        for name, light in self.lights.items():
            phase = sumo.trafficlight.getPhase(name)
            seen.append(np.array([*(np.arange(light.phases) == phase), self._ready(sumo, name)]))
        return np.concatenate(seen).astype(np.float32)

    def reward(self, sumo: Any) -> float:
        """Of the decision before the last observation."""
        return -float(self._waiting / len(self.lanes))

    def act(self, sumo: Any, action: Any) -> None:
        """Do what was decided; the seconds of a decision are simulated after it.

        Args:
            sumo: the simulation.
            action: of the action space, or one of `ways`.
        """
        program = action if isinstance(action, str) else "by policy"
        if self._program != program:
            self._program = program
            for name in self.lights:
                self._retime(sumo.trafficlight, name)
        for name, goes in zip(self.lights, np.atleast_1d(action), strict=False):
            if goes == 1 and self._ready(sumo, name):
                sumo.trafficlight.setPhaseDuration(name, 0.0)

    def _ready(self, sumo: Any, light: str) -> bool:
        """Whether the light may go on: it is green, and long enough."""
        green = is_green(sumo.trafficlight.getRedYellowGreenState(light))
        return green and sumo.trafficlight.getSpentDuration(light) >= self.min_green

    def _retime(self, on: Any, light: str) -> None:
        """Let a light go through its phases with the greens of another programme."""
        logics = {logic.programID: logic for logic in on.getAllProgramLogics(light)}
        phases = logics[on.getProgram(light)].phases
        for phase in phases:
            shortest = longest = phase.duration
            if is_green(phase.state) and self._program in _GREENS:
                shortest, longest = _GREENS[self._program]
            phase.duration = phase.maxDur = longest
            phase.minDur = shortest
        kind = 3 if self._program == "actuated" else 0  # as SUMO numbers them
        on.setProgramLogic(light, on.Logic(self._program, kind, on.getPhase(light), phases))


_GREENS = {"by policy": (1e6, 1e6), "actuated": (5.0, 50.0)}
"""Least and most seconds; the latter are SUMO's defaults."""


# ---- the whole -----------------------------------------------------------------------------------

Step = tuple[Any, float, bool, bool, dict[str, Any]]


class ScenarioEnv(gymnasium.Env):  # type: ignore[misc]  # gymnasium is untyped for our checker
    """A scenario in one context: an episode is a simulation that ends after a given time.

    Attributes:
        control: what a policy sees, does and is rewarded for.
        episode_steps: decisions of an episode.
        ways: controllers of SUMO's own, for `follow`.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": ["rgb_array"], "render_fps": 5}

    def __init__(
        self,
        context: Context,
        scenario: Scenario,
        control: Callable[[Scenario], Any] = KeepOrGoOn,
        *,
        decision: float = 5.0,
        seconds: float | None = None,
        render_mode: str | None = None,
    ) -> None:
        """Nothing is simulated before `reset`.

        Args:
            context: a value for every change of the scenario.
            scenario: the files, and what a context changes in them.
            control: scenario -> what a policy sees and does, see `KeepOrGoOn`.
            decision: seconds of one decision.
            seconds: of an episode; None: from the scenario's begin to its end.
            render_mode: "rgb_array": `render` gives pictures.

        Raises:
            InvalidInput: an episode without an end, or a decision that takes no time.
        """
        self.seconds = scenario.seconds if seconds is None else seconds
        for what, value in (("an episode", self.seconds), ("a decision", decision)):
            if not value > 0:
                raise InvalidInput(f"{what} takes seconds > 0, got {value:g}; give seconds")
        self.control: Any = control(scenario)
        self.observation_space = self.control.observation_space
        self.action_space = self.control.action_space
        self.ways: tuple[str, ...] = getattr(self.control, "ways", ())
        self.episode_steps = math.ceil(self.seconds / decision)
        self.render_mode, self._decision = render_mode, decision
        self._scenario, self._context = scenario, context
        self._measured: Measured | None = None
        self._picture: Image | None = None
        self._left = 0

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start the scenario, with a seed of SUMO's that follows from this one."""
        super().reset(seed=seed)
        if self._measured is None:
            self._measured = Measured()
            files = self._scenario.files(self._context).write(self._measured.folder)
            self.simulation = Simulation(arguments({**files, **self._measured.options}))
        self.simulation.start(None, int(self.np_random.integers(2**31)))
        self._left = self.episode_steps
        with self.simulation.guard() as sumo:
            self._end = sumo.simulation.getTime() + self.seconds
            self.control.begin(sumo)
            return self.control.observe(sumo), {}

    def step(self, action: Any) -> Step:
        """One decision; the last one's `info` tells `METRICS`.

        Raises:
            InvalidInput: no episode is running.
            SimulationFailed: the simulator has stopped.
        """
        if self._measured is None or not self._left:
            raise InvalidInput("a step belongs to an episode, got none that runs; call reset()")
        with self.simulation.guard() as sumo:
            if action is not None:
                self.control.act(sumo, action)
            sumo.simulationStep(min(sumo.simulation.getTime() + self._decision, self._end))
            seen, reward = self.control.observe(sumo), self.control.reward(sumo)
        self._left -= 1
        if self._left:
            return seen, reward, False, False, {}
        if self.render_mode is not None:
            self._draw()  # the last picture: nothing is left to draw it from later
        self.simulation.close()
        return seen, reward, False, True, self._measured.metrics(self.seconds)

    def drive(self) -> Step:
        """A decision of nobody: the scenario goes on as its files say."""
        return self.step(None)

    def follow(self, way: str) -> Step:
        """A decision of a controller of SUMO's own, one of `ways`."""
        check_known("way", way, self.ways)
        return self.step(way)

    def render(self) -> Image | None:
        """The network as it is now, (height, width, 3); after the last step, as it was then."""
        if self._left:
            self._draw()
        return self._picture

    def _draw(self) -> None:
        with self.simulation.guard() as sumo:
            self._picture = draw(sumo)

    def close(self) -> None:
        """End the simulation and remove its files."""
        if self._measured is not None:
            self.simulation.close()
            self._measured.close()
        self._measured, self._left = None, 0


def arguments(options: Mapping[str, str]) -> list[str]:
    """Of SUMO's command line."""
    return [word for name, value in options.items() for word in (f"--{name}", value)]
