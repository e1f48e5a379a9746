"""Trainings side by side: nobody waits for the slowest, and a worker that dies takes no other."""

import os
import signal
import threading
from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np
import pytest
import quick_problem
from line_problem import evaluate, line, train

from flat import created, ran
from mbtl.errors import InvalidInput, TrainingFailed
from mbtl.processes import SeparateWorkers
from mbtl.study import Callback
from mbtl.trainers import FunctionTrainer

pytestmark = pytest.mark.filterwarnings("ignore::mbtl.errors.UnsavedPolicies")


def study_of(**settings):
    return created(line(9), **{"budget": 6, "bounds": (0, 1), "strategy": "random", **settings})


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

    def waits(context, seed):
        if context["x"] == slow:
            others_done.wait()
        return context["x"]

    with ThreadPoolExecutor(2) as pool:
        ran(study, waits, evaluate, parallel=2, executor=pool, callbacks=[Ear()], report=False)
    assert order == [1, 2, 3, 4, 5, 0]
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
    assert len(study.state.rows) == 5


def test_while_nothing_has_succeeded_a_failure_begins_nothing_new():
    begun = []

    def broken(context, seed):
        begun.append(context["x"])
        raise RuntimeError("a slip")

    with ThreadPoolExecutor(2) as pool, pytest.raises(TrainingFailed, match="has succeeded") as end:
        ran(study_of(), broken, evaluate, parallel=2, executor=pool)
    assert len(begun) == 2
    assert "in broken" in end.value.__notes__[0]  # the exception itself stays in the worker


def test_an_interrupt_gives_back_what_is_under_way(tmp_path):
    class Stop(Callback):
        def on_told(self, study, pick):
            raise KeyboardInterrupt

    study = study_of(storage=tmp_path / "study.db")
    with ThreadPoolExecutor(2) as pool, pytest.raises(KeyboardInterrupt):
        ran(study, train, evaluate, parallel=2, executor=pool, callbacks=[Stop()])
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
