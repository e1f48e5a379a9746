from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
import quick_problem

import mbtl
from flat import created, ran
from mbtl.errors import InvalidInput, UnsavedPolicies
from mbtl.study import Callback
from mbtl.study.closing_report import ReportPlan, fresh_value
from mbtl.trainers import Progress

SPACE = quick_problem.SPACE
N = SPACE.n


def study_at(path, **settings):
    settings = {"budget": 5, "bounds": (-20.0, 0.0), "seed": 1, **settings}
    return created(SPACE, storage=path / "study.db", load_if_exists=True, **settings)


def counting(calls, **changes):
    def train(context, seed):
        calls.append(context["mass"])
        return quick_problem.train(context, seed)

    return replace(quick_problem.TRAINER, **{"train_fn": train, **changes})


def test_a_run_trains_each_pick_once_and_reports_on_fresh_episodes(tmp_path):
    calls = []
    study = study_at(tmp_path).run(trainer=counting(calls)).study
    assert len(calls) == 5
    assert study_at(tmp_path).run(trainer=counting(calls)).study.is_finished
    assert len(calls) == 5
    fresh, before = fresh_value(study.state), study.routing.value
    assert study.value == fresh.value != pytest.approx(before.value)  # other episodes
    assert fresh.value == pytest.approx(before.value, abs=0.3)  # of few and skewed ones


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


def test_whole_batches_give_one_study_wherever_they_are_done_and_whatever_interrupts(tmp_path):
    """In threads, in real processes, and interrupted; the order of completion does not matter."""

    class Stop(Callback):
        def on_told(self, study, pick):
            if pick.number == 2:
                raise KeyboardInterrupt

    def run(name, **how):
        how |= {"trainer": quick_problem.TRAINER, "parallel": 2, "deterministic": True}
        return ran(study_at(tmp_path / name, budget=4), **how).study

    with ThreadPoolExecutor(2) as pool:
        calm = run("calm", executor=pool)
        with pytest.raises(KeyboardInterrupt):
            run("interrupted", executor=pool, callbacks=[Stop()])
        resumed = run("interrupted", executor=pool)
    elsewhere = run("elsewhere")
    picks = [[p.source for p in study.state.picks] for study in (calm, elsewhere, resumed)]
    assert picks[0] == picks[1] == picks[2]
    assert np.array_equal(elsewhere.curve, calm.curve)


def test_callbacks_hear_everything(tmp_path):
    heard, ear = [], Callback()
    for name in vars(Callback):
        if name.startswith("on_"):
            setattr(ear, name, lambda study, *facts, name=name: heard.append(name[3:]))

    def train(context, seed, on_progress):
        on_progress(Progress(7, 10))
        return quick_problem.train(context, seed)

    study_at(tmp_path, budget=2).run(trainer=counting([], train_fn=train), callbacks=[ear])
    assert heard == ["pick", "progress", "evaluation", "told"] * 2 + ["report", "end"]


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
