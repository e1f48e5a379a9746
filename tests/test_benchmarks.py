"""Programs outside the library are hardly run here; what they import must exist."""

import ast
import importlib
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FOLDERS = ("benchmarks", "evidence", "examples")
PROGRAMS = sorted(path for folder in FOLDERS for path in ROOT.glob(f"{folder}/*.py"))


@pytest.mark.parametrize("path", PROGRAMS, ids=lambda path: path.name)
def test_what_it_imports_exists(path):
    """Of the library, or beside the program: `python evidence/x.py` finds nothing else."""
    for node in ast.walk(ast.parse(path.read_text())):
        names = []
        if isinstance(node, ast.ImportFrom):
            names = [(node.module or "", alias.name) for alias in node.names]
        elif isinstance(node, ast.Import):
            names = [(alias.name, "") for alias in node.names]
        for module, name in names:
            if module.split(".")[0] == "mbtl" and name:
                found = pytest.importorskip(module)
                assert hasattr(found, name) or importlib.import_module(f"{module}.{name}")
            elif module in {program.stem for program in PROGRAMS}:
                beside = path.with_name(f"{module}.py")
                assert beside.exists(), f"{path.name} imports {module}, which is not beside it"
                assert re.search(rf"^(def |class )?{name}\b", beside.read_text(), re.M)


@pytest.mark.long
def test_eco_driving_plays_what_it_trains():
    """Its trainings take hours, so what comes after them is tried on a short one."""
    command = "--preset quick --axes eco-inflow --every 50 --seeds 4"
    program = [sys.executable, ROOT / "evidence" / "eco_driving.py", *command.split()]
    found = subprocess.run(program, capture_output=True, text=True)
    assert found.returncode == 0, found.stderr[-2000:]
    rows = [line.split("|")[1:3] for line in found.stdout.splitlines() if "eco-inflow:" in line]
    ways = [name.strip().removeprefix("eco-inflow: ") for name, _ in rows]
    assert ways == ["unguided", "untrained", "trained"]
    assert len({score for _, score in rows}) == 3  # three ways to drive
