"""Ctrl-C, or a batch system's SIGTERM: exit 1 and how to go on, soon, and nobody left behind."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest


def test_an_interrupt_in_the_middle_of_a_jax_training_ends_with_1(tmp_path):
    pytest.importorskip("jax")
    program = (
        "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "from mbtl.cli import program; program()"
    )
    command = ["run", "pendulum-length", "--preset", "paper", "--timesteps", "20000000"]
    log = tmp_path / "log"
    with log.open("w") as out:
        process = subprocess.Popen(
            [sys.executable, "-c", program, *command], cwd=tmp_path, stdout=out, stderr=out,
            env={**os.environ, "COLUMNS": "100"},
        )  # fmt: skip
        deadline = time.monotonic() + 300
        while not list(tmp_path.glob("runs/*/study.db")) and time.monotonic() < deadline:
            time.sleep(0.2)
        time.sleep(8.0)  # compiling or learning
        process.send_signal(signal.SIGINT)
        code = process.wait(timeout=300)
    assert code == 1, log.read_text()
    assert "run the same command again to go on" in log.read_text()


PROBLEM = """
import os, pathlib, time, mbtl
def train(context, seed):
    pathlib.Path(f'training-{os.getpid()}').touch()
    time.sleep(0 if context['x'] == 0.0 else 600)
    return context['x']
def evaluate(p, contexts, seed): return [1 - abs(c['x'] - p) for c in contexts]
space = mbtl.ContextSpace.grid({mbtl.Linear('x', 0, 1): 5})
problem = mbtl.CMDP.from_functions('slow', space, train=train, evaluate=evaluate, budget=3)
"""


@pytest.mark.parametrize(
    "command",
    [
        ("matrix", "build", "slow.py:problem", "--workers", "2", "--seeds", "1"),
        ("run", "slow.py:problem", "--parallel", "2"),
    ],
    ids=["matrix", "study"],
)
def test_a_terminated_program_ends_its_workers(tmp_path, command):
    (tmp_path / "slow.py").write_text(PROBLEM)
    log = tmp_path / "log"
    with log.open("w") as out:
        process = subprocess.Popen(
            [sys.executable, "-c", "from mbtl.cli import program; program()", *command],
            cwd=tmp_path, stdout=out, stderr=out, env={**os.environ, "COLUMNS": "100"},
        )  # fmt: skip
        deadline = time.monotonic() + 60
        while len(workers := list(tmp_path.glob("training-*"))) < 2 and time.monotonic() < deadline:
            time.sleep(0.1)
        time.sleep(1.0)
        process.send_signal(signal.SIGTERM)
        code = process.wait(timeout=30)
    assert code == 1, log.read_text()
    assert "run the same command again to go on" in log.read_text()
    assert "Traceback" not in log.read_text()
    assert len(workers) == 2
    for worker in workers:
        assert not Path("/proc", worker.name.removeprefix("training-")).exists()
