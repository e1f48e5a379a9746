from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import quick_problem

import mbtl
from flat import created, ran
from mbtl.errors import InvalidInput, UnsavedPolicies
from mbtl.study import Callback
from mbtl.study.closing_report import ReportPlan, fresh_value, plan_of
from mbtl.trainers import FunctionTrainer, Progress

SPACE = quick_problem.SPACE
N = SPACE.n
BATCHES = {"parallel": 2, "deterministic": True}


def study_at(path, **settings):
    settings = {"budget": 5, "bounds": (-20.0, 0.0), "seed": 1, **settings}
    return created(SPACE, storage=path / "study.db", load_if_exists=True, **settings)


def counting(calls, **changes):
    def train(context, seed):
        calls.append(context["mass"])
        return quick_problem.train(context, seed)

    functions = {
        "train_fn": train,
        "evaluate_fn": quick_problem.evaluate,
        "save_fn": quick_problem.save,
        "load_fn": quick_problem.load,
    }
    return FunctionTrainer(**{**functions, **changes})


def test_a_run_trains_each_pick_once_and_reports_on_fresh_episodes(tmp_path):
    calls = []
    study = study_at(tmp_path).run(trainer=counting(calls)).study
    assert len(calls) == 5
    assert study.is_finished
    fresh, before = fresh_value(study.state), study.routing.value
    assert study.value == fresh.value != pytest.approx(before.value)  # other episodes
    assert fresh.value == pytest.approx(before.value, abs=0.3)  # of few and skewed ones


def test_a_finished_study_run_again_trains_nothing(tmp_path):
    calls = []
    study_at(tmp_path).run(trainer=counting(calls))
    again = study_at(tmp_path).run(trainer=counting(calls)).study
    assert len(calls) == 5
    assert again.is_finished


def test_a_run_stopped_in_evaluation_does_not_train_again(tmp_path):
    calls, stops = [], [True]

    def evaluate(policy, contexts, seeds):
        if len(calls) == 3 and stops.pop():
            raise KeyboardInterrupt
        return quick_problem.evaluate(policy, contexts, seeds)

    trainer = counting(calls, evaluate_fn=evaluate)
    with pytest.raises(KeyboardInterrupt):
        study_at(tmp_path).run(trainer=trainer)
    stops.append(False)
    study = study_at(tmp_path)
    assert len(study.state.rows) == 2
    study.run(trainer=trainer)
    assert len(calls) == 5  # the third policy was found in its folder
    (tmp_path / "calm").mkdir()
    calm = study_at(tmp_path / "calm").run(trainer=counting([])).study
    assert [p.source for p in study.state.picks] == [p.source for p in calm.state.picks]
    assert np.array_equal(study.curve, calm.curve)


def test_a_wrong_call_of_the_trainer_gives_the_pick_back(tmp_path):
    def train(context, seed):
        raise InvalidInput("no such hyperparameter")

    study = study_at(tmp_path)
    with pytest.raises(InvalidInput, match="hyperparameter"):
        study.run(trainer=counting([], train_fn=train))
    assert not study.state.failures
    study.run(trainer=counting([]))
    assert len(study.state.rows) == 5


def test_workers_in_other_processes_give_the_same_study(tmp_path):
    """Real processes, two trainings at a time; the order of completion does not matter."""
    there = ran(
        study_at(tmp_path / "processes"),
        trainer=quick_problem.TRAINER,
        parallel=2,
        deterministic=True,
    ).study
    with ThreadPoolExecutor(2) as pool:
        here = ran(
            study_at(tmp_path / "threads"), trainer=quick_problem.TRAINER, executor=pool, **BATCHES
        ).study
    assert [p.source for p in there.state.picks] == [p.source for p in here.state.picks]
    assert np.array_equal(there.curve, here.curve)


def test_an_interrupted_batch_asks_as_an_undisturbed_one(tmp_path):
    class Stop(Callback):
        def on_told(self, study, pick):
            if pick.number == 2:
                raise KeyboardInterrupt

    with ThreadPoolExecutor(2) as pool:
        calm = ran(
            study_at(tmp_path / "calm"), trainer=quick_problem.TRAINER, executor=pool, **BATCHES
        ).study
        with pytest.raises(KeyboardInterrupt):
            ran(
                study_at(tmp_path / "b"),
                trainer=quick_problem.TRAINER,
                parallel=2,
                executor=pool,
                deterministic=True,
                callbacks=[Stop()],
            )
        resumed = ran(
            study_at(tmp_path / "b"), trainer=quick_problem.TRAINER, executor=pool, **BATCHES
        ).study
    assert [p.source for p in resumed.state.picks] == [p.source for p in calm.state.picks]


def test_callbacks_hear_everything(tmp_path):
    heard = []

    class Ear(Callback):
        def on_pick(self, study, pick):
            heard.append("pick")

        def on_progress(self, study, pick, progress):
            heard.append(progress.step)

        def on_evaluation(self, study, pick):
            heard.append("evaluation")

        def on_told(self, study, pick):
            heard.append("told")

        def on_report(self, study, plan):
            heard.append(plan.evaluations)

        def on_note(self, study, words):
            heard.append(words)

        def on_end(self, study):
            heard.append("end")

    class Reporting(FunctionTrainer):
        def train(self, contexts, seed, *, on_progress=None, **asked):
            on_progress(Progress(7, 10))
            return super().train(contexts, seed)

    functions = (
        quick_problem.train,
        quick_problem.evaluate,
        quick_problem.save,
        quick_problem.load,
    )
    trainer = Reporting(*functions)
    study = study_at(tmp_path, budget=2)
    study.run(trainer=trainer, callbacks=[Ear()])
    assert heard == ["pick", 7, "evaluation", "told"] * 2 + [plan_of(study).evaluations, "end"]


def test_policies_that_cannot_be_saved_stay_in_memory_and_that_is_said_at_once(tmp_path, caplog):
    study = study_at(tmp_path)
    with pytest.warns(UnsavedPolicies, match="give save and load functions") as warned:
        study.run(quick_problem.train, quick_problem.evaluate)
    assert warned[0].filename == __file__  # the user's line, not ours
    assert "in memory only" in caplog.text
    policy = study.portfolio().policy_for({"mass": 1.0})
    assert policy.shape == (2,)
    later = mbtl.load_study(tmp_path).portfolio()
    assert later.explain({"mass": 1.0}).predicted_return < 0
    with pytest.raises(mbtl.MbtlError, match="not saved"):
        later.policy_for({"mass": 1.0})


def test_a_saved_portfolio_serves_every_context(tmp_path):
    study = study_at(tmp_path / "s").run(trainer=quick_problem.TRAINER).study
    study.portfolio(quick_problem.TRAINER).save(tmp_path / "p")
    portfolio = mbtl.load_portfolio(tmp_path / "p", load=quick_problem.load)
    for i, seed in enumerate(study.evaluation_seeds()):
        context = SPACE.context(i)
        measured = quick_problem.evaluate(portfolio.policy_for(context), [context], [seed]).mean()
        told = study.state.rows[portfolio.explain(context).policy].returns[i]
        assert measured == pytest.approx(told)
    assert portfolio.policy_for({"mass": 1.2345}).shape == (2,)  # off the list


def test_policies_are_evaluated_afresh_where_they_serve_and_the_best_one_everywhere():
    plan = ReportPlan(np.array([2, 1, 0, 1]), best_single=1, contexts=np.arange(4))
    assert [plan.targets(i).tolist() for i in range(3)] == [[2], [0, 1, 2, 3], [0]]
    assert plan.evaluations == 6
    some = ReportPlan(plan.route, 1, np.array([0, 3]))
    assert some.policies == [1, 2]
    assert [some.targets(i).tolist() for i in range(3)] == [[], [0, 3], [0]]


def test_the_report_plays_what_it_announced_and_not_when_it_is_switched_off(tmp_path, capsys):
    played = []

    def evaluate(policy, contexts, seeds):
        played.append(len(contexts))
        return quick_problem.evaluate(policy, contexts, seeds)

    study = study_at(tmp_path)
    trainer = counting([], evaluate_fn=evaluate)
    assert study.run(trainer=trainer, report=False).fresh is None
    assert study.value == study.routing.value.value
    played.clear()
    result = study.run(trainer=trainer)
    planned = plan_of(study).evaluations
    assert sum(played) == planned <= 2 * study.space.n
    assert f"{planned} evaluations of a policy on a context" in capsys.readouterr().err
    assert result.value == study.value == result.fresh.value


def test_run_needs_something_to_train_with(tmp_path):
    with pytest.raises(InvalidInput, match="train and evaluate"):
        study_at(tmp_path).run()
