"""Where and with what a result was computed: for people who ask years later."""

from __future__ import annotations

import json
import platform
import subprocess
from collections.abc import Mapping
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import Any

from mbtl.errors import InvalidInput
from mbtl.processes import usable_cores
from mbtl.settings import first_difference
from mbtl.version import __version__, installed

_PACKAGES = (
    *("numpy", "jax", "jaxlib", "optax", "gymnasium", "stable-baselines3", "sb3-contrib", "torch"),
    *("eclipse-sumo", "libsumo"),
)


def here() -> dict[str, Any]:
    """JSON-able record of versions, commit, processor and day; no names of machines.

    The processor matters: the same seed trains another policy on another one, as sums are rounded
    differently there.
    """
    return {
        "mbtl": __version__,
        "commit": _commit(),
        "versions": {"python": platform.python_version(), **installed(*_PACKAGES)},
        "hardware": _hardware(),
        "processor": _processor(),
        "date": datetime.now(UTC).date().isoformat(),
    }


def check_made_by(file: Path, record: Mapping[str, Any], settings: Mapping[str, Any]) -> None:
    """Settings are not in the name of a file: what others made must not pass for ours.

    Args:
        file: for the message.
        record: its provenance.
        settings: JSON-able; all that its numbers depend on. Those not in the record, which may be
            older, are not compared.

    Raises:
        InvalidInput: they differ.
    """
    now = {k: v for k, v in json.loads(json.dumps(settings)).items() if k in record}
    difference = first_difference({k: record[k] for k in now}, now)
    if difference:
        name, was, got = difference
        raise InvalidInput(
            f"{file} was made by {record.get('command', 'another command')!r} with other settings: "
            f"{name} was {was!r}, got {got!r}; choose another --out, or remove it"
        )


def _hardware() -> str:
    return f"{platform.machine()}, {usable_cores()} cores"


@cache
def _processor() -> str:
    """Its model as the system tells it, e.g. "AMD EPYC, family 25, model 17, stepping 1"."""
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return platform.processor() or platform.machine()
    first = (line.partition(":") for line in text.partition("\n\n")[0].splitlines())
    facts = {name.strip(): value.strip() for name, _, value in first}
    known = [("model name", "{}"), ("cpu family", "family {}"), ("model", "model {}")]
    known.append(("stepping", "stepping {}"))
    said = [form.format(facts[name]) for name, form in known if name in facts]
    return ", ".join(said) or platform.processor() or platform.machine()


@cache
def _commit() -> str | None:
    """Of the working tree this package is imported from; None for an installed package."""
    root = Path(__file__).parents[4]
    if not (root / ".git").exists():
        return None
    git = ["git", "-C", str(root)]
    try:
        head = subprocess.run(
            [*git, "rev-parse", "--short=12", "HEAD"], capture_output=True, text=True, check=True
        ).stdout.strip()
        changed = subprocess.run(
            [*git, "status", "--porcelain", "--", "src", ":!src/mbtl/zoo/benchmark/data"],
            capture_output=True,
            text=True,
            check=True,
        ).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return None
    return f"{head}, with changes" if changed else head
