"""Runs from end to end, and what went wrong once or would be easy to get wrong."""

import os
import signal
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context

import numpy as np
import pytest
import quick_problem
from line_problem import line

import mbtl
from flat import created, ran
from mbtl.errors import InvalidInput, StudyError, StudyMismatch, UnsavedPolicies
from mbtl.seeds import training_seed
from mbtl.study import Callback
from mbtl.study.closing_report import fresh_value
from mbtl.trainers import Progress

SPACE, TRAINER = quick_problem.SPACE, quick_problem.TRAINER
N, LINE = SPACE.n, line(101)


def new(path, **settings):
    settings = {"budget": 4, "bounds": (-20.0, 0.0), "load_if_exists": True, **settings}
    return created(SPACE, storage=path, **settings)


def study_at(folder, **settings):
    return new(folder / "study.db", **settings)


def counting(calls, **changes):
    def train(context, seed):
        calls.append(context["mass"])
        return quick_problem.train(context, seed)

    return replace(TRAINER, **{"train_fn": train, **changes})


def test_a_run_trains_each_pick_once_and_reports_on_fresh_episodes(tmp_path):
    calls = []
    study = study_at(tmp_path).run(trainer=counting(calls)).study
    assert study_at(tmp_path).run(trainer=counting(calls)).study.is_finished
    assert len(calls) == 4
    fresh, before = fresh_value(study.state), study.routing.value
    assert study.value == fresh.value != pytest.approx(before.value)  # other episodes
    assert fresh.value == pytest.approx(before.value, abs=0.3)  # of few and skewed ones


def test_a_wrong_call_of_the_trainer_gives_the_pick_back(tmp_path):
    def train(context, seed):
        raise InvalidInput("no such hyperparameter")

    study = study_at(tmp_path)
    with pytest.raises(InvalidInput, match="hyperparameter"):
        study.run(trainer=counting([], train_fn=train))
    assert not study.state.failures
    study.run(trainer=counting([]), report=False)
    assert len(study.state.rows) == 4


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


def test_policies_that_cannot_be_saved_stay_in_memory_and_that_is_said_at_once(tmp_path):
    study = study_at(tmp_path)
    with pytest.warns(UnsavedPolicies, match="give save and load functions") as warned:
        study.run(quick_problem.train, quick_problem.evaluate)
    assert warned[0].filename == __file__  # the user's line, not ours
    assert "in memory only" in str(warned[0].message)
    policy = study.portfolio().policy_for({"mass": 1.0})
    assert policy.shape == (2,)
    later = mbtl.load_study(tmp_path).portfolio()
    assert later.explain({"mass": 1.0}).predicted_return < 0
    with pytest.raises(mbtl.MbtlError, match="not saved"):
        later.policy_for({"mass": 1.0})


def scaled(factor):
    def train(context, seed):
        return factor * quick_problem.train(context, seed)

    return replace(TRAINER, train_fn=train)


def test_studies_in_one_folder_or_one_database_keep_their_policies_apart(tmp_path):
    studies = [
        new(tmp_path / "a.db", budget=1).run(trainer=scaled(1.0), report=False).study,
        new(tmp_path / "b.db", budget=1).run(trainer=scaled(0.5), report=False).study,
        new(tmp_path / "b.db", budget=1, name="second").run(trainer=scaled(0.25)).study,
    ]
    for study, factor in zip(studies, (1.0, 0.5, 0.25), strict=True):
        for pick in study.state.picks:
            seed = training_seed(0, 0, pick.source)
            expected = factor * quick_problem.train(SPACE.context(pick.source), seed)
            row = [r.source for r in study.state.rows].index(pick.source)
            assert study.portfolio(scaled(1.0)).policy(row) == pytest.approx(expected)


class Fails(Callback):
    """Raises in one method, once."""

    def __init__(self, method, error):
        self.armed = True

        def fail(*arguments):
            if self.armed:
                self.armed = False
                raise error

        setattr(self, method, fail)


@pytest.mark.parametrize(
    ("method", "error"), [("on_pick", RuntimeError("plot")), ("on_evaluation", OSError("disk"))]
)
def test_a_broken_callback_ends_the_run_and_nothing_is_lost(method, error):
    study = new(None, budget=2)
    with pytest.raises(type(error)):
        study.run(trainer=TRAINER, callbacks=[Fails(method, error)])
    assert not study.state.failures
    study.run(trainer=TRAINER, report=False)
    assert len(study.state.rows) == 2
    assert not study.state.open_picks


def test_functions_that_cannot_travel_are_refused_before_any_budget_is_spent(tmp_path):
    study = new(tmp_path / "study.db")
    with pytest.raises(InvalidInput, match="functions of a module"):
        ran(study, lambda c, s: c, lambda p, c, s: np.zeros(len(c)), parallel=2)
    assert not study.state.failures
    assert not [p for p in study.state.open_picks.values() if p.worker is not None]


def _die(context, seed):
    os.kill(os.getpid(), signal.SIGKILL)


# other tests may have started jax in this process, whose threads a fork does not survive; this
# child dies before it could meet any
@pytest.mark.filterwarnings("ignore:os.fork")
def test_a_killed_worker_gives_its_picks_back(tmp_path):
    study = new(tmp_path / "study.db")
    pool = ProcessPoolExecutor(1, mp_context=get_context("fork"))
    with pool, pytest.raises(StudyError, match="worker process died"):
        ran(study, trainer=replace(TRAINER, train_fn=_die), parallel=2, executor=pool)
    assert not study.state.failures
    study.run(trainer=TRAINER, report=False)
    assert len(study.state.rows) == 4


def test_any_weights_survive_the_log(tmp_path):
    rng = np.random.default_rng(0)
    for i in range(3):
        space = mbtl.ContextSpace.grid({mbtl.Linear("x", 0, 1): 9}, weights=rng.uniform(size=9))
        for _ in range(2):
            mbtl.create_study(space, budget=2, storage=tmp_path / f"{i}.db", load_if_exists=True)


def test_settings_read_back_as_they_compare(tmp_path):
    for _ in range(2):
        new(tmp_path / "s.db", settings={"net": (64, 64), "rate": 1e-3})
    for rate in (np.float64(1e-3), lambda left: 1e-3 * left):
        new(tmp_path / "by_value.db", settings={"rate": rate}, name=type(rate).__name__)
    with pytest.raises(StudyMismatch, match=r"settings\.rate\.code was 'source:"):
        new(tmp_path / "by_value.db", settings={"rate": lambda left: 1e-3}, name="function")


def test_a_report_that_does_not_fit_the_rows_is_refused_and_a_new_row_makes_it_void():
    study = created(SPACE, budget=3, bounds=(-20.0, 0.0))
    study.tell(study.ask(), np.zeros(15))
    with pytest.raises(InvalidInput, match=r"array `served` must hold numbers of shape \(15, 15\)"):
        study.record_fresh_returns(np.zeros((2, 15)), np.zeros((2, 15)), best_single=0)
    with pytest.raises(StudyError, match="of 2; evaluate again"):
        study.record_fresh_returns(np.zeros((15, 2)), np.zeros((15, 2)), best_single=0, rows=2)
    study.record_fresh_returns(np.zeros((15, 1)), np.zeros((15, 1)), best_single=0)
    study.tell(study.ask(), np.zeros(15))
    assert study.state.fresh is None


def test_the_first_picks_of_parallel_workers_spread_out():
    for selector in ("mbtl", "mbtl-ei", "mbtl-release", "worst-first"):
        study = mbtl.create_study(LINE, budget=8, strategy=selector)
        assert [study.ask().source for _ in range(5)] == [50, 0, 100, 25, 75]


def test_a_level_once_reached_ends_the_study_also_for_picks_given_back():
    study = created(LINE, budget=8, bounds=(0.0, 1.0), stop_value=0.9)
    first, second = study.ask(), study.ask()
    study.tell(first, np.ones(101))
    study.release(second)
    with pytest.raises(mbtl.study.StudyFinished, match="reaches the level"):
        study.ask()
    assert study.is_finished


@pytest.mark.parametrize("name", ["what? 100%.db", "ü#.db"])
def test_any_file_name_will_do(tmp_path, name):
    new(tmp_path / name, budget=1).run(trainer=TRAINER, report=False)
    assert (tmp_path / "policies").is_dir()
    assert len(mbtl.load_study(tmp_path / name).state.rows) == 1


def test_a_study_on_a_read_only_medium_can_be_read(tmp_path):
    new(tmp_path / "study.db").tell(3, np.zeros(15))
    url = f"sqlite:///file:{tmp_path / 'study.db'}?mode=ro&uri=true"
    assert len(mbtl.load_study(url, "study").state.rows) == 1


def test_a_budget_can_be_raised_and_goes_on_as_if_it_had_been_larger():
    long = new(None, budget=4).run(trainer=TRAINER, report=False).study
    short = new(None, budget=2).run(trainer=TRAINER, report=False).study
    short.extend(4)
    short.run(trainer=TRAINER, report=False)
    assert [p.source for p in short.state.picks] == [p.source for p in long.state.picks]
    assert np.array_equal(short.curve, long.curve)
    for budget in (4, 3, 16, mbtl.Steps(9), mbtl.Cost(9.0)):
        with pytest.raises(InvalidInput, match="can only be raised"):
            short.extend(budget)


def test_who_gives_no_budget_goes_on_with_the_one_that_was_raised(tmp_path):
    problem = mbtl.CMDP.from_functions(
        "raised", SPACE, train=TRAINER.train, evaluate=TRAINER.evaluate, budget=3
    )
    budgets = (None, 5, None)
    again = {"storage": tmp_path / "study.db", "load_if_exists": True}
    made = [problem.study(budget=one, **again).spec.budget for one in budgets]
    assert made == [3, 5, 5]
    for name, other in (("c", mbtl.Cost(7.0)), ("s", mbtl.Steps(1000, unit=100, horizon=5))):
        sizes = [problem.study(budget=b, name=name, **again).spec.size for b in (other, None)]
        assert sizes[0] == sizes[1]
    with pytest.raises(StudyMismatch, match="budget was 5, got 3"):
        problem.study(budget=3, **again)


def test_a_cost_can_be_raised_and_pays_for_one_training_at_least(tmp_path):
    def paid(total, trainings=None):
        budget = mbtl.Cost(total, np.full(15, 2.0), trainings)
        study = mbtl.create_study(
            SPACE, budget=budget, strategy="random", storage=tmp_path / "study.db",
            load_if_exists=True, objective=mbtl.Objective(bounds=(-20.0, 0.0)),
        )  # fmt: skip
        return study.run(trainer=TRAINER, report=False).study

    assert [len(paid(total).state.rows) for total in (5.0, 5.0, 9.0)] == [2, 2, 4]
    study = mbtl.load_study(tmp_path)
    study.extend(mbtl.Cost(11.0))
    assert len(study.run(trainer=TRAINER, report=False).trainings) == 5
    for budget in (12, mbtl.Cost(11.0), mbtl.Cost(8.0, trainings=15), mbtl.Cost(12.0, trainings=2)):
        with pytest.raises(InvalidInput, match=r"from cost 11 .*, got"):
            study.extend(budget)
    with pytest.raises(
        StudyMismatch, match=r"'study'\) goes on .* cost_budget was 11\.0, got 6\.0"
    ):
        paid(6.0)
    with pytest.raises(InvalidInput, match="the cheapest costs 2, got 1"):
        paid(1.0)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (lambda: mbtl.ContextSpace.grid({"g": 5}), "axes as keys"),
        (lambda: SPACE.encode(7.3), "a context is a mapping"),
        (lambda: new(None).tell("p", np.zeros(15)), "tell takes what ask gave"),
        (lambda: new(None).tell(0, np.zeros(15) + 1j), "real numbers"),
        (lambda: new(None).tell({"mass": 9.0}, np.zeros(15)), r"\[0\.2, 4\]"),
        (lambda: new(None).tell(15, np.zeros(15)), "0 to 14"),
    ],
)
def test_wrong_types_get_the_rule_not_pythons_own_words(wrong, words):
    with pytest.raises(mbtl.MbtlError, match=words):
        wrong()
