"""Studies written by every released version still open; one file per version, made by

python tests/study/test_old_logs.py tests/assets/study-<version>.db
"""

import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

import mbtl
from mbtl.trainer import FunctionTrainer

ASSETS = Path(__file__).parents[1] / "assets"


@pytest.mark.parametrize("path", sorted(ASSETS.glob("study-*.db")), ids=lambda p: p.stem)
def test_a_study_of_an_older_version_opens_and_goes_on(path, tmp_path):
    shutil.copy(path, tmp_path / "study.db")
    study = mbtl.load_study(tmp_path)
    assert [pick.source for pick in study.state.picks] == [4, 0, 1]
    assert [failure.reason for failure in study.state.failures] == ["diverged"]
    assert study.curve == pytest.approx([7 / 9, 8 / 9])
    assert study.space.values("mass") == [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0]
    pick = study.ask()
    study.tell(pick, np.full(9, 9.0))
    assert study.value == pytest.approx(1.0)


def test_there_is_a_log_to_open():
    assert list(ASSETS.glob("study-*.db"))


# ---- of version 0.1, before leases: a pick belonged to a process ------------------------------

SMALL = mbtl.ContextSpace.grid({mbtl.Linear("x", 0.0, 1.0): 7})


def trainer(trained):
    return FunctionTrainer(
        lambda context, seed: trained.append(context["x"]) or np.array([context["x"]]),
        lambda policy, contexts, seeds: [1 - abs(c["x"] - policy[0]) for c in contexts],
        lambda policy, folder: np.save(folder / "x.npy", policy),
        lambda folder: np.load(folder / "x.npy"),
    )


def opened(name, tmp_path):
    shutil.copytree(ASSETS / "0.1" / name, tmp_path / name)
    return mbtl.load_study(tmp_path / name)


def test_a_finished_study_of_0_1_gives_its_portfolio(tmp_path):
    study = opened("done", tmp_path)
    assert study.is_finished
    assert study.state.fresh is not None
    assert study.space == SMALL
    portfolio = study.portfolio(trainer([]))
    for i, row in enumerate(study.state.rows):
        assert portfolio.policy(i) == pytest.approx([SMALL.context(row.source)["x"]])


def test_a_study_of_0_1_whose_process_was_killed_goes_on_from_the_saved_policy(tmp_path):
    study, trained = opened("left", tmp_path), []
    assert study.orphans == [2]
    sources = [pick.source for pick in study.state.picks]
    study.run(trainer=trainer(trained))
    assert study.is_finished
    assert len(trained) == 1  # the fourth; the third was saved and only evaluated
    assert [pick.source for pick in study.state.picks][:3] == sources
    assert len(study.portfolio(trainer([])).policies_missing) == 0


def test_a_study_of_0_1_with_every_kind_of_event_goes_on(tmp_path):
    study = opened("hand", tmp_path)
    assert (study.spec.budget, len(study.state.rows), len(study.state.failures)) == (6, 2, 1)
    again = study.ask()
    assert again.number == 2  # it had been given back
    assert study.tell(again, np.full((7, 2), 0.75))
    study.run(trainer=trainer([]), report=False)
    assert study.is_finished
    assert len(study.state.picks) == 6


if __name__ == "__main__":
    space = mbtl.ContextSpace.grid({mbtl.Linear("mass", 1.0, 9.0, unit="kg"): 9})
    made = mbtl.create_study(space, budget=5, bounds=(0.0, 9.0), storage=sys.argv[1])
    made.tell(made.ask(), np.full(9, 7.0))
    made.tell(made.ask(), np.full((9, 2), 8.0))
    made.fail(made.ask(), "diverged")
