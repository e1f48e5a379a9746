"""One SUMO simulation: libsumo inside this process where that is free, else a process of its own.

libsumo is fast but holds one simulation per process. The first simulation that runs gets it; one
that starts while another is still running goes through TraCI to a SUMO process of its own, with the
same results and at a fraction of the speed. So worker processes, not threads, make traffic fast.
"""

from __future__ import annotations

import atexit
import contextlib
import functools
import importlib
import importlib.metadata
import itertools
import logging
import os
import re
import shutil
import subprocess
import sys
import tempfile
import weakref
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any, ClassVar, Literal, NamedTuple, Unpack

import numpy as np
from gymnasium.spaces import Space
from gymnasium.utils.seeding import np_random

from mbtl.contexts import Value
from mbtl.envs.opening import shared_well
from mbtl.errors import (
    InvalidInput,
    MbtlError,
    MissingExtra,
    SimulationFailed,
    missing_extra,
    unknown_name,
)
from mbtl.zoo.cmdps import contextual
from mbtl.zoo.cmdps.contextual import Contextual, ContextualEnv, TimeLimit, Visibility
from mbtl.zoo.cmdps.drawing import Image, Window
from mbtl.zoo.cmdps.traffic.drawing import CARS, CONTROLLED, Legend, draw

# ---- which SUMO is installed, and where its programs are -------------------------------------
#
# The package eclipse-sumo is preferred; a SUMO that the machine has otherwise ($SUMO_HOME or the
# search path) serves where it is missing.


OLDEST = (1, 20)
"""Oldest SUMO whose interface we use."""


def program(name: str) -> str:
    """Path of one of SUMO's programs, e.g. "netconvert".

    Raises:
        MissingExtra: it is nowhere.
    """
    package = find_spec("sumo")
    homes = list(package.submodule_search_locations or ()) if package else []
    homes += [os.environ["SUMO_HOME"]] if os.environ.get("SUMO_HOME") else []
    for home in homes:
        found = shutil.which(name, path=str(Path(home) / "bin"))
        if found:
            return found
    found = shutil.which(name)
    if found is None:
        raise missing_extra("eclipse-sumo", "traffic")
    return found


def library(name: str) -> Any:
    """The module "libsumo" or "traci".

    Raises:
        MissingExtra: it is not installed, or the machine lacks a library that it needs.
    """
    # of traci the part that talks to another process, also where LIBSUMO_AS_TRACI has made it
    # libsumo; what it then prints belongs to nobody's standard output
    module = "traci.main" if name == "traci" else name
    try:
        with contextlib.redirect_stdout(None), _installed_first(name):
            return importlib.import_module(module)
    except ModuleNotFoundError as error:
        raise missing_extra(name, "traffic") from error
    except ImportError as error:
        raise MissingExtra(
            f"{name} is installed but must be loadable, got: {error}; install what it names"
        ) from error


@contextlib.contextmanager
def _installed_first(name: str) -> Iterator[None]:
    """In the block the installed package is found before another SUMO's on PYTHONPATH."""
    before = list(sys.path)
    with contextlib.suppress(importlib.metadata.PackageNotFoundError):
        sys.path.insert(0, str(importlib.metadata.distribution(name).locate_file("")))
    try:
        yield
    finally:
        sys.path[:] = before


def why_not(name: str) -> MissingExtra | None:
    """The error that `library` would raise; None: it gives the module."""
    try:
        library(name)
    except MissingExtra as error:
        return error
    return None


def check_version(version: str) -> None:
    """Refuse a SUMO that is too old.

    Args:
        version: as SUMO gives it, e.g. "SUMO 1.28.0".

    Raises:
        MissingExtra: it is older than `OLDEST`.
    """
    numbers = re.search(r"(\d+)[._](\d+)", version)
    if numbers and (int(numbers[1]), int(numbers[2])) < OLDEST:
        raise MissingExtra(
            f"traffic needs SUMO {OLDEST[0]}.{OLDEST[1]} or newer, got {version!r}; run: "
            "pip install --upgrade eclipse-sumo libsumo traci"
        )


# Road networks from plain XML that we write, compiled by netconvert and cached by content


_FLAGS = {"nodes": "-n", "edges": "-e", "connections": "-x", "lights": "-i"}


def network(plain: Mapping[str, str], *options: str) -> Path:
    """Compile a network; the same text gives the same file for the life of the process.

    Args:
        plain: XML text by kind: "nodes", "edges", and where needed "connections", "lights".
        *options: further arguments of netconvert.

    Returns:
        Path of the compiled network in a temporary folder that goes with the process.

    Raises:
        MissingExtra: netconvert is not installed.
        SimulationFailed: netconvert refuses the text.
    """
    return _compiled(os.getpid(), tuple(plain.items()), options)


@functools.cache
def _compiled(pid: int, plain: tuple[tuple[str, str], ...], options: tuple[str, ...]) -> Path:
    folder = Path(tempfile.mkdtemp(dir=_folder(pid)))
    arguments = []
    for kind, text in plain:
        (folder / kind).write_text(text, encoding="utf-8")
        arguments += [_FLAGS[kind], kind]
    command = [program("netconvert"), *arguments, "-o", "network.net.xml", *options]
    command += ["--offset.disable-normalization", "--no-turnarounds"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SimulationFailed(f"netconvert refuses the network: {done.stderr.strip()}")
    return folder / "network.net.xml"


@functools.cache
def _folder(pid: int) -> str:
    folder = tempfile.mkdtemp(prefix="mbtl-networks-")

    def remove() -> None:
        if os.getpid() == pid:  # a forked child must not take its parent's networks away
            shutil.rmtree(folder, ignore_errors=True)

    atexit.register(remove)
    return folder


# ---- the whole -------------------------------------------------------------------------------


Engine = Literal["auto", "libsumo", "traci"]
ENGINES: tuple[Engine, ...] = ("auto", "libsumo", "traci")


def _is_held() -> bool:
    """Whether one of us runs in this process's libsumo: the next one does without."""
    other = _holder() if _holder is not None else None
    return other is not None and other.running == "libsumo" and other._pid == os.getpid()


shared_well["libsumo"] = _is_held

_logger = logging.getLogger(__name__)
_labels = itertools.count()
_holder: weakref.ref[Simulation] | None = None
"""Who runs in this process's libsumo; a forked child inherits the note but not the simulation."""


class Simulation:
    """A SUMO simulation that can be started again and again, each time with a seed.

    Attributes:
        api: libsumo, or a TraCI connection; both offer the same domains. Calls belong into `guard`.
        running: which engine runs it now; None: it is not running.
    """

    def __init__(
        self,
        network: Path,
        *,
        step_length: float,
        options: Sequence[str] = (),
        engine: Engine = "auto",
        gui: bool = False,
    ) -> None:
        """Nothing is started yet.

        Args:
            network: compiled network.
            step_length: seconds of one simulation step.
            options: further arguments of sumo.
            engine: "auto": libsumo where it is free, else TraCI.
            gui: show it in sumo-gui, which needs TraCI and a screen.

        Raises:
            UnknownName: another engine.
            InvalidInput: sumo-gui through libsumo, or without a screen.
        """
        if engine not in ENGINES:
            raise unknown_name("engine", engine, ENGINES)
        if gui and engine == "libsumo":
            raise InvalidInput("sumo-gui is driven through TraCI, got engine='libsumo'; use 'auto'")
        if gui and os.name == "posix" and not _has_screen():
            raise InvalidInput("sumo-gui needs a screen and this machine has none; use gui=False")
        self.api: Any = None
        self.running: Literal["libsumo", "traci"] | None = None
        self._network, self._options = network, tuple(options)
        self._step_length, self._engine, self._gui = step_length, engine, gui
        self._pid = os.getpid()
        self._folder: Path | None = None
        self._remove: Callable[[], object] = _nothing

    # ---- life --------------------------------------------------------------------------------

    def start(self, routes: str, seed: int) -> None:
        """Start from time 0; what ran before is ended.

        Args:
            routes: XML text of vehicle types, routes and vehicles.
            seed: of SUMO's own random numbers, >= 0.

        Raises:
            MissingExtra: SUMO is missing or too old.
            SimulationFailed: SUMO refuses its input, or libsumo was asked for and is busy.
        """
        self.close()
        self._pid = os.getpid()
        self._folder = Path(tempfile.mkdtemp(prefix="mbtl-sumo-"))
        self._remove = weakref.finalize(self, shutil.rmtree, self._folder, True)
        (self._folder / "routes.xml").write_text(routes, encoding="utf-8")
        engine = self._choose()
        with self.guard():
            version = self._start_libsumo(seed) if engine == "libsumo" else self._start_traci(seed)
        try:
            check_version(version)
        except MbtlError:
            self.close()
            raise

    def close(self) -> None:
        """End the simulation and remove its files; harmless where none runs."""
        global _holder
        api, running = self.api, self.running
        self.api, self.running = None, None
        if running is not None and self._pid == os.getpid():
            with contextlib.suppress(Exception):  # a simulator that is gone cannot say goodbye
                api.close()
            if running == "libsumo":
                _holder = None
        if self._pid == os.getpid():
            self._remove()
        self._folder, self._remove = None, _nothing

    def __del__(self) -> None:
        """A forgotten simulation must not keep libsumo from the next one."""
        with contextlib.suppress(Exception):
            self.close()

    @contextlib.contextmanager
    def guard(self) -> Iterator[Any]:
        """Calls of `api`: what goes wrong in the simulator becomes one error, and ends it.

        Raises:
            SimulationFailed: an error inside SUMO, or its process is gone.
        """
        if self.running is not None and self._pid != os.getpid():
            raise InvalidInput("a simulation belongs to one process, got another; call reset()")
        try:
            yield self.api
        except MbtlError:
            raise
        except Exception as error:
            if not _from_sumo(error):
                raise
            report = self._report()
            self.close()
            what = " ".join(filter(None, (str(error).strip(), report))) or type(error).__name__
            raise SimulationFailed(f"the simulation has stopped: {what}; call reset()") from error

    # ---- inside ------------------------------------------------------------------------------

    def _choose(self) -> Engine:
        if self._gui or self._engine == "traci":
            return "traci"
        busy = _is_held()
        if self._engine == "libsumo":
            if busy:
                raise SimulationFailed(
                    "libsumo holds one simulation per process and one is running; end its episode, "
                    "use another process, or engine='auto'"
                )
            return "libsumo"
        if busy:
            return "traci"
        missing = why_not("libsumo")
        if missing is None:
            return "libsumo"
        if why_not("traci") is not None:
            raise missing
        _tell_once(f"TraCI serves instead of libsumo, slower: {missing}")
        return "traci"

    def _start_libsumo(self, seed: int) -> str:
        global _holder
        libsumo = library("libsumo")
        _holder = weakref.ref(self)
        self.api, self.running = libsumo, "libsumo"
        return str(libsumo.start(["sumo", *self._arguments(seed)])[1])

    def _start_traci(self, seed: int) -> str:
        traci = library("traci")
        name = "sumo-gui" if self._gui else "sumo"
        command = [program(name), *self._arguments(seed), *(["--start"] if self._gui else [])]
        label = f"mbtl-{os.getpid()}-{next(_labels)}"
        with contextlib.redirect_stdout(None):  # it reports every attempt to connect
            version = traci.start(command, label=label, stdout=subprocess.DEVNULL)[1]
        self.api, self.running = traci.getConnection(label), "traci"
        return str(version)

    def _arguments(self, seed: int) -> list[str]:
        assert self._folder is not None
        folder = self._folder
        return [
            *("--net-file", str(self._network), "--route-files", str(folder / "routes.xml")),
            *("--error-log", str(folder / "errors.txt"), "--seed", str(seed)),
            *("--step-length", f"{self._step_length:g}", "--time-to-teleport", "-1"),
            *("--no-step-log", "true", "--no-warnings", "true", "--xml-validation", "never"),
            *("--duration-log.disable", "true", *self._options),
        ]

    def _report(self) -> str:
        """What SUMO itself wrote about its failure."""
        if self._folder is None:
            return ""
        log = self._folder / "errors.txt"
        return " ".join(log.read_text(encoding="utf-8").split()) if log.exists() else ""


def _from_sumo(error: Exception) -> bool:
    module = type(error).__module__.partition(".")[0]
    return module in ("libsumo", "traci") or isinstance(error, OSError)


def _has_screen() -> bool:
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


@cache
def _tell_once(message: str) -> None:
    _logger.warning(message)


def _nothing() -> None:
    """No files to remove."""


# What the traffic environments share: an episode is a simulation, its score is not its return
#
# The return is the sum of the rewards that a policy is trained on. The score is the matrix entry
# (cmdp-spec, 5-7), `info["score"]` of an episode's last step; larger is better.
#
# `Traffic` knows no interface: `TrafficEnv` here makes it a Gymnasium environment, `TrafficTeam` in
# `team` a PettingZoo one.


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
            context,
            unit=unit,
            visibility=visibility,
            time_limit=time_limit,
            horizon=horizon,
        )
        self.render_mode = render_mode
        self._picture: Image | None = None
        self.sight: Sight | None = None
        self.simulation = Simulation(
            self._network(),
            step_length=self.STEP,
            options=self._options(),
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

    def _ends(self, out_of_time: bool) -> tuple[bool, bool]:
        """(terminated, truncated) as far as time decides."""
        return out_of_time and self._terminal, out_of_time and not self._terminal

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


try:
    from pettingzoo import ParallelEnv
except ModuleNotFoundError as error:
    raise missing_extra("pettingzoo", "traffic") from error


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
