"""Kill -9 at random points of real runs: nothing told is lost, and the picks are the same."""

import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

import mbtl

PROGRAM = Path(__file__).parent / "quick_problem.py"


def start(folder):
    env = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    return subprocess.Popen(
        [sys.executable, PROGRAM, folder], stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=env
    )


def told_so_far(folder):
    if not (folder / "study.db").exists():
        return []
    try:
        state = mbtl.load_study(folder).state
    except mbtl.MbtlError:  # killed before the study was created
        return []
    return [(row.source, row.returns.tolist()) for row in state.rows]


@pytest.mark.parametrize("least", [3, pytest.param(50, marks=pytest.mark.long)])
def test_killed_at_any_moment_a_study_ends_as_if_undisturbed(tmp_path, least):
    began = time.monotonic()
    undisturbed = start(tmp_path / "calm")
    out, err = undisturbed.communicate()
    assert undisturbed.returncode == 0, err.decode()
    expected = json.loads(out)
    longest = time.monotonic() - began
    assert expected["finished"]
    assert len(expected["told"]) == 6

    rng = random.Random(0)
    kills, runs, interrupted_after = 0, 0, set()
    while kills < least:
        folder = tmp_path / f"run-{runs}"
        runs += 1
        while True:
            process, started = start(folder), time.monotonic()
            try:
                process.wait(timeout=rng.uniform(0.0, 1.1) * longest)
            except subprocess.TimeoutExpired:
                before = told_so_far(folder)
                process.send_signal(signal.SIGKILL)
                process.communicate()
                kills += 1
                after = told_so_far(folder)
                assert after[: len(before)] == before  # nothing told was lost
                interrupted_after.add(len(after))
                continue
            out, err = process.communicate()
            assert process.returncode == 0, err.decode()
            longest = max(longest, time.monotonic() - started)  # the machine may have got slower
            assert json.loads(out) == expected
            break
    assert least < 50 or len(interrupted_after) >= 3  # the kills hit different stages
