import numpy as np
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


def policies(tmp_path, study):
    return tmp_path / "policies" / study.state.uid


def test_studies_of_one_database_are_listed_and_one_goes_with_its_policies(tmp_path):
    kept, gone = study_at(tmp_path, "kept", problem="mass"), study_at(tmp_path, "gone")
    for study in (kept, gone):
        study.run(trainer=quick_problem.TRAINER, progress=False)
    first, second = mbtl.study.list_studies(tmp_path)
    assert (first.name, first.problem, first.told, first.budget) == ("kept", "mass", 2, 2)
    assert (first.value, first.stop_reason) == (kept.value, kept.stop_reason)
    assert second.name == "gone"
    assert policies(tmp_path, gone).is_dir()
    mbtl.study.delete_study(tmp_path, "gone")
    assert [entry.name for entry in mbtl.study.list_studies(tmp_path / "study.db")] == ["kept"]
    assert not policies(tmp_path, gone).exists()
    assert len(mbtl.load_study(tmp_path).portfolio(quick_problem.TRAINER).policy(0)) == 2
    study_at(tmp_path, "gone")


def test_policies_may_stay_and_the_last_study_may_go(tmp_path):
    study = study_at(tmp_path, "one")
    study.run(trainer=quick_problem.TRAINER, progress=False)
    mbtl.study.delete_study(tmp_path, keep_policies=True)
    assert mbtl.study.list_studies(tmp_path) == []
    assert policies(tmp_path, study).is_dir()


def test_what_is_not_there_or_is_run_is_not_deleted(tmp_path):
    with pytest.raises(mbtl.StorageError, match="there is none"):
        mbtl.study.delete_study(tmp_path)
    study = study_at(tmp_path, "mine")
    with pytest.raises(mbtl.errors.InvalidInput, match="Did you mean 'mine'"):
        mbtl.study.delete_study(tmp_path, "mime")
    pick = study.ask(lease=60.0)
    with pytest.raises(mbtl.StudyError, match="is run by"):
        mbtl.study.delete_study(tmp_path)
    study.tell(pick, np.zeros(15))
    study_at(tmp_path, "other")
    with pytest.raises(mbtl.errors.InvalidInput, match="holds 2 studies"):
        mbtl.study.delete_study(tmp_path)
    mbtl.study.delete_study(tmp_path, "mine")


def test_what_is_not_a_database_is_said_without_the_password():
    for url, said in (
        ("psql://me:secret@host/x", "a URL such as postgresql"),
        ("mysql+nothing://me:secret@host/x", "a URL such as postgresql"),
    ):
        with pytest.raises(mbtl.StorageError, match=said) as caught:
            mbtl.load_study(url)
        assert "secret" not in str(caught.value)


def test_a_driver_that_is_missing_is_named_with_its_fix(monkeypatch):
    def missing(*args, **kwargs):
        raise ModuleNotFoundError("No module named 'psycopg'", name="psycopg")

    monkeypatch.setattr("sqlalchemy.create_engine", missing)
    with pytest.raises(mbtl.errors.MissingExtra, match=r"pip install 'mbtl\[cluster\]'") as caught:
        mbtl.load_study("postgresql+psycopg://me:secret@host/x")
    assert "secret" not in str(caught.value)


def test_a_folder_is_no_database_and_names_the_studies_below(tmp_path):
    with pytest.raises(mbtl.StorageError, match=r"is a folder; give .*study\.db"):
        mbtl.create_study(quick_problem.SPACE, budget=1, storage=tmp_path)
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
