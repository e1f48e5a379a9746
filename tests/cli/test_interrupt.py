"""Ctrl-C while XLA computes: exit 1 and how to go on, not a crash of the interpreter."""

import os
import signal
import subprocess
import sys
import time

import pytest

pytest.importorskip("jax")


def test_an_interrupt_in_the_middle_of_a_jax_training_ends_with_1(tmp_path):
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
