"""Three wings, and in each of them data flows one way: a layer imports only those above it."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import mbtl

ROOT = Path(mbtl.__file__).parent
WINGS = ("engine", "zoo")
"""Folders of two wings; everything else is the tool."""
TOOL = [
    "errors",
    "faults",
    "score",
    "plain",
    "version",
    "arrays",
    "notebook",
    "settings",
    "processes",
    "threads",
    "provenance",
    "untrusted",
    "files",
    "loading",
    "laboratory",
    "seeds",
    "contexts",
    "objective",
    "history",
    "episodes",
    "models",
    "routing",
    "acquisition",
    "selectors",
    "strategies",
    "portfolio",
    "envs",
    "trainers",
    "study",
    "problems",
    "plot",
    "report",
    "testing",
    "cli",
]
ENGINE = [
    "engine.checkpoints",
    "engine.elsewhere",
    "engine.worlds",
    "engine.scene",
    "engine.simulators",
    "engine.learners",
    "engine.lazy",
    "engine.world_trainer",
]
ZOO = [
    "zoo.worlds",
    "zoo.cmdps",
    "zoo.actions",
    "zoo.benchmark",
    "zoo.reproduction",
    "zoo.cli",
    "zoo.provider",
]
ORDER = [*TOOL, *ENGINE, *ZOO]
"""The zoo may use the engine and the tool, the engine the tool, the tool neither."""
HEAVY = {"torch", "jax", "sklearn", "gymnasium", "stable_baselines3", "matplotlib", "typer", "rich"}


def name_of(path):
    parts = ["mbtl", *path.relative_to(ROOT).with_suffix("").parts]
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


EVERY = {name_of(path) for path in ROOT.rglob("*.py")}


def modules():
    return [path for path in ROOT.rglob("*.py") if path.parent != ROOT or path.stem != "__init__"]


def layer_of(name):
    """The entry of `ORDER` that a module belongs to, by its dotted name without "mbtl."."""
    parts = name.split(".")
    return ".".join(parts[: 2 if parts[0] in WINGS else 1])


def running(path):
    """Every node of a module that runs at some time; blocks for type checkers do not."""
    tree = ast.parse(path.read_text())
    for block in [n for n in ast.walk(tree) if isinstance(n, ast.If)]:
        if "TYPE_CHECKING" in ast.dump(block.test):
            block.body = [ast.Pass()]
    return ast.walk(tree)


def imports(path):
    """(module, name) of every import of our own, those for type checkers, too.

    A module that is imported by `from package import module` has no name.
    """
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from ((a.name, None) for a in node.names if a.name.startswith("mbtl."))
        elif isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "mbtl":
            for alias in node.names:
                full = f"{node.module}.{alias.name}"
                yield (full, None) if full in EVERY else (node.module, alias.name)


def test_every_folder_has_a_place():
    assert {layer_of(name_of(path)[5:]) for path in modules()} - set(WINGS) == {*ORDER}


@pytest.mark.parametrize("path", modules(), ids=lambda p: str(p.relative_to(ROOT)))
def test_imports_point_up(path):
    layer = layer_of(name_of(path)[5:])
    for module, _ in imports(path):
        if module == "mbtl":
            assert layer in (*WINGS, *ZOO, "cli"), f"{layer} must not import the whole of mbtl"
            continue
        imported = layer_of(module[5:])
        if imported == layer:
            continue
        if layer in WINGS or imported in WINGS:  # the package itself shows what is in it
            assert imported.split(".")[0] == layer.split(".")[0] or layer in ZOO
            continue
        assert imported in ORDER[: ORDER.index(layer)], f"{layer} must not import {imported}"


def test_nothing_is_called_utils():
    assert not [path for path in modules() if path.stem == "utils"]


def graph():
    """Module -> modules it imports, in functions too; what is for type checkers does not count.

    A package that is imported by name alone stands for what its `__init__` re-exports.
    """
    every = {name_of(path): path for path in ROOT.rglob("*.py") if path.parent != ROOT}
    every |= {name_of(path): path for path in ROOT.glob("*.py") if path.stem != "__init__"}
    edges = {}
    for name, path in every.items():
        found = set()
        for node in running(path):
            if isinstance(node, ast.Import):
                found |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
                one = {f"{node.module}.{alias.name}" for alias in node.names}
                found |= {full if full in every else node.module for full in one}
        edges[name] = (found & every.keys()) - {name}
    return edges


def circles(edges):
    """Sets of modules that reach each other."""
    reach = {}
    for start in edges:
        seen, left = set(), [*edges[start]]
        while left:
            if (one := left.pop()) not in seen:
                seen.add(one)
                left += edges[one]
        reach[start] = seen
    return {frozenset(b for b in reach[a] if a in reach[b]) for a in reach if a in reach[a]}


def test_no_modules_import_each_other_in_a_circle():
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"b"}}) == {frozenset("bc")}
    assert not circles(graph())


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
    assert len(mbtl.__all__) <= 40


def test_pictures_are_at_hand_and_loaded_only_when_asked_for():
    program = "import sys, mbtl; assert 'matplotlib' not in sys.modules; print(mbtl.plot.curve)"
    subprocess.run([sys.executable, "-c", program], check=True, capture_output=True)
