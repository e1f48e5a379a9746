"""The notebooks run from top to bottom, and hold no outputs."""

import json

import blocks
import pytest

NOTEBOOKS = sorted((blocks.ROOT / "docs" / "notebooks").glob("*.ipynb"))


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs_and_holds_no_outputs(path, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    known = {"__name__": path.stem}
    for number, cell in enumerate(json.loads(path.read_text())["cells"]):
        assert not cell.get("outputs")
        assert cell.get("execution_count") is None
        if cell["cell_type"] == "code":
            exec(compile("".join(cell["source"]), f"{path.name}, cell {number}", "exec"), known)
