"""One SUMO simulation: libsumo inside this process where that is free, else a process of its own.

libsumo is fast but holds one simulation per process. The first simulation that runs gets it; one
that starts while another is still running goes through TraCI to a SUMO process of its own, with the
same results and at a fraction of the speed. So worker processes, not threads, make traffic fast.
"""

from __future__ import annotations

import contextlib
import itertools
import logging
import os
import shutil
import subprocess
import tempfile
import weakref
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import Any, Literal

from mbtl.cmdps.traffic.software import check_version, library, program, why_not
from mbtl.envs.opening import shared_well
from mbtl.errors import InvalidInput, MbtlError, SimulationFailed, unknown_name

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
