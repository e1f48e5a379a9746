"""What people ask a study for: its trainings as lines, what a run gave, ending early."""

from dataclasses import replace

import numpy as np
import pytest
import quick_problem

import mbtl
from flat import created, ran
from mbtl.study.job import Job, perform_elsewhere
from mbtl.trainers import FunctionTrainer, Progress

N = 15


def study_of(storage=None, **settings):
    settings = {"budget": 4, "bounds": (-40.0, 0.0), "strategy": "equidistant", **settings}
    return created(quick_problem.SPACE, storage=storage, **settings)


def reporting(context, seed, on_progress):
    for step in (100, 200, 300):
        on_progress(Progress(step, 300, {"episode_return": float(step)}))
    return quick_problem.train(context, seed)


TRAINER = replace(quick_problem.TRAINER, train_fn=reporting)


def test_trainings_say_what_became_of_each_pick_and_of_rows_nobody_asked_for(tmp_path):
    study = study_of(tmp_path / "s.db", budget=6)
    done, failed, pruned, back, _ = (study.ask() for _ in range(5))
    study.tell(done, np.linspace(-9.0, -1.0, N), seconds=3.0, steps=500)
    study.fail(failed, "diverged", steps=70)
    study.fail(pruned, "not worth it", pruned=True)
    study.release(back)
    study.tell(1, np.full(N, -5.0))
    lines = study.trainings
    states = [line.state for line in lines]
    assert states == ["done", "failed", "pruned", "waiting", "running", "done"]
    assert [line.number for line in lines] == [0, 1, 2, 3, 4, None]
    first = lines[0]
    assert (first.seed, first.seconds, first.steps, first.cost) == (done.seed, 3.0, 500.0, 1.0)
    assert first.home_return == np.linspace(-9.0, -1.0, N)[done.source]
    assert [lines[0].value, lines[5].value] == pytest.approx(study.curve.tolist())
    assert (lines[1].error, lines[1].steps) == ("diverged", 70.0)
    assert {line.worker for line in lines} == {study.worker, None}
    assert study.trainings == mbtl.load_study(tmp_path / "s.db").trainings


def test_a_run_says_what_it_gave():
    study = study_of()
    result = study.run(trainer=TRAINER, progress=False)
    assert result.study is study
    assert np.array_equal(result.curve, study.curve)
    assert result.value == result.fresh.value
    assert [line.steps for line in result.trainings] == [300.0] * 4
    assert result.stop_reason == "the budget of 4 trainings is spent"
    assert (result.failures, result.seconds > 0.0) == ((), True)
    assert len(result.portfolio()) == 4
    assert "4 trainings told" in repr(result)


class Ends(mbtl.Callback):
    def __init__(self, at):
        self.at = at

    def on_told(self, study, pick):
        if len(study.state.rows) == self.at:
            study.stop("enough for today")


@pytest.mark.parametrize("parallel", [1, 2])
def test_a_callback_ends_a_run_and_the_next_one_goes_on(tmp_path, parallel):
    study = study_of(tmp_path / "s.db")
    options = {"trainer": quick_problem.TRAINER, "progress": False, "report": False}
    stopped = ran(study, threads=parallel, callbacks=[Ends(1)], **options)
    assert stopped.stop_reason == "enough for today"
    assert len(stopped.curve) == len(study.state.picks) == parallel
    assert not study.is_finished
    assert study.run(**options).stop_reason == "the budget of 4 trainings is spent"


class Prunes(mbtl.Callback):
    """Ends the first training at its second report."""

    def __init__(self):
        self.heard = []

    def on_progress(self, study, pick, progress):
        if pick.number == 0 and progress.step == 200:
            raise mbtl.TrainingPruned("a return of 200 at step 200")

    def on_pruned(self, study, pick, reason):
        self.heard.append((pick.number, reason))


def test_a_callback_ends_one_training_early_which_is_no_failure():
    study, callback = study_of(), Prunes()
    result = ran(study, trainer=TRAINER, callbacks=[callback], stop_after_failures=1)
    assert callback.heard == [(0, "a return of 200 at step 200")]
    assert [line.state for line in result.trainings] == ["pruned", "done", "done", "done"]
    assert result.trainings[0].error == "a return of 200 at step 200"
    assert ran(study, trainer=TRAINER, progress=False, retry_failed=True).curve.size == 3


def gives_up(context, seed):
    raise mbtl.TrainingPruned("no hope")


def test_a_training_may_end_itself_early_also_elsewhere_and_none_is_needed_to_succeed():
    study = study_of()
    trainer = FunctionTrainer(gives_up, quick_problem.evaluate)
    result = study.run(trainer=trainer, progress=False)
    assert [line.state for line in result.trainings] == ["pruned"] * 4
    assert result.value == -np.inf
    job = Job(trainer, [{"mass": 1.0}], 0, [{"mass": 1.0}], [0], None)
    assert perform_elsewhere(job).pruned
