"""A study notices that a user's functions were edited, and goes on only where that is accepted."""

import importlib
import sys

import numpy as np
import pytest
from line_problem import SPACE

import mbtl
from flat import created, ran
from mbtl.errors import StudyMismatch
from mbtl.trainers.contract import FunctionTrainer, recipe_digest

OWN = """
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
        text = OWN.format(gain=gain, score=score, comment=comment)
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
    study = created(SPACE, budget=budget, bounds=(0.0, 1.0), **settings)
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


def test_before_anything_succeeded_code_may_be_mended_and_rows_of_ask_and_tell_have_none(
    edited, tmp_path
):
    broken = edited(score="1 / 0")
    with pytest.raises(mbtl.errors.TrainingFailed):
        run(tmp_path, broken, 2)
    study = run(tmp_path, edited(), 2)
    assert len(study.state.rows) == 2
    told = created(SPACE, budget=2, bounds=(0.0, 1.0))
    told.tell(told.ask(), np.zeros(7))
    own = edited()
    told.run(own.train, own.evaluate, progress=False)
    assert len(told.state.rows) == 2


def test_a_worker_that_runs_other_code_marks_its_rows_as_of_that(edited, tmp_path):
    own = edited()
    old, new = (FunctionTrainer(o.train, o.evaluate, o.save, o.load) for o in (own, edited(0.5)))
    first = created(SPACE, budget=3, bounds=(0.0, 1.0), storage=tmp_path / "s.db")
    first.equip(old)
    first.tell(first.ask(), np.zeros(7))
    second = mbtl.load_study(tmp_path / "s.db")
    second.equip(new, accept_changes=True)
    for study in (second, first):  # the first one still runs what it imported
        study.tell(study.ask(), np.zeros(7))
    made = [row.recipe for row in second.refresh().rows]
    assert made[0] == made[2] != made[1]
