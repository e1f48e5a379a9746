"""Several step workers on a real PostgreSQL server, one of which is killed in a training."""

import collections
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from postgres import Server, missing

import mbtl

PROBLEM = """
import os, sys, time
sys.path.insert(0, {folder!r})
import mbtl
from step_problem import HORIZON, SPACE, Slow

class Seen(Slow):
    '''Writes down, outside of the study, every unit of training that is really run.'''

    def on_one(self, context, seed, steps, *, start=None, state=None, on_progress=None):
        def told(progress):
            with open("units", "a") as out:
                out.write(f"{{context['x']}} {{progress.step}} {{os.getpid()}}\\n")
            time.sleep(0.03)
            on_progress(progress)

        return super().on_one(context, seed, steps, start=start, state=state, on_progress=told)

problem = mbtl.CMDP("slow", SPACE, Seen(), bounds=(0.0, 1.0), horizon=HORIZON)
"""
PROGRAM = "from mbtl.cli import program; program()"
BUDGET, UNIT, FIRST_MARK = 200_000, 1_000, 8_000


@pytest.fixture(scope="module")
def server():
    """An empty server of these tests."""
    if reason := missing():
        pytest.skip(reason)
    with Server() as started:
        yield started


def begun(place, *arguments):
    return subprocess.Popen(
        [sys.executable, "-c", PROGRAM, *map(str, arguments)],
        cwd=place, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


def units(place):
    """(context, steps, process) of every unit of training, in order."""
    text = (place / "units").read_text() if (place / "units").exists() else ""
    lines = [line.split() for line in text.splitlines()]
    return [(float(x), int(steps), int(pid)) for x, steps, pid in lines]


def in_the_middle_of_one(place, pid):
    """Wait until a process is between two marks of a training, beyond its first one."""
    until = time.monotonic() + 60.0
    while time.monotonic() < until:
        mine = [steps for _, steps, who in units(place) if who == pid]
        if mine and mine[-1] > FIRST_MARK and mine[-1] % FIRST_MARK in (2_000, 3_000, 4_000):
            return
        time.sleep(0.002)
    raise AssertionError("it trains nothing")


@pytest.mark.parametrize("strategy", ["fixed", "pilot"])
def test_a_killed_worker_costs_a_study_nothing_but_its_piece(server, tmp_path, strategy):
    folder = Path(__file__).parent
    (tmp_path / "own.py").write_text(PROBLEM.format(folder=str(folder)))
    master = begun(
        tmp_path, "run", "own.py:problem", "--steps", BUDGET, "--strategy", strategy,
        "--workers", server.url, "--study", strategy, "--json",
    )  # fmt: skip
    command = next(line for line in master.stderr if "mbtl worker" in line).split()[1:]
    workers = [begun(tmp_path, *command, "--lease", "1") for _ in range(2)]
    in_the_middle_of_one(tmp_path, workers[0].pid)
    os.kill(workers[0].pid, signal.SIGKILL)
    workers[0].communicate()
    assert workers[0].returncode == -signal.SIGKILL
    _, err = workers[1].communicate(timeout=120)
    assert workers[1].returncode == 0, err
    out, err = master.communicate(timeout=120)
    assert master.returncode == 0, err
    summary = json.loads(out)
    assert summary["finished"] == f"the budget of {BUDGET:,} steps is spent"
    assert summary["fresh_value"] > 0.7

    study = mbtl.StepStudy.load(server.url, strategy, artifacts=tmp_path / strategy)
    state, events = study.state, list(study.events())
    assert state.spent == summary["spent"] <= BUDGET
    assert not state.under_way
    assert [e.kind for e in events].count("claimed") == 1  # what the dead one was at

    # every unit is paid once, and only what the dead one had begun was run twice
    ran = collections.Counter((x, steps) for x, steps, _ in units(tmp_path))
    paid = state.prices.training + state.prices.extension
    assert len(ran) * UNIT == paid == sum(t.steps for t in state.trainings)
    twice = {unit for unit, count in ran.items() if count > 1}
    last = [(x, steps) for x, steps, pid in units(tmp_path) if pid == workers[0].pid][-1]
    assert last in twice
    assert {x for x, _ in twice} == {last[0]}
    assert max(ran.values()) == 2
    assert len(twice) < FIRST_MARK * 4 / UNIT  # not its marks before

    # nothing is evaluated twice, and every policy that was told is there
    evaluated = [e.data for e in events if e.kind == "evaluated"]
    pairs = [(e["training"], e["length"], target) for e in evaluated for target in e["targets"]]
    assert len(set(pairs)) == len(pairs)
    for course in state.trainings:
        for mark in course.marks.values():
            assert study.artifacts.read(mark.place, mark.sha256).is_dir()
