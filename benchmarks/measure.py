"""What the benchmarks share: one thread, clocks, the machine, and one way to print.

Import this before numpy: thread counts are read when the numerical libraries are loaded.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import resource
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from typing import Any

assert "numpy" not in sys.modules, "import measure before numpy, else it runs on all cores"
for _library in ("OMP", "OPENBLAS", "MKL", "VECLIB_MAXIMUM", "NUMEXPR"):
    os.environ[f"{_library}_NUM_THREADS"] = "1"


@dataclass(frozen=True)
class Cost:
    """What some work took on one thread.

    Attributes:
        wall: seconds on the clock; other processes on the machine inflate it.
        cpu: seconds of processor time of this process; ratios are of this one.
    """

    wall: float = 0.0
    cpu: float = 0.0

    def __add__(self, other: Cost) -> Cost:
        return Cost(self.wall + other.wall, self.cpu + other.cpu)

    def __sub__(self, other: Cost) -> Cost:
        return Cost(self.wall - other.wall, self.cpu - other.cpu)

    def __truediv__(self, count: float) -> Cost:
        return Cost(self.wall / count, self.cpu / count)

    def to_json(self, unit: float = 1.0) -> dict[str, float]:
        """Both clocks, in units of `unit` seconds, to four digits."""
        return {"wall": digits(self.wall / unit), "cpu": digits(self.cpu / unit)}


class Stopwatch:
    """Adds up the cost of named parts."""

    def __init__(self) -> None:
        self.parts: dict[str, Cost] = {}

    @contextmanager
    def of(self, part: str) -> Iterator[None]:
        """Charge what runs inside to `part`."""
        start = now()
        yield
        self.parts[part] = self.parts.get(part, Cost()) + (now() - start)


def now() -> Cost:
    """Both clocks; differences are costs."""
    return Cost(time.perf_counter(), time.process_time())


def cost_of(work: Callable[[], Any]) -> Cost:
    """Cost of one call."""
    start = now()
    work()
    return now() - start


def mean(costs: Iterable[Cost]) -> Cost:
    """Mean of each clock."""
    every = list(costs)
    return sum(every, Cost()) / len(every)


def median(costs: Iterable[Cost]) -> Cost:
    """Median of each clock (the upper one of an even number)."""
    every = list(costs)
    middle = len(every) // 2
    return Cost(sorted(c.wall for c in every)[middle], sorted(c.cpu for c in every)[middle])


def digits(value: float, n: int = 4) -> float:
    """The value to `n` significant digits."""
    return float(f"{value:.{n}g}")


def peak_gib() -> float:
    """Largest resident memory of this process so far, GiB."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (2**30 if sys.platform == "darwin" else 2**20)  # bytes there, KiB elsewhere


def parser(doc: str | None) -> argparse.ArgumentParser:
    """Arguments of a benchmark: its docstring as help, and --json."""
    made = argparse.ArgumentParser(
        description=doc, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    made.add_argument(
        "--json", action="store_true", help="print one JSON document on standard output"
    )
    return made


def machine(*packages: str) -> dict[str, Any]:
    """Processor, load and versions: what a figure needs beside it."""
    from mbtl.processes import usable_cores  # here: numpy reads the number of threads above

    return {
        "processor": _processor(),
        "cores": usable_cores(),
        "load": [digits(x, 3) for x in os.getloadavg()],
        "python": platform.python_version(),
        **{name: _version(name) for name in ("mbtl", "numpy", "scipy", *packages)},
    }


def show(document: dict[str, Any], lines: Sequence[str], *, as_json: bool) -> None:
    """Print the document, or the lines that were made from it."""
    if as_json:
        print(json.dumps(document, indent=2, allow_nan=False))
        return
    print("\n".join(lines))
    print("; ".join(f"{key} {value}" for key, value in document["machine"].items()))


def note(text: str) -> None:
    """Progress, on standard error."""
    print(text, file=sys.stderr, flush=True)


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def _processor() -> str:
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as lines:
            names = [line.split(":", 1)[1].strip() for line in lines if "model name" in line]
    except OSError:
        names = []
    return names[0] if names else platform.processor()
