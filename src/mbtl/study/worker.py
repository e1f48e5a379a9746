"""Who holds a pick: a process on a host. A pick whose process is gone may be taken over."""

from __future__ import annotations

import os
import socket
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Worker:
    """A process, told apart from a later one that reuses its number by when it started."""

    host: str
    pid: int
    started: str

    def to_json(self) -> dict[str, Any]:
        """JSON-able record."""
        return asdict(self)

    @property
    def is_gone(self) -> bool:
        """True when the process surely does not run any more; another host's is never sure."""
        if self.host != socket.gethostname():
            return False
        try:
            os.kill(self.pid, 0)
        except ProcessLookupError:
            return True
        except PermissionError:
            return False
        return _start_time(self.pid) != self.started


def this_worker() -> Worker:
    """The calling process."""
    return _worker(os.getpid())


@lru_cache(maxsize=4)
def _worker(pid: int) -> Worker:  # keyed by pid, so that a forked child is another worker
    return Worker(socket.gethostname(), pid, _start_time(pid))


def _start_time(pid: int) -> str:
    """Start time in clock ticks where the system tells it, else empty; a zombie counts as gone."""
    try:
        stat = Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return ""
    fields = stat.rpartition(")")[2].split()
    return "gone" if fields[0] in "ZX" else fields[19]
