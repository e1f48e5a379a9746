"""What this process may use, on systems that say and on those that do not."""

import os
from pathlib import Path

import mbtl
from mbtl.processes import usable_cores


def test_cores_are_counted_where_the_system_does_not_say_which_are_ours(monkeypatch):
    assert 1 <= usable_cores() <= os.cpu_count()
    monkeypatch.delattr(os, "sched_getaffinity", raising=False)
    monkeypatch.setattr(os, "cpu_count", lambda: 5)
    assert usable_cores() == 5
    monkeypatch.setattr(os, "cpu_count", lambda: None)
    assert usable_cores() == 1


def test_nobody_else_asks_the_system():
    sources = Path(mbtl.__file__).parent.rglob("*.py")
    asking = [path.name for path in sources if "sched_getaffinity" in path.read_text()]
    assert asking == ["processes.py"]
