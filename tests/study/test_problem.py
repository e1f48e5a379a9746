"""A study knows its problem: what belongs to a CMDP comes from it and is checked against it."""

import importlib
import io
import sys

import numpy as np
import pytest
from line_problem import line

import mbtl
from flat import created, ran
from mbtl.errors import InvalidInput, StudyError, StudyMismatch, UnknownName
from mbtl.problems import CMDP, Preset
from mbtl.study import Callback
from mbtl.study.study import PrintProgress
from mbtl.trainers.contract import FunctionTrainer, recipe_digest

SPACE = mbtl.ContextSpace.grid({mbtl.Linear("gravity", 1.0, 9.0, unit="m/s2"): 9})


class Toy(FunctionTrainer):
    """Costs |x - x'|, with a recipe that presets may change."""

    def __init__(self, steps=10):
        super().__init__(
            lambda context, seed: context["gravity"],
            lambda policy, contexts, seeds: [abs(policy - c["gravity"]) for c in contexts],
            lambda policy, folder: (folder / "p").write_text(str(policy)),
            lambda folder: float((folder / "p").read_text()),
        )
        object.__setattr__(self, "recipe", {"steps": steps})


def problem(**record):
    record = {"bounds": (0.0, 4.0), "direction": "minimize", "theta": 0.1, "version": 3, **record}
    presets = {"quick": Preset(3), "long": Preset(5)}
    return CMDP("toy", SPACE, Toy(), presets=presets, best_return=0.0, **record)


@pytest.mark.parametrize("make", [lambda p, **s: p.study(**s), mbtl.create_study])
def test_a_study_of_a_problem_needs_nothing_said_twice(tmp_path, make):
    cmdp = problem()
    study = make(cmdp, strategy="random", storage=tmp_path / "s.db").run(report=False).study
    assert study.space == SPACE
    spec = study.spec
    assert (spec.budget, spec.bounds, spec.direction) == (3, (0.0, 4.0), "minimize")
    assert (spec.theta, spec.best_return, spec.problem) == (0.1, 0.0, "toy")
    assert spec.settings["preset"] == "quick"
    assert study.state.equipment["recipe"] == {"steps": 10}
    assert study.portfolio().policy(0) == SPACE.context(study.history.sources[0])["gravity"]
    again = mbtl.load_study(tmp_path / "s.db", problem=cmdp)
    assert again.portfolio().policy_for({"gravity": 9.0}) in SPACE.values("gravity")
    assert make(cmdp, strategy="random", storage=tmp_path / "s.db", load_if_exists=True).is_finished


def test_what_is_given_counts_more_than_the_problem():
    trainer = Toy(steps=20)
    given = problem(settings={"note": 1})
    study = created(given, preset="long", budget=2, bounds=(0.0, 8.0), trainer=trainer)
    assert (study.spec.budget, study.spec.bounds, study.trainer) == (2, (0.0, 8.0), trainer)
    assert study.spec.settings["recipe"] == {"steps": 20}
    assert (study.spec.settings["preset"], study.spec.settings["switches"]) == ("long", {"note": 1})
    with pytest.raises(UnknownName, match="preset"):
        created(problem(), preset="lon")
    with pytest.raises(InvalidInput, match="ContextSpace or a CMDP, got dict"):
        mbtl.create_study({"gravity": 1.0}, budget=3)
    with pytest.raises(InvalidInput, match="needs budget="):
        mbtl.create_study(SPACE)
    with pytest.raises(InvalidInput, match="or a trainer"):
        mbtl.create_study(SPACE, budget=3).run()


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"workers": 2}, r"workers must be a mbtl\.Workers\(\.\.\.\), got int 2"),
        ({"failures": 2}, r"failures must be a mbtl\.Failures\(\.\.\.\), got int 2"),
        ({"report": "some"}, "report is True, False or 'all', got 'some'"),
        ({"trainer": 5}, "made by a trainer, got 5"),
    ],
)
def test_a_run_refuses_what_is_of_another_kind(given, words):
    with pytest.raises(InvalidInput, match=words):
        problem().study().run(progress=False, **given)


def test_a_problem_may_stand_for_its_trainer():
    study = mbtl.create_study(SPACE, budget=1)
    study.equip(problem())
    assert study.state.equipment["recipe"] == {"steps": 10}
    assert len(study.run(trainer=problem(), progress=False, report=False).trainings) == 1


@pytest.mark.parametrize(
    ("other", "words"),
    [
        (problem(version=4), "version was 3, got 4"),
        (problem(settings={"visibility": "raw"}), "switches"),
        (CMDP("else", SPACE, Toy(), version=3), "problem was 'toy', got 'else'"),
        (CMDP("toy", SPACE.every(2), Toy(), version=3), "the number of contexts was"),
    ],
)
def test_another_problem_is_refused(tmp_path, other, words):
    problem().study(storage=tmp_path / "s.db")
    with pytest.raises(StudyMismatch, match=words):
        mbtl.load_study(tmp_path / "s.db", problem=other)


def test_a_preset_that_is_gone_still_loads_and_another_recipe_does_not_train(tmp_path):
    created(problem(), preset="long", strategy="random", storage=tmp_path / "s.db").run(
        report=False
    )
    later = CMDP("toy", SPACE, Toy(steps=99), version=3)
    study = mbtl.load_study(tmp_path / "s.db", problem=later)
    assert isinstance(study.portfolio().policy(0), float)
    study.extend(6)
    with pytest.raises(StudyMismatch, match=r"recipe\.steps was 10, got 99"):
        study.run()


OWN = """
from dataclasses import dataclass
from mbtl.selectors import Proposal
@dataclass(frozen=True)
class Last:
    back: int = 1
    name: str = "last"
    def propose(self, problem, history, rng):
        return Proposal(problem.n - len(history) - self.back, "from the end")
"""


def test_a_selector_in_a_file_is_named_in_the_log_and_never_run_from_it(folder):
    (folder / "own_selector.py").write_text(OWN)
    reference = "own_selector.py:Last"
    study = problem().study(strategy=reference, storage="s.db").run(report=False).study
    assert study.history.sources == (8, 7, 6)
    with pytest.raises(StudyError, match=r"'last'; give it as strategy='own_selector\.py:Last'"):
        mbtl.load_study("s.db")
    assert mbtl.load_study("s.db", strategy=reference).is_finished
    elsewhere = f"{folder}/own_selector.py:Last"  # the same, by another path
    assert problem().study(strategy=elsewhere, storage="s.db", load_if_exists=True).is_finished
    changed = study.selector.__class__(back=2)
    with pytest.raises(StudyMismatch, match="back"):
        problem().study(strategy=changed, storage="s.db", load_if_exists=True)
    with pytest.raises(StudyMismatch, match="give the same one"):
        mbtl.load_study("s.db", strategy="random")


def test_a_line_per_pick_is_for_people_who_count_from_1(capsys):
    study = problem().study(strategy="equidistant").run(report=False).study
    first, second, _ = capsys.readouterr().err.splitlines()
    assert first.startswith("pick 1 of 3: gravity = 8 m/s2, V = ")
    assert second.startswith("pick 2 of 3: gravity = 5 m/s2, V = ")
    assert second.endswith(f"(gain {study.curve[1] - study.curve[0]:.4f})")
    problem().study(strategy="equidistant").run(report=False, progress=False)
    assert capsys.readouterr() == ("", "")
    study = problem().study(strategy="specialists")
    pick = study.ask()
    assert str(pick) == "pick 1: gravity = 5.0 (middle of the range)"
    PrintProgress(said := io.StringIO()).on_failed(study, pick, "licence expired")
    assert said.getvalue() == "pick 1 of 3: gravity = 5 m/s2 failed: licence expired\n"


def test_a_run_that_joins_is_told_so(tmp_path, capsys):
    first = problem().study(strategy="random", storage=tmp_path / "s.db")
    first.ask()
    heard = []

    class Ear(Callback):
        def on_note(self, study, words):
            heard.append(words)

    study = mbtl.load_study(tmp_path / "s.db", problem=problem())
    study.run(callbacks=[Ear()], report=False)
    assert heard[0].startswith(f"{first.worker} works on this study, too")
    assert f"{first.worker} works on this study, too" in capsys.readouterr().err
    assert len(study.state.rows) == 2  # the third is theirs
    assert np.isfinite(study.value)


MODULE = """
import numpy as np
import mbtl
GAIN = {gain}
def score(x, at):
    return {score}
def train(context, seed):
    return np.array([context["x"]])
def evaluate(policy, contexts, seed):  # {comment}
    return [score(policy[0], c["x"]) for c in contexts]
def save(policy, folder):
    np.save(folder / "x.npy", policy)
def load(folder):
    return np.load(folder / "x.npy")
"""


@pytest.fixture
def edited(tmp_path, monkeypatch):
    """The module as it stands after an edit, as a new process imports it."""
    monkeypatch.syspath_prepend(str(tmp_path))

    def edit(gain=1.0, score="1 - GAIN * abs(x - at)", comment=""):
        text = MODULE.format(gain=gain, score=score, comment=comment)
        (tmp_path / "own.py").write_text(text)
        sys.modules.pop("own", None)
        importlib.invalidate_caches()
        sys.dont_write_bytecode = True
        return importlib.import_module("own")

    written = sys.dont_write_bytecode
    yield edit
    sys.dont_write_bytecode = written
    sys.modules.pop("own", None)


def run(tmp_path, own, budget, **options):
    settings = {"storage": tmp_path / "s.db", "load_if_exists": True, "strategy": "random"}
    study = created(line(7), budget=budget, bounds=(0.0, 1.0), **settings)
    ran(study, own.train, own.evaluate, save=own.save, load=own.load, progress=False, **options)
    return study


@pytest.mark.parametrize(
    ("edit", "named"),
    [
        ({"score": "1 - GAIN * abs(x - at)**2"}, "`score`, which `evaluate` uses changed"),
        ({"gain": 0.5}, r"`GAIN`, which `evaluate` uses \(was 1.0, is 0.5\) changed"),
    ],
)
def test_an_edited_evaluate_is_named_and_goes_on_where_that_is_accepted(
    edited, tmp_path, edit, named
):
    run(tmp_path, edited(), 2)
    run(tmp_path, edited(comment="what it is worth"), 3)
    own = edited(**edit)
    with pytest.raises(StudyMismatch, match=named + ".*--accept-changes"):
        run(tmp_path, own, 4)
    assert len(mbtl.load_study(tmp_path / "s.db").state.picks) == 3
    study = run(tmp_path, own, 4, accept_changes=True)
    accepted = [e.data["accepted"] for e in study.log.read() if e.data.get("accepted")]
    assert len(accepted) == len(accepted[0]) == 1
    made = [row.recipe for row in study.state.rows]
    assert made[0] == made[1] == made[2] != made[3] == recipe_digest(study.state.equipment)
    run(tmp_path, own, 5)  # what was accepted once is the code of the study
    with pytest.raises(StudyMismatch, match=r"since it was last recorded .*recorded code back"):
        run(tmp_path, edited(), 6)  # so the first one, under which most was made, is a change


def test_before_anything_succeeded_code_may_be_mended_and_rows_of_ask_and_tell_have_none(
    edited, tmp_path
):
    broken = edited(score="1 / 0")
    with pytest.raises(mbtl.errors.TrainingFailed):
        run(tmp_path, broken, 2)
    study = run(tmp_path, edited(), 2)
    assert len(study.state.rows) == 2
    told = created(line(7), budget=2, bounds=(0.0, 1.0))
    told.tell(told.ask(), np.zeros(7))
    own = edited()
    told.run(own.train, own.evaluate, progress=False)
    assert len(told.state.rows) == 2


def test_a_worker_that_runs_other_code_marks_its_rows_as_of_that(edited, tmp_path):
    own = edited()
    old, new = (FunctionTrainer(o.train, o.evaluate, o.save, o.load) for o in (own, edited(0.5)))
    first = created(line(7), budget=3, bounds=(0.0, 1.0), storage=tmp_path / "s.db")
    first.equip(old)
    first.tell(first.ask(), np.zeros(7))
    second = mbtl.load_study(tmp_path / "s.db")
    second.equip(new, accept_changes=True)
    for study in (second, first):  # the first one still runs what it imported
        study.tell(study.ask(), np.zeros(7))
    made = [row.recipe for row in second.refresh().rows]
    assert made[0] == made[2] != made[1]
