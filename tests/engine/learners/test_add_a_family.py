"""The worked example of docs/add-a-family.md runs as it stands there."""

import re
from pathlib import Path

import numpy as np
import pytest

from mbtl.trainers import reference_rows
from mbtl.zoo.benchmark.build import Build

PAGE = Path(__file__).parents[3] / "docs" / "add-a-family.md"


@pytest.fixture
def problem(folder, monkeypatch):
    """What the blocks of the page define, each in the file that its first line names."""
    blocks = re.findall(r"```python\n# (\w+\.py)(.*?)```", PAGE.read_text("utf-8"), re.DOTALL)
    assert [name for name, _ in blocks] == ["cruise.py", "cruise_problem.py"]
    for name, text in blocks:
        (folder / name).write_text(f"#{text}", "utf-8")
    monkeypatch.syspath_prepend(folder)
    import cruise_problem

    return cruise_problem.problem


def test_a_family_of_one_file_is_trained_and_evaluated_on_all_contexts(problem, tmp_path):
    trainer = problem.trainer_for(timesteps=15_000, hyperparameters={"gamma": 0.9})
    contexts = problem.space.contexts
    building = Build(trainer, problem.space, 0, tmp_path, {}, ("best",), lanes=len(contexts))
    building.run()
    learnt = building.returns("best").mean(axis=2)
    rows = reference_rows(trainer, contexts, range(5))
    assert learnt.shape == (5, 5)
    assert learnt.max(axis=0).mean() > rows["unguided"].mean() + 5.0
    assert (learnt <= 0.0).all()
    assert np.isfinite(rows["random_actions"]).all()
