"""Data flows one way: each layer imports only those above it, and the core nothing outside it."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import mbtl

ROOT = Path(mbtl.__file__).parent
CORE = [
    "errors",
    "version",
    "arrays",
    "settings",
    "processes",
    "elsewhere",
    "provenance",
    "untrusted",
    "files",
    "loading",
    "seeds",
    "contexts",
    "objective",
    "checkpoints",
    "trainer",
    "history",
    "models",
    "routing",
    "acquisition",
    "theory",
    "selectors",
    "portfolio",
    "study",
]
OUTSIDE = {
    "worlds": set(),
    "envs": set(),
    "training": {"worlds", "envs"},
    "plot": set(),
    "benchmark": {"plot"},
    "cmdps": {"training", "worlds", "envs"},
    "report": {"benchmark", "plot"},
    "testing": {"cmdps", "training", "worlds", "envs"},
    "cli": {"training", "envs", "benchmark", "cmdps", "plot", "report"},
}
LAZY = {("portfolio", "training")}  # a saved Stable-Baselines3 policy is read by its adapter
HEAVY = {"torch", "jax", "sklearn", "gymnasium", "stable_baselines3", "matplotlib", "typer", "rich"}


def modules():
    return [path for path in ROOT.rglob("*.py") if path.parent != ROOT or path.stem != "__init__"]


def layer_of(path):
    return path.relative_to(ROOT).parts[0].removesuffix(".py")


def imports(path):
    """(layer, at module level) of every import of our own; type-checking blocks do not run."""
    tree = ast.parse(path.read_text())
    for block in [n for n in ast.walk(tree) if isinstance(n, ast.If)]:
        if "TYPE_CHECKING" in ast.dump(block.test):
            block.body = [ast.Pass()]
    for top in tree.body:
        for node in ast.walk(top):
            names = []
            if isinstance(node, ast.ImportFrom) and node.module:
                names = (
                    [node.module]
                    if node.module != "mbtl"
                    else [f"mbtl.{a.name}" for a in node.names]
                )
            elif isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            for name in names:
                if name.startswith("mbtl."):
                    yield name.split(".")[1], top is node


def test_every_folder_has_a_place():
    assert {layer_of(path) for path in modules()} - {"__init__"} == {*CORE, *OUTSIDE}


@pytest.mark.parametrize("path", modules(), ids=lambda p: str(p.relative_to(ROOT)))
def test_imports_point_up(path):
    layer = layer_of(path)
    for imported, _ in imports(path):
        if imported == layer:
            continue
        if layer in CORE:
            allowed = set(CORE[: CORE.index(layer)]) | {b for a, b in LAZY if a == layer}
        else:
            allowed = {*CORE, *OUTSIDE[layer]}
        assert imported in allowed, f"{layer} must not import {imported}"


@pytest.mark.parametrize("path", modules(), ids=lambda p: str(p.relative_to(ROOT)))
def test_no_module_outgrows_one_idea(path):
    assert len(path.read_text().splitlines()) <= 400
    assert path.stem != "utils"


def test_importing_mbtl_is_light_and_changes_nothing():
    program = (
        "import numpy, os, sys, warnings; before = dict(os.environ), list(warnings.filters);"
        "import mbtl; assert before == (dict(os.environ), list(warnings.filters));"
        "print(' '.join({m.split('.')[0] for m in sys.modules}))"
    )
    loaded = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    ).stdout.split()
    assert not HEAVY & set(loaded)


def test_all_public_names_exist():
    for name in mbtl.__all__:
        assert getattr(mbtl, name) is not None
    assert len(mbtl.__all__) <= 25
