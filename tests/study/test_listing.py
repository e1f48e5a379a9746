import pytest
import quick_problem

import mbtl
from flat import created

BUDGET = 2


def study_at(tmp_path, name, **settings):
    settings = {"bounds": (-40.0, 0.0), "strategy": "equidistant", **settings}
    return created(
        quick_problem.SPACE, budget=BUDGET, storage=tmp_path / "study.db", name=name, **settings
    )


def test_studies_of_one_database_are_listed(tmp_path):
    run, begun = study_at(tmp_path, "run", problem="mass"), study_at(tmp_path, "begun")
    run.run(trainer=quick_problem.TRAINER, progress=False, report=False)
    for place in (tmp_path, tmp_path / "study.db"):
        first, second = mbtl.study.list_studies(place)
        assert (first.name, first.problem, first.told, first.budget) == ("run", "mass", 2, 2)
        assert (first.value, first.stop_reason) == (run.value, run.stop_reason)
        assert (second.name, second.told, second.value) == ("begun", 0, None)
    for name, said in ((None, "holds 2 studies"), ("beg", "Did you mean 'begun'")):
        with pytest.raises(mbtl.errors.InvalidInput, match=said):
            mbtl.load_study(tmp_path, name)
    assert not begun.state.picks


def test_a_driver_that_is_missing_is_named_with_its_fix(monkeypatch):
    def missing(*args, **kwargs):
        raise ModuleNotFoundError("No module named 'psycopg'", name="psycopg")

    monkeypatch.setattr("sqlalchemy.create_engine", missing)
    with pytest.raises(mbtl.errors.MissingExtra, match=r"pip install 'mbtl\[cluster\]'") as caught:
        mbtl.load_study("postgresql+psycopg://me:secret@host/x")
    assert "secret" not in str(caught.value)


def test_a_folder_without_a_database_names_the_studies_below(tmp_path):
    (tmp_path / "a").mkdir()
    study_at(tmp_path / "a", "one")
    with pytest.raises(mbtl.StorageError, match=r"one of those below: .*/a$"):
        mbtl.load_study(tmp_path)


def test_a_larger_budget_is_known_to_be_raised(tmp_path):
    study_at(tmp_path, "one")
    study = created(
        quick_problem.SPACE, budget=4, bounds=(-40.0, 0.0), strategy="equidistant",
        storage=tmp_path / "study.db", name="one", load_if_exists=True,
    )  # fmt: skip
    assert (study.spec.budget, study.state.first_budget) == (4, BUDGET)
    study.extend(5)
    assert mbtl.load_study(tmp_path).state.first_budget == BUDGET
