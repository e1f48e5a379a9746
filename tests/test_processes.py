"""What this process may use, on systems that say and on those that do not."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

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


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="children are found in /proc")
def test_what_a_library_left_behind_is_ended_though_it_would_not():
    """As SUMO does, which is interrupted before it is connected to."""
    deaf = "import signal; signal.signal(signal.SIGTERM, signal.SIG_IGN); print(1, flush=True)\n"
    code = (
        "import subprocess, sys\n"
        "from mbtl import processes\n"
        "processes._MOMENT = 0.2\n"
        f"child = subprocess.Popen([sys.executable, '-c', {deaf + 'input()'!r}],\n"
        "                         stdin=subprocess.PIPE, stdout=subprocess.PIPE)\n"
        "child.stdout.readline()\n"
        "processes.end_children()\n"
        "print(child.wait())\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "-9\n"


def test_a_script_without_a_guard_is_told_so_before_anything_is_asked(tmp_path):
    """Each worker runs the whole script, which would start workers of its own."""
    (tmp_path / "script.py").write_text(
        "import mbtl\n"
        "def train(context, seed): return 0.0\n"
        "def evaluate(policy, contexts, seeds): return [0.0] * len(contexts)\n"
        "space = mbtl.ContextSpace.grid({mbtl.Linear('x', 0, 1): 5})\n"
        "problem = mbtl.CMDP.from_functions('p', space, train=train, evaluate=evaluate)\n"
        "study = mbtl.create_study(problem, budget=3, storage='study.db', load_if_exists=True)\n"
        "study.run(workers=mbtl.Workers(2))\n"
    )
    command = [sys.executable, "script.py"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 1
    assert "InvalidInput: a worker process ended as it began; a script that" in done.stderr
    assert not mbtl.load_study(tmp_path / "study.db", strategy="auto").state.picks
