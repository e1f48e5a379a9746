"""A sample of benchmarks/kills.py: processes and servers are killed in the midst of real runs."""

import subprocess
import sys
from pathlib import Path

import pytest
from postgres import missing

PROGRAM = Path(__file__).parents[2] / "benchmarks" / "kills.py"


@pytest.mark.parametrize("database", ["sqlite", pytest.param("postgresql", marks=pytest.mark.long)])
def test_kills_lose_nothing_tell_nothing_twice_and_every_study_ends(database):
    if database == "postgresql" and (reason := missing()):
        pytest.skip(reason)
    done = subprocess.run(
        [sys.executable, PROGRAM, "--kills", "3", "--databases", database],
        capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    assert "3 kills" in done.stdout
    assert "rows lost 0, told twice 0" in done.stdout
