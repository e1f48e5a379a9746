"""Trainings side by side: nobody waits for the slowest, and a worker that dies takes no other."""

import os
import signal
import threading
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
import quick_problem

import mbtl
from flat import created, ran
from mbtl.errors import InvalidInput, TrainingFailed
from mbtl.processes import SeparateWorkers
from mbtl.study import Callback
from mbtl.trainers import FunctionTrainer, Progress, Trained

pytestmark = pytest.mark.filterwarnings("ignore::mbtl.errors.UnsavedPolicies")
SPACE = mbtl.ContextSpace.grid({mbtl.Linear("x", 0.0, 1.0): 9})


def evaluate(policy, contexts, seeds):
    return [1 - abs(policy - c["x"]) for c in contexts]


def study_of(**settings):
    settings = {"budget": 6, "bounds": (0.0, 1.0), "strategy": "random", **settings}
    return created(SPACE, **settings)


@pytest.mark.timeout(120)
def test_a_slow_training_holds_up_no_other(tmp_path):
    """It ends when all others are told; with barriers that would be never."""
    others_done, order = threading.Event(), []

    class Ear(Callback):
        def on_told(self, study, pick):
            order.append(pick.number)
            if len(order) == 5:
                others_done.set()

    study = study_of(storage=tmp_path / "study.db")
    slow = study_of().ask().context["x"]

    def train(context, seed):
        if context["x"] == slow:
            others_done.wait()
        return context["x"]

    with ThreadPoolExecutor(2) as pool:
        ran(study, train, evaluate, parallel=2, executor=pool, callbacks=[Ear()], report=False)
    assert order == [1, 2, 3, 4, 5, 0]
    assert study.is_finished


class Mortal(FunctionTrainer):
    """Its process dies on one context, as often as there is a file for it."""

    def __init__(self, folder, lives):
        functions = (quick_problem.evaluate, quick_problem.save, quick_problem.load)
        super().__init__(quick_problem.train, *functions)
        for life in range(lives):
            (folder / f"life-{life}").touch()
        object.__setattr__(self, "folder", folder)

    def train(self, contexts, seed, **asked):
        if contexts[0]["mass"] == quick_problem.SPACE.context(7)["mass"]:
            for life in sorted(Path(self.folder).glob("life-*")):
                life.unlink()
                os.kill(os.getpid(), signal.SIGKILL)
        return super().train(contexts, seed)


@pytest.mark.parametrize(("lives", "failed"), [(1, 0), (2, 1)])
def test_a_worker_that_dies_costs_one_training_and_is_replaced(tmp_path, lives, failed):
    study = created(
        quick_problem.SPACE, budget=4, bounds=(-20.0, 0.0), storage=tmp_path / "study.db"
    )
    for pick in study.ask(4):  # the same ones, whatever comes first
        study.release(pick)
    assert 7 in [pick.source for pick in study.state.picks]
    ran(study, trainer=Mortal(tmp_path, lives), parallel=2, report=False, rehearse=False)
    assert [f.reason for f in study.state.failures] == ["its worker process died"] * failed
    assert len(study.state.rows) == 4 - failed
    assert study.is_finished


@pytest.mark.parametrize("parallel", [1, 2])
def test_a_training_that_fails_by_chance_is_begun_again(parallel):
    tries = []

    def train(context, seed):
        tries.append(context["x"])
        if tries.count(context["x"]) < 3:
            raise RuntimeError("no licence just now")
        return context["x"]

    with ThreadPoolExecutor(2) as pool:
        study = ran(
            study_of(), train, evaluate, parallel=parallel, executor=pool, retries=2, report=False
        ).study
    assert (len(study.state.rows), len(study.state.failures)) == (6, 0)
    assert len(tries) == 18


@pytest.mark.parametrize("parallel", [1, 2])
@pytest.mark.timeout(120)
def test_a_training_that_takes_too_long_is_given_up(parallel):
    free = threading.Event()

    class Endless(FunctionTrainer):
        def train(self, contexts, seed, *, on_progress=None, **asked):
            if contexts[0]["x"] == endless:
                while not free.wait(0.01):
                    if on_progress is not None:
                        on_progress(Progress(1, 2))
            return Trained(contexts[0]["x"])

    endless = study_of().ask(2)[1].context["x"]
    study = study_of()
    with ThreadPoolExecutor(3) as pool:
        ran(study,
            trainer=Endless(None, evaluate), parallel=parallel, executor=pool, timeout=0.3,
            report=False,
        )  # fmt: skip
        free.set()
    assert [f.reason for f in study.state.failures] == ["it took longer than 0.3 s"]
    assert len(study.state.rows) == 5


def test_a_process_that_takes_too_long_is_ended():
    workers = SeparateWorkers(2)
    try:
        endless, quick = workers.submit(signal.pause), workers.submit(os.getpid)
        assert quick.result() != os.getpid()
        workers.kill(endless)
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
        study = ran(
            study_of(), lambda c, s: c["x"], evaluate, parallel=2, executor=pool, report=False
        ).study
    assert [f.reason for f in study.state.failures] == ["it was cancelled"]
    assert len(study.state.rows) == 5


def test_while_nothing_has_succeeded_a_failure_begins_nothing_new():
    begun = []

    def broken(context, seed):
        begun.append(context["x"])
        raise RuntimeError("a slip")

    with (
        ThreadPoolExecutor(2) as pool,
        pytest.raises(TrainingFailed, match="nothing has succeeded"),
    ):
        ran(study_of(), broken, evaluate, parallel=2, executor=pool)
    assert len(begun) == 2


def test_an_interrupt_gives_back_what_is_under_way(tmp_path):
    class Stop(Callback):
        def on_told(self, study, pick):
            raise KeyboardInterrupt

    study = study_of(storage=tmp_path / "study.db")
    with ThreadPoolExecutor(2) as pool, pytest.raises(KeyboardInterrupt):
        ran(study,
            lambda c, s: c["x"], evaluate, parallel=2, executor=pool, callbacks=[Stop()]
        )  # fmt: skip
    assert len(study.state.rows) == 1
    assert all(pick.lease is None for pick in study.state.open_picks.values())
    assert np.isfinite(study.value)


@pytest.mark.parametrize("wrong", [{"retries": -1}, {"timeout": 0.0}, {"lease": 0.0}])
def test_limits_that_make_no_sense_are_refused(wrong):
    with pytest.raises(InvalidInput, match=r"is 0 or more|seconds > 0"):
        ran(study_of(), lambda c, s: c["x"], evaluate, **wrong)
