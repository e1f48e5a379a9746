"""What a user's code may do instead of returning: never end, exit, or fail with one seed only."""

import itertools
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from line_problem import evaluate, line, train

import mbtl
from flat import created, ran
from mbtl.errors import TrainingFailed
from mbtl.faults import TookTooLong
from mbtl.seeds import training_seed
from mbtl.study.time_limits import at_most

pytestmark = [
    pytest.mark.filterwarnings("ignore::mbtl.errors.UnsavedPolicies"),
    pytest.mark.timeout(120),
]
SPACE = line(9)
WRONG = 8  # the context on which something goes wrong


def study_of(**settings):
    settings = {"budget": 9, "bounds": (0.0, 1.0), "strategy": "random", **settings}
    return created(SPACE, **settings)


def spin():
    while True:
        pass


def spin_in_numpy():
    while True:
        np.ones((50, 50)) @ np.ones((50, 50))


def catch_everything():
    while True:
        try:
            time.sleep(60)
        except Exception:
            continue


def wait_for_a_lock():
    lock = threading.Lock()
    lock.acquire()
    lock.acquire()


def wait_for_a_child():
    subprocess.run([sys.executable, "-c", "import time; time.sleep(60)"])


ENDLESS = [spin, spin_in_numpy, catch_everything, wait_for_a_lock, wait_for_a_child]


@pytest.mark.parametrize("endless", ENDLESS)
def test_a_limit_ends_what_never_returns(endless):
    usual = signal.getsignal(signal.SIGALRM)
    with pytest.raises(TookTooLong, match=r"^it took longer than 0\.05 s$"), at_most(0.05):
        endless()
    assert signal.getsignal(signal.SIGALRM) == usual


def test_a_limit_holds_in_a_thread_too():
    def limited():
        with at_most(0.05):
            spin()

    with ThreadPoolExecutor(1) as pool, pytest.raises(TookTooLong):
        pool.submit(limited).result()


def test_what_ends_in_time_hears_nothing_of_its_limit():
    for _ in range(100):  # among them some that end when the alarm rings
        try:
            with at_most(0.002):
                time.sleep(0.0019)
        except TookTooLong:
            pass
        time.sleep(0.0005)


def test_native_code_that_never_returns_is_told_of():
    """A mutex that is locked twice waits for ever, whatever signals come."""
    script = """
import ctypes, os, mbtl.study.time_limits as limits
limits.GRACE = 0.05
libc, mutex = ctypes.CDLL(None), ctypes.create_string_buffer(64)
with limits.at_most(0.05, lambda: os._exit(7)):
    libc.pthread_mutex_lock(mutex)
    libc.pthread_mutex_lock(mutex)
"""
    assert subprocess.run([sys.executable, "-c", script]).returncode == 7


@pytest.mark.parametrize(("where", "parallel"), [("train", 1), ("train", 2), ("evaluate", 1)])
def test_a_training_that_never_reports_is_ended(where, parallel):
    wrong = SPACE.context(WRONG)["x"]

    def trained(context, seed):
        if where == "train" and context["x"] == wrong:
            spin()
        return context["x"]

    def evaluated(policy, contexts, seed):
        if where == "evaluate" and policy == wrong:
            spin()
        return evaluate(policy, contexts, seed)

    study = study_of()
    with ThreadPoolExecutor(2) as pool:
        ran(study, trained, evaluated, timeout=0.2, report=False, rehearse=False,
            parallel=parallel, executor=pool)  # fmt: skip
    assert len(study.state.rows) == 8
    failed = [*study.state.failures, *study.state.deferred.values()]
    assert [one.source for one in failed] == [WRONG]
    assert failed[0].reason.endswith("it took longer than 0.2 s" if where == "train" else "0.2 s")


@pytest.mark.parametrize("parallel", [1, 2])
def test_another_try_has_another_seed_and_the_log_says_so(parallel):
    seeds = {}

    def diverging(context, seed):
        seeds.setdefault(context["x"], []).append(seed)
        if seed == first:
            raise FloatingPointError("diverged")
        return context["x"]

    first = training_seed(5, 0, WRONG)
    study = study_of(seed=5)
    with ThreadPoolExecutor(2) as pool:
        ran(study, diverging, evaluate, parallel=parallel, executor=pool, retries=1, report=False)
    wrong = SPACE.context(WRONG)["x"]
    assert seeds.pop(wrong) == [first, training_seed(5, 0, WRONG, 1)]
    assert all(len(found) == 1 for found in seeds.values())
    assert not study.state.failures
    assert [e.data["reason"] for e in study.log.read() if e.kind == "retried"] == [
        "FloatingPointError: diverged"
    ]
    (told,) = (one for one in study.trainings if one.source == WRONG)
    assert told.seed == training_seed(5, 0, WRONG, 1)


def test_tries_survive_the_process(tmp_path):
    study = study_of(storage=tmp_path / "study.db")
    pick = study.ask()
    again = study.begin_again(pick, "diverged")
    study.release(again)
    other = mbtl.load_study(tmp_path)
    assert (again.number, again.source) == (pick.number, pick.source)
    assert other.ask().seed == again.seed != pick.seed


def test_tries_sets_and_lineages_never_share_a_seed():
    made = itertools.product(range(3), [4, (4, 5), (5, 4)], [(), (1, 4, 1000, 0), (1, 4, 2000, 0)])
    seeds = {training_seed(0, 0, on, tries, lineage) for tries, on, lineage in made}
    assert len(seeds) == 27
    assert training_seed(0, 0, [4]) == training_seed(0, 0, 4)


@pytest.mark.parametrize(("parallel", "code"), [(1, 0), (2, 1), (1, None), (2, "goodbye")])
def test_a_training_that_exits_has_failed(parallel, code):
    def exiting(context, seed):
        if context["x"] == SPACE.context(WRONG)["x"]:
            sys.exit(code)
        return context["x"]

    study = study_of()
    with ThreadPoolExecutor(2) as pool:
        ran(study, exiting, evaluate, parallel=parallel, executor=pool, report=False)
    assert len(study.state.rows) == 8
    (failed,) = study.state.failures
    assert failed.reason == f"sys.exit({code!r}) was called, where it must return or raise"
    assert "sys.exit(code)" in failed.traceback


def test_an_evaluation_that_exits_keeps_the_policy():
    study = study_of()
    with pytest.raises(TrainingFailed, match=r"evaluation failed with sys\.exit\(0\)"):
        study.run(train, lambda p, c, s: sys.exit(0))
    assert not study.state.failures
    assert len(study.state.deferred) == 1
