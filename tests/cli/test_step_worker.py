"""`mbtl worker` and `mbtl run --workers` on studies that are paid in steps."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

import mbtl
from mbtl.actions import FixedLength

PROBLEM = """
import sys
sys.path.insert(0, {folder!r})
import mbtl
from step_problem import HORIZON, SPACE, Slow
problem = mbtl.CMDP("slow", SPACE, Slow(), bounds=(0.0, 1.0), horizon=HORIZON)
other = mbtl.CMDP("other", SPACE, Slow(), bounds=(0.0, 1.0), horizon=HORIZON)
"""
PROGRAM = "from mbtl.cli import program; program()"


@pytest.fixture
def own(tmp_path):
    folder = Path(__file__).parents[1] / "study"
    (tmp_path / "own.py").write_text(PROBLEM.format(folder=str(folder)))
    return "own.py:problem"


def begun(place, *arguments):
    return subprocess.Popen(
        [sys.executable, "-c", PROGRAM, *map(str, arguments)],
        cwd=place, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


def made(place, **settings):
    problem = mbtl.loading.load_object("own.py:problem")
    given = {"budget": 100_000, "strategy": "fixed", **settings}
    return mbtl.create_study(problem, cost="steps", storage=place / "s" / "study.db", **given)


def test_a_worker_spends_what_is_left_and_says_so(mbtl_command, own, tmp_path):
    study = made(tmp_path)
    code, out, err = mbtl_command("worker", "s", own)
    assert code == 0, err
    assert study.refresh().stopped == "the budget of 100,000 steps is spent"
    assert f"ends: {study.state.stopped}; " in err
    assert "of 100K steps are paid" in err
    assert study.state.fresh is None  # that is the master's work
    code, out, err = mbtl_command("worker", "s", own, "--json")
    said = json.loads(out)
    assert (said["finished"], said["spent"]) == (True, study.state.spent)


def test_a_master_makes_the_study_follows_its_workers_and_sums_up(mbtl_command, own, tmp_path):
    master = begun(
        tmp_path, "run", own, "--steps", "150K", "--strategy", "fixed", "--workers", "shared.db",
        "--study", "mine", "--json",
    )  # fmt: skip
    for line in master.stderr:
        if "mbtl worker" in line:
            break
    assert line.split() == ["mbtl", "worker", "shared.db", own, "--name", "mine"]
    workers = [begun(tmp_path, *line.split()[1:]) for _ in range(2)]
    for worker in workers:
        _, err = worker.communicate(timeout=120)
        assert worker.returncode == 0, err
    out, err = master.communicate(timeout=120)
    assert master.returncode == 0, err
    summary = json.loads(out)
    assert summary["finished"] == "the budget of 150,000 steps is spent"
    assert summary["spent"] <= 150_000
    assert summary["fresh_value"] > 0.7
    assert "training 1 (x = 0.5)" in err
    assert "evaluated on" in err
    assert (tmp_path / "mine" / "portfolio").is_dir()
    log = mbtl.StepStudy.load(tmp_path / "shared.db").events()
    assert "claimed" not in [event.kind for event in log]


@pytest.mark.parametrize(
    ("problem", "options", "code", "words"),
    [
        ("own.py:problem", ["--selector", "mbtl", "--retries", "1"], 2,
         "paid in steps, where --selector and --retries mean nothing"),
        ("own.py:other", [], 1, "is a study of 'slow', got 'other'"),
        ("own.py:problem", ["--artifacts", "elsewhere"], 2, "are not in"),
    ],
)  # fmt: skip
def test_what_means_nothing_costs_a_line(
    mbtl_command, own, tmp_path, problem, options, code, words
):
    study = made(tmp_path)
    found, _, err = mbtl_command("worker", "s", problem, *options)
    assert found == code
    assert words in " ".join(err.split())
    assert study.refresh().spent == 0


@pytest.mark.parametrize("strategy", [FixedLength("mbtl"), FixedLength("mbtl", name="mine")])
def test_a_strategy_that_the_command_line_cannot_make_is_not_replaced(
    mbtl_command, own, tmp_path, strategy
):
    made(tmp_path, strategy=strategy)
    code, _, err = mbtl_command("worker", "s", own)
    assert code == 1
    assert "mbtl.StepStudy.load(..., strategy=...).run()" in " ".join(err.split())


def test_the_time_of_a_worker_ends_and_another_one_goes_on(mbtl_command, own, tmp_path):
    (tmp_path / "own.py").write_text(
        (tmp_path / "own.py").read_text()
        + "import time\nclass Slower(Slow):\n    def work(self):\n        time.sleep(1.0)\n"
        + "problem = mbtl.CMDP('slow', SPACE, Slower(), bounds=(0.0, 1.0), horizon=HORIZON)\n"
    )
    study = made(tmp_path)
    code, _, err = mbtl_command("worker", "s", own, "--wall-time", "3")
    assert code == 0, err
    assert "ends: the wall time is over" in err
    assert not study.refresh().stopped
    (held,) = study.state.under_way.values()
    assert held.lease is None  # given back at once
