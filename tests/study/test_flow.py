"""Trainings side by side, and code that never ends, exits or dies: nobody waits for the slowest."""

import itertools
import os
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
import quick_problem
from line_problem import evaluate, line, train
from postgres import missing

import mbtl
from flat import created, ran
from mbtl.errors import InvalidInput, TrainingFailed
from mbtl.faults import TookTooLong
from mbtl.processes import SeparateWorkers
from mbtl.seeds import training_seed
from mbtl.study import Callback
from mbtl.study.time_limits import at_most
from mbtl.trainers import FunctionTrainer

pytestmark = [
    pytest.mark.filterwarnings("ignore::mbtl.errors.UnsavedPolicies"),
    pytest.mark.timeout(120),
]
SPACE = line(9)


def study_of(**settings):
    return created(SPACE, **{"budget": 9, "bounds": (0, 1), "strategy": "random", **settings})


def test_a_slow_training_holds_up_no_other(tmp_path):
    """It ends when all others are told; with barriers that would be never."""
    others_done, order = threading.Event(), []

    class Ear(Callback):
        def on_told(self, study, pick):
            order.append(pick.number)
            if len(order) == 8:
                others_done.set()

    study = study_of(storage=tmp_path / "study.db")
    slow = study_of().ask().context["x"]

    def waits(context, seed):
        if context["x"] == slow:
            others_done.wait()
        return context["x"]

    ran(study, waits, evaluate, threads=2, callbacks=[Ear()], report=False)
    assert order == [*range(1, 9), 0]
    assert study.is_finished


class Mortal(FunctionTrainer):
    """Its process dies on some contexts, as often as there are files for them."""

    def __init__(self, folder, lives):
        functions = (quick_problem.evaluate, quick_problem.save, quick_problem.load)
        super().__init__(quick_problem.train, *functions)
        object.__setattr__(self, "folder", folder)
        for source, often in lives.items():
            for life in range(often):
                (folder / f"{source}-{life}").touch()

    def train(self, contexts, seed, **asked):
        source = quick_problem.SPACE.index(contexts[0])
        for life in sorted(self.folder.glob(f"{source}-*")):
            life.unlink()
            os.kill(os.getpid(), signal.SIGKILL)
        return super().train(contexts, seed)


def test_a_worker_that_dies_is_replaced_and_only_its_second_death_costs_a_training(tmp_path):
    study = created(quick_problem.SPACE, budget=3, storage=tmp_path / "study.db")
    once, twice, _ = (pick.source for pick in study.ask(3))  # the same ones, whatever comes first
    for number in range(3):
        study.release(number)
    trainer = Mortal(tmp_path, {once: 1, twice: 2})
    ran(study, trainer=trainer, parallel=2, report=False, rehearse=False)
    (failure,) = study.state.failures
    assert (failure.source, failure.reason) == (twice, "its worker process died")
    assert len(study.state.rows) == 2
    assert study.is_finished


def test_a_process_that_takes_too_long_is_ended():
    workers = SeparateWorkers(1)
    try:
        workers.kill(workers.submit(signal.pause))
        assert workers.submit(os.getpid).result() != os.getpid()
    finally:
        workers.end()
        workers.shutdown()


def test_a_future_that_its_user_cancels_is_a_failed_training():
    class Cancelling(ThreadPoolExecutor):
        asked = 0

        def submit(self, fn, /, *args, **kwargs):
            self.asked += 1
            if self.asked == 2:
                future = Future()
                future.cancel()
                future.set_running_or_notify_cancel()
                return future
            return super().submit(fn, *args, **kwargs)

    with Cancelling(1) as pool:
        study = ran(study_of(), train, evaluate, parallel=2, executor=pool, report=False).study
    assert [f.reason for f in study.state.failures] == ["it was cancelled"]
    assert len(study.state.rows) == 8


def test_while_nothing_has_succeeded_a_failure_begins_nothing_new():
    begun = []

    def broken(context, seed):
        begun.append(context["x"])
        raise RuntimeError("a slip")

    with pytest.raises(TrainingFailed, match="has succeeded") as end:
        ran(study_of(), broken, evaluate, threads=2)
    assert len(begun) == 2
    assert "in broken" in end.value.__notes__[0]  # the exception itself stays in the worker


def test_an_interrupt_gives_back_what_is_under_way(tmp_path):
    class Stop(Callback):
        def on_told(self, study, pick):
            raise KeyboardInterrupt

    study = study_of(storage=tmp_path / "study.db")
    with pytest.raises(KeyboardInterrupt):
        ran(study, train, evaluate, threads=2, callbacks=[Stop()])
    assert len(study.state.rows) == 1
    assert all(pick.lease is None for pick in study.state.open_picks.values())
    assert np.isfinite(study.value)


@pytest.mark.parametrize(
    "wrong",
    [
        *({"retries": -1}, {"timeout": 0.0}, {"lease": 0.0}),
        *({"stop_after_failures": 0}, {"parallel": 0}),
    ],
)
def test_limits_that_make_no_sense_are_refused(wrong):
    with pytest.raises(InvalidInput, match=r"is [01] or more, got|seconds > 0"):
        ran(study_of(), train, evaluate, **wrong)


WRONG = 8  # the context on which something goes wrong


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
    how = {"timeout": 0.2, "report": False, "rehearse": False}
    ran(study, trained, evaluated, threads=parallel, **how)
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
    heard, ear = [], Callback()
    ear.on_note = lambda study, words: heard.append(words)
    ran(study, diverging, evaluate, threads=parallel, retries=1, report=False, callbacks=[ear])
    wrong = SPACE.context(WRONG)["x"]
    assert seeds.pop(wrong) == [first, training_seed(5, 0, WRONG, 1)]
    assert all(len(found) == 1 for found in seeds.values())
    assert not study.state.failures
    (failed,) = (event.data for event in study.log.read() if event.kind == "failed")
    assert (failed["reason"], failed["again"]) == ("FloatingPointError: diverged", True)
    (note,) = heard
    assert note.endswith("failed, and is begun again: FloatingPointError: diverged")
    (told,) = (one for one in study.trainings if one.source == WRONG)
    assert told.seed == training_seed(5, 0, WRONG, 1)


def test_tries_survive_the_process(tmp_path):
    study = study_of(storage=tmp_path / "study.db")
    pick = study.ask()
    assert study.fail(pick, "diverged", again=True)
    again = mbtl.load_study(tmp_path).ask()
    assert (again.number, again.source) == (pick.number, pick.source)
    assert again.seed == training_seed(0, 0, pick.source, 1) != pick.seed


def test_tries_sets_and_lineages_never_share_a_seed():
    made = itertools.product(range(3), [4, (4, 5), (5, 4)], [(), (1, 4, 1000, 0), (1, 4, 2000, 0)])
    seeds = {training_seed(0, 0, on, tries, lineage) for tries, on, lineage in made}
    assert len(seeds) == 27
    assert training_seed(0, 0, [4]) == training_seed(0, 0, 4)


@pytest.mark.parametrize(("parallel", "code"), [(1, 0), (2, "goodbye")])
def test_a_training_that_exits_has_failed(parallel, code):
    def exiting(context, seed):
        if context["x"] == SPACE.context(WRONG)["x"]:
            sys.exit(code)
        return context["x"]

    study = study_of()
    ran(study, exiting, evaluate, threads=parallel, report=False)
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


# ---- kills --------------------------------------------------------------------------------------

PROGRAM = Path(__file__).parents[2] / "benchmarks" / "kills.py"


@pytest.mark.timeout(1800)  # as all others have, on a machine however busy
@pytest.mark.parametrize(
    ("database", "studies"),
    [
        ("sqlite", "steps"),
        pytest.param("sqlite", "trainings,units", marks=pytest.mark.long),
        pytest.param("postgresql", "trainings,steps", marks=pytest.mark.long),
    ],
)
def test_kills_lose_nothing_tell_nothing_twice_and_every_study_ends(database, studies):
    if database == "postgresql" and (reason := missing()):
        pytest.skip(reason)
    options = f"--kills 3 --studies {studies} --databases {database}".split()
    done = subprocess.run([sys.executable, PROGRAM, *options], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "3 kills" in done.stdout
    assert "rows lost 0, told twice 0" in done.stdout
