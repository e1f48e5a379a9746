"""What the traffic environments share: an episode is a simulation, its score is not its return.

The return is the sum of the rewards that a policy is trained on. The score is the matrix entry
(cmdp-spec, 5-7), `info["score"]` of an episode's last step; larger is better.

`Traffic` knows no interface: `TrafficEnv` here makes it a Gymnasium environment, `TrafficTeam` a
PettingZoo one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, ClassVar, Literal, NamedTuple, Unpack

import numpy as np
from gymnasium.spaces import Space
from gymnasium.utils.seeding import np_random

from mbtl.canvas import Image, Window
from mbtl.contexts import Value
from mbtl.errors import InvalidInput, needs, unknown_name
from mbtl.sumo import CARS, CONTROLLED, Engine, Legend, Simulation, draw
from mbtl.zoo.cmdps import contextual
from mbtl.zoo.cmdps.contextual import Contextual, ContextualEnv, TimeLimit, Visibility

SEEDS = 2**31 - 1
"""SUMO takes seeds of 31 bits."""

RenderMode = Literal["rgb_array"]


class Sight(NamedTuple):
    """What a picture shows in numbers.

    Attributes:
        clock: simulated time [s].
        speed: mean speed of all cars [m/s]; NaN without any.
    """

    clock: float
    speed: float


class Settings(contextual.Settings, total=False):
    """Arguments that every traffic environment takes beside its context; see `Traffic`."""

    engine: Engine
    gui: bool


class Traffic(Contextual):
    """A scenario in SUMO, built from a context.

    A subclass gives the network and SUMO's options and starts `self.simulation` in `reset`.

    Attributes:
        simulation: the running simulation; between episodes it is not running.
        sight: what the latest picture shows, in numbers; None before any.
    """

    STEP: ClassVar[float]
    """Seconds of one simulation step."""
    WINDOW: ClassVar[Window | None] = None
    """What `render` shows of the network; None: all of it."""
    SCORE: str = "m/s"
    """Unit of the score."""
    LEGEND: ClassVar[Legend] = (*CARS, CONTROLLED)
    """Of the colours of pictures."""
    watcher: Callable[[], None] | None = None
    """Told of every step that is simulated while nobody decides."""

    np_random: np.random.Generator
    render_mode: str | None
    metadata: ClassVar[dict[str, Any]] = {"render_modes": ["rgb_array"], "render_fps": 10}

    def __init__(
        self,
        context: Mapping[str, Value] | None = None,
        *,
        unit: Mapping[str, float] | None = None,
        visibility: Visibility | None = None,
        time_limit: TimeLimit = "truncation",
        horizon: int | None = None,
        engine: Engine = "auto",
        gui: bool = False,
        render_mode: RenderMode | None = None,
    ) -> None:
        """Nothing is simulated before `reset`.

        Args:
            context: features that differ from the nominal ones.
            unit: varied features and their value at multiplier 1; missing: those of `context`, at
                their nominal value.
            visibility: what of the context the policy sees; None: as in the CMDPs, the multipliers
                of features that are not `HIDDEN`.
            time_limit: whether the end of time is reported as truncation or as a terminal state.
            horizon: most decisions of an episode; missing: `HORIZON`.
            engine: see `Simulation`.
            gui: show it in sumo-gui.
            render_mode: "rgb_array": `render` gives images.

        Raises:
            UnknownName: a feature, or one of the settings, is not known.
            ContextMismatch: no such traffic can be built.
            MissingExtra: SUMO is not installed.
        """
        if render_mode not in (None, "rgb_array"):
            raise unknown_name("render mode", render_mode, ["rgb_array"])
        super().__init__(
            context, unit=unit, visibility=visibility, time_limit=time_limit, horizon=horizon
        )
        self.render_mode = render_mode
        self._picture: Image | None = None
        self.sight: Sight | None = None
        self.simulation = Simulation(
            [
                *("--net-file", str(self._network()), "--step-length", f"{self.STEP:g}"),
                *("--time-to-teleport", "-1", *self._options()),
            ],
            engine=engine,
            gui=gui,
        )

    @property
    def episode_steps(self) -> int:
        """Most decisions of an episode in this context."""
        return self.horizon

    @property
    def controlled(self) -> frozenset[str]:
        """Cars that somebody controls, which pictures mark."""
        return frozenset()

    def _network(self) -> Path:
        """The compiled network of this context."""
        raise NotImplementedError

    def _options(self) -> list[str]:
        """Further arguments of sumo."""
        return []

    def _draw_seed(self) -> int:
        """Seed of one simulation, from the environment's own generator."""
        return int(self.np_random.integers(SEEDS))

    def _check_running(self) -> None:
        """Refuse a step before `reset`, after the last step, and after the simulator has failed."""
        if self._left <= 0 or self.simulation.running is None:
            raise self._no_episode()

    def render(self) -> Image:
        """The traffic as it is now; after the last step, as it was then.

        Returns:
            (height, width, 3) uint8.

        Raises:
            InvalidInput: made without `render_mode`, or nothing has been simulated.
        """
        if self.render_mode is None:
            raise InvalidInput("render() needs render_mode='rgb_array', got None; make another")
        if self.simulation.running is not None:
            with self.simulation.guard() as api:
                self._picture = draw(api, self.WINDOW, self.controlled)
                speeds = [api.vehicle.getSpeed(car) for car in api.vehicle.getIDList()]
                mean = float(np.mean(speeds)) if speeds else float("nan")
                self.sight = Sight(float(api.simulation.getTime()), mean)
        if self._picture is None:
            raise InvalidInput("render() shows a simulation, got none so far; call reset()")
        return self._picture

    def _finish(self) -> None:
        """End the episode; another simulation of this process may have libsumo."""
        if self.render_mode is not None:
            self.render()  # the last picture: nothing is left to draw it from later
        self.close()

    def close(self) -> None:
        """End the simulation and remove its files."""
        self._left = 0
        self.simulation.close()


class TrafficEnv(Traffic, ContextualEnv):
    """Traffic with one decision maker: a Gymnasium environment."""


# Traffic with many decision makers: a PettingZoo parallel environment whose agents come and go


with needs("pettingzoo", "traffic"):
    from pettingzoo import ParallelEnv


class TrafficTeam(Traffic, ParallelEnv):  # type: ignore[misc]  # pettingzoo is untyped for our checker
    """Controlled cars that share one policy, so that spaces are the same for all.

    A car without an action drives by itself: `step({})` is traffic without control.

    Attributes:
        agents: controlled cars on the road.
        possible_agents: every car that can be controlled in this episode.
        most_agents: how many there can be at once.
        np_random: where every draw of an episode comes from.
    """

    most_agents: int

    def __init__(
        self, context: Mapping[str, Value] | None = None, **settings: Unpack[Settings]
    ) -> None:
        """Arguments as in `Traffic`."""
        super().__init__(context, **settings)
        self.agents: list[str] = []
        self.possible_agents: list[str] = []
        self._observation_space: Space[Any]
        self._action_space: Space[Any]
        self._seed(None)

    def observation_space(self, agent: str) -> Space[Any]:
        """The same for every agent."""
        return self._observation_space

    def action_space(self, agent: str) -> Space[Any]:
        """The same for every agent."""
        return self._action_space

    def drive(self) -> Any:
        """One decision in which nobody is told anything: the unguided baseline."""
        return self.step({})

    def _seed(self, seed: int | None) -> None:
        self.np_random: np.random.Generator = np_random(seed)[0]

    def close(self) -> None:
        """End the simulation and remove its files."""
        self.agents = []
        super().close()
