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

from mbtl.envs.opening import shared_well
from mbtl.errors import InvalidInput, MbtlError, SimulationFailed, check_known
from mbtl.sumo.installed import check_version, library, program, why_not

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
        self, options: Sequence[str], *, engine: Engine = "auto", gui: bool = False
    ) -> None:
        """Nothing is started yet.

        Args:
            options: arguments of sumo: its network, and all that `start` does not set.
            engine: "auto": libsumo where it is free, else TraCI.
            gui: show it in sumo-gui, which needs TraCI and a screen.

        Raises:
            UnknownName: another engine.
            InvalidInput: sumo-gui through libsumo, or without a screen.
        """
        check_known("engine", engine, ENGINES)
        if gui and engine == "libsumo":
            raise InvalidInput("sumo-gui is driven through TraCI, got engine='libsumo'; use 'auto'")
        if gui and os.name == "posix" and not _has_screen():
            raise InvalidInput("sumo-gui needs a screen and this machine has none; use gui=False")
        self.api: Any = None
        self.running: Literal["libsumo", "traci"] | None = None
        self._options, self._engine, self._gui = tuple(options), engine, gui
        self._pid = os.getpid()
        self._folder: Path | None = None
        self._remove: Callable[[], object] = _nothing

    # ---- life --------------------------------------------------------------------------------

    def start(self, routes: str | None, seed: int) -> None:
        """Start from the beginning; what ran before is ended.

        Args:
            routes: XML text of vehicle types, routes and vehicles; None: the options name files.
            seed: of SUMO's own random numbers, >= 0.

        Raises:
            MissingExtra: SUMO is missing or too old.
            SimulationFailed: SUMO refuses its input, or libsumo was asked for and is busy.
        """
        self.close()
        self._pid = os.getpid()
        self._folder = Path(tempfile.mkdtemp(prefix="mbtl-sumo-"))
        self._remove = weakref.finalize(self, shutil.rmtree, self._folder, True)
        arguments = self._arguments(self._folder, routes, seed)
        engine = self._choose()
        with self.guard():
            begin = self._start_libsumo if engine == "libsumo" else self._start_traci
            version = begin(arguments)
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

    def __getstate__(self) -> object:
        """There are no copies: one would name the same simulation, and end it."""
        raise TypeError("a simulation lives in one process and cannot be copied or pickled")

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

    def _start_libsumo(self, arguments: Sequence[str]) -> str:
        global _holder
        libsumo = library("libsumo")
        _holder = weakref.ref(self)
        self.api, self.running = libsumo, "libsumo"
        return str(libsumo.start(["sumo", *arguments])[1])

    def _start_traci(self, arguments: Sequence[str]) -> str:
        traci = library("traci")
        name = "sumo-gui" if self._gui else "sumo"
        command = [program(name), *arguments, *(["--start"] if self._gui else [])]
        label = f"mbtl-{os.getpid()}-{next(_labels)}"
        with contextlib.redirect_stdout(None):  # it reports every attempt to connect
            version = traci.start(command, label=label, stdout=subprocess.DEVNULL)[1]
        self.api, self.running = traci.getConnection(label), "traci"
        return str(version)

    def _arguments(self, folder: Path, routes: str | None, seed: int) -> list[str]:
        cars = []
        if routes is not None:
            (folder / "routes.xml").write_text(routes, encoding="utf-8")
            cars = ["--route-files", str(folder / "routes.xml")]
        return [
            *("--error-log", str(folder / "errors.txt"), "--seed", str(seed)),
            *("--no-step-log", "true", "--no-warnings", "true", "--xml-validation", "never"),
            *("--duration-log.disable", "true", *cars, *self._options),
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
