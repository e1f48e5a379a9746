"""Which SUMO is installed, where its programs are, and networks that they compile.

The package eclipse-sumo is preferred; a SUMO that the machine has otherwise ($SUMO_HOME or the
search path) serves where it is missing.
"""

from __future__ import annotations

import atexit
import contextlib
import functools
import importlib
import importlib.metadata
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from mbtl.errors import MissingExtra, SimulationFailed, missing_extra

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
