"""Studies written by every released version still open; one file per version, made by

python tests/study/test_old_logs.py tests/assets/study-<version>.db
"""

import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

import mbtl

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


if __name__ == "__main__":
    space = mbtl.ContextSpace.grid({mbtl.Linear("mass", 1.0, 9.0, unit="kg"): 9})
    made = mbtl.create_study(space, budget=5, bounds=(0.0, 9.0), storage=sys.argv[1])
    made.tell(made.ask(), np.full(9, 7.0))
    made.tell(made.ask(), np.full((9, 2), 8.0))
    made.fail(made.ask(), "diverged")
