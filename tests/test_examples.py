"""The examples run as they stand, and do what their text says."""

import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[1] / "examples"
NEEDS = {"own_sumo_network": ("sumo", "libsumo", "stable_baselines3")}


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.py")), ids=lambda p: p.stem)
def test_an_example_runs(path, tmp_path):
    for package in NEEDS.get(path.stem, ()):
        pytest.importorskip(package)
    done = subprocess.run([sys.executable, path], capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout


def test_an_example_is_short():
    for path in EXAMPLES.glob("*.py"):
        assert sum(bool(line.strip()) for line in path.read_text().splitlines()) < 60, path.name


def test_the_readme_example_is_valid_and_small():
    readme = (EXAMPLES.parent / "README.md").read_text()
    code = readme.split("```python\n# my_problem.py")[1].split("```")[0]
    compile(code, "my_problem.py", "exec")
    assert len([line for line in code.splitlines() if line.strip()]) <= 18
