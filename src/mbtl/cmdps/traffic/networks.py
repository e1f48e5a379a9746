"""Road networks from plain XML that we write, compiled by netconvert and cached by content."""

from __future__ import annotations

import atexit
import functools
import os
import shutil
import subprocess
import tempfile
from collections.abc import Mapping
from pathlib import Path

from mbtl.cmdps.traffic.software import program
from mbtl.errors import SimulationFailed

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
