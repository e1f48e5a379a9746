import numpy as np
import pytest
import quick_problem

import mbtl

BUDGET = 2


def study_at(tmp_path, name, **settings):
    settings = {"bounds": (-40.0, 0.0), "selector": "equidistant", **settings}
    return mbtl.create_study(
        quick_problem.SPACE, budget=BUDGET, storage=tmp_path / "study.db", name=name, **settings
    )


def policies(tmp_path, study):
    return tmp_path / "policies" / study.state.uid


def test_studies_of_one_database_are_listed_and_one_goes_with_its_policies(tmp_path):
    kept, gone = study_at(tmp_path, "kept", problem="mass"), study_at(tmp_path, "gone")
    for study in (kept, gone):
        study.run(trainer=quick_problem.TRAINER, progress=False)
    first, second = mbtl.list_studies(tmp_path)
    assert (first.name, first.problem, first.told, first.budget) == ("kept", "mass", 2, 2)
    assert (first.value, first.stop_reason) == (kept.value, kept.stop_reason)
    assert second.name == "gone"
    assert policies(tmp_path, gone).is_dir()
    mbtl.delete_study(tmp_path, "gone")
    assert [entry.name for entry in mbtl.list_studies(tmp_path / "study.db")] == ["kept"]
    assert not policies(tmp_path, gone).exists()
    assert len(mbtl.load_study(tmp_path).portfolio(quick_problem.TRAINER).policy(0)) == 2
    study_at(tmp_path, "gone")


def test_policies_may_stay_and_the_last_study_may_go(tmp_path):
    study = study_at(tmp_path, "one")
    study.run(trainer=quick_problem.TRAINER, progress=False)
    mbtl.delete_study(tmp_path, keep_policies=True)
    assert mbtl.list_studies(tmp_path) == []
    assert policies(tmp_path, study).is_dir()


def test_what_is_not_there_or_is_run_is_not_deleted(tmp_path):
    with pytest.raises(mbtl.StorageError, match="there is none"):
        mbtl.delete_study(tmp_path)
    study = study_at(tmp_path, "mine")
    with pytest.raises(mbtl.StudyError, match="Did you mean 'mine'"):
        mbtl.delete_study(tmp_path, "mime")
    pick = study.ask(lease=60.0)
    with pytest.raises(mbtl.StudyError, match="is run by"):
        mbtl.delete_study(tmp_path)
    study.tell(pick, np.zeros(15))
    study_at(tmp_path, "other")
    with pytest.raises(mbtl.StudyError, match="holds 2 studies"):
        mbtl.delete_study(tmp_path)
    mbtl.delete_study(tmp_path, "mine")
