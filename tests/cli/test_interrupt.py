"""Ctrl-C, or a batch system's SIGTERM: exit 130 and how to go on, soon, and nobody left behind."""

import gc
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from mbtl.cli.common import interrupts
from mbtl.cli.interrupts import keep_interrupts

HANGING = 1200.0
"""Seconds after which nothing more is going to happen, on the slowest machine."""

PROGRAM = """
import signal
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)
from mbtl.cli import program; program()
"""
"""Whoever runs the tests in the background, or under nohup, has them inherit deaf ears."""


def begun(arguments, **how):
    """The program in a process of its own; errors go where its output goes."""
    command, environment = [sys.executable, "-c", PROGRAM], {**os.environ, "COLUMNS": "100"}
    command += map(str, arguments)
    return subprocess.Popen(command, stderr=subprocess.STDOUT, env=environment, **how)


def test_an_interrupt_in_the_middle_of_a_jax_training_ends_with_130(tmp_path):
    pytest.importorskip("jax")
    command = ["run", "pendulum-length", "--preset", "full", "--timesteps", "20000000"]
    log = tmp_path / "log"
    with log.open("w") as out:
        process = begun(command, cwd=tmp_path, stdout=out)
        wait_until(lambda: list(tmp_path.glob("runs/*/study.db")), process)
        time.sleep(1.0)  # compiling or learning
        process.send_signal(signal.SIGINT)
        code = process.wait(timeout=HANGING)
    assert code == 130, log.read_text()
    assert "run the same command again to go on" in log.read_text()


PROBLEM = """
import os, pathlib, subprocess, tempfile, time, mbtl
mbtl.processes.GRACE = 1.0  # in the workers, which wait for nothing that takes longer
def train(context, seed):
    if context['x'] > 0.0:
        with tempfile.TemporaryDirectory(dir='.', prefix='scratch-'):
            simulator = subprocess.Popen(['sleep', '6000'])
            pathlib.Path(f'process-{os.getpid()}').touch()
            pathlib.Path(f'process-{simulator.pid}').touch()
            time.sleep(6000)
    return context['x']
def evaluate(p, contexts, seeds): return [1 - abs(c['x'] - p) for c in contexts]
space = mbtl.ContextSpace.grid({mbtl.Linear('x', 0, 1): 5})
problem = mbtl.CMDP.from_functions('slow', space, train=train, evaluate=evaluate, budget=3)
"""
MATRIX = ("matrix", "build", "slow.py:problem", "--workers", "2", "--seeds", "1")
STUDY = ("run", "slow.py:problem", "--parallel", "2")


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks into /proc")
@pytest.mark.parametrize(
    ("command", "number"),
    [
        (MATRIX, signal.SIGTERM),
        (STUDY, signal.SIGKILL),
        pytest.param(MATRIX, signal.SIGHUP, marks=pytest.mark.long),
        pytest.param(MATRIX, signal.SIGKILL, marks=pytest.mark.long),
        pytest.param(STUDY, signal.SIGTERM, marks=pytest.mark.long),
        pytest.param(STUDY, signal.SIGHUP, marks=pytest.mark.long),
    ],
)
def test_workers_and_their_simulators_end_with_their_master(tmp_path, command, number):
    (tmp_path / "slow.py").write_text(PROBLEM)
    log = tmp_path / "log"
    with log.open("w") as out:
        master = begun(command, cwd=tmp_path, stdout=out)
        least = 4 if "build" in command else 2  # the study's other pick may be the quick one
        wait_until(lambda: len(list(tmp_path.glob("process-*"))) >= least, master)
        time.sleep(0.1)
        master.send_signal(number)
        code = master.wait(timeout=HANGING)
    started = [int(path.name.removeprefix("process-")) for path in tmp_path.glob("process-*")]
    if number == signal.SIGKILL:  # they notice themselves
        wait_until(lambda: not any(map(is_running, started)))
    assert not any(map(is_running, started))
    assert len(started) >= least
    if number != signal.SIGKILL:
        assert code == 130, log.read_text()
        assert "run the same command again to go on" in log.read_text()
        assert "Traceback" not in log.read_text()
    assert not list(tmp_path.glob("scratch-*"))


def wait_until(happened, program=None, limit=HANGING):
    began = time.monotonic()
    while not happened():
        assert time.monotonic() - began < limit
        assert program is None or program.poll() is None
        time.sleep(0.1)


def is_running(pid):
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state not in "ZX"


# ---- within the program ---


@pytest.fixture
def kept(monkeypatch):
    """As in the program: our hook and Python's own handler, for this test."""
    monkeypatch.setattr(sys, "unraisablehook", sys.__unraisablehook__)
    interrupts.clear()  # of tests before this one
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    keep_interrupts()
    yield
    signal.signal(signal.SIGINT, before)


def test_an_interrupt_in_a_callback_of_the_garbage_collector_comes_again(kept):
    """jax registers such a callback; Python drops whatever is raised inside."""
    fell = []

    def callback(phase, info):
        if not fell:
            fell.append(phase)
            raise KeyboardInterrupt

    gc.callbacks.append(callback)
    try:
        with pytest.raises(KeyboardInterrupt):  # noqa: PT012  the second line is where it comes
            gc.collect()
            threading.Event().wait(60)
    finally:
        gc.callbacks.remove(callback)
    assert fell


def test_other_errors_there_are_shown_as_ever(kept, capsys):
    class Careless:
        def __del__(self):
            raise ValueError("in a destructor")

    Careless()
    gc.collect()
    assert "ValueError: in a destructor" in capsys.readouterr().err
