"""Three wings, and in each of them data flows one way: a layer imports only those above it."""

import ast
import functools
import graphlib
import importlib
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import mbtl
from mbtl import provider

ROOT = Path(mbtl.__file__).parent
WINGS = ("engine", "zoo")
"""Folders of two wings; everything else is the tool."""
TOOL = [
    "errors", "faults", "plain", "version", "arrays", "canvas", "settings",
    "processes", "files", "provider", "seeds", "contexts", "objective", "score", "history",
    "episodes", "models", "routing", "acquisition", "selectors", "strategies", "portfolio", "envs",
    "trainers", "study", "problems", "sumo", "randomisation", "plot", "report", "testing", "cli",
]  # fmt: skip
ENGINE = [
    "engine.scene", "engine.worlds", "engine.simulators", "engine.learners",
    "engine.lazy", "engine.world_trainer", "engine.traced",
]  # fmt: skip
ZOO = [
    "zoo.worlds", "zoo.cmdps", "zoo.small", "zoo.benchmark", "zoo.reproduction", "zoo.cli",
    "zoo.provider",
]  # fmt: skip
ORDER = [*TOOL, *ENGINE, *ZOO]
"""The zoo may use the engine and the tool, the engine the tool, the tool neither."""
HEAVY = {"torch", "jax", "sklearn", "gymnasium", "stable_baselines3", "matplotlib", "typer", "rich"}
HEAVY |= {"sumo", "libsumo", "traci", "sumolib"}


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


@functools.cache
def statements(path):
    """Imports of a module, those for type checkers too."""
    found, left = [], [ast.parse(path.read_text())]
    while left:
        node = left.pop()
        if isinstance(node, ast.Import | ast.ImportFrom):
            found.append(node)
        inner = (ast.stmt, ast.ExceptHandler, ast.match_case)
        left += [one for one in ast.iter_child_nodes(node) if isinstance(one, inner)]
    return found


@functools.cache
def imports(path):
    """(module, name) of every import of our own.

    A module that is imported by `from package import module` has no name.
    """
    found = []
    for node in statements(path):
        if isinstance(node, ast.Import):
            found += [(a.name, None) for a in node.names if a.name.startswith("mbtl.")]
        elif isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "mbtl":
            for alias in node.names:
                full = f"{node.module}.{alias.name}"
                found.append((full, None) if full in EVERY else (node.module, alias.name))
    return found


def test_every_folder_has_a_place():
    assert {layer_of(name_of(path)[5:]) for path in modules()} - set(WINGS) == {*ORDER}


def test_imports_point_up():
    wrong = set()
    for path in modules():
        layer = layer_of(name_of(path)[5:])
        for module, _ in imports(path):
            other = layer_of(module[5:])
            if module == "mbtl":  # the package itself shows what is in it
                fine = layer in (*WINGS, *ZOO, "cli")
            elif layer in WINGS or other in WINGS:
                fine = other.split(".")[0] == layer.split(".")[0] or layer in ZOO
            else:
                fine = other == layer or other in ORDER[: ORDER.index(layer)]
            if not fine:
                wrong.add(f"{name_of(path)} must not import {module}")
    assert not wrong


PUBLIC = (
    "acquisition", "canvas", "contexts", "envs.references", "envs.rollout", "envs.slots", "errors",
    "history", "models", "objective", "plot", "portfolio", "problems", "randomisation", "report",
    "routing", "score", "seeds", "selectors", "strategies", "study", "sumo", "trainers",
    "trainers.contract",
)  # fmt: skip
"""Modules of the tool that the API reference documents, with an `__all__`."""
NOT_PUBLIC = {
    "arrays, and those that many share": "arrays.Array arrays.Indices arrays.unwritable",
    "commands of the zoo look, print and end like the tool's": (
        "cli.adapt.context_of cli.common.JsonFlag cli.common.LongWork cli.common.console "
        "cli.common.interruptible cli.common.print_json cli.common.printer"
    ),
    "its pictures have the tool's look": ("plot.style.edges plot.style.new_figure"),
    "files are written whole, claimed by one process and read from strangers by one rule": (
        "files.claim_of files.claimed_folder files.whole_file files.MALFORMED "
        "files.read_arrays files.read_json portfolio.archive.MANIFEST"
    ),
    "input is checked, and refused in the same words": (
        "plain.LARGEST plain.array_of plain.finite plain.floats plain.real plain.refused "
        "plain.short plain.whole"
    ),
    "processes and threads are counted and ended by one rule": (
        "processes.native_threads processes.threads_for processes.usable_cores "
        "processes.separate_workers processes.SeparateWorkers"
    ),
    "the provenance of matrices compares settings and names the version": (
        "settings.first_difference version.__version__ version.installed"
    ),
    "`mbtl play` acts with a policy as trainers do": "trainers.sb3_learning.actor_for",
}
"""Reason -> what the engine and the zoo use of the tool though no user is told of it."""


def home_of(module, name):
    """The public module that shows a name; None: none does."""
    parts = module.split(".")
    for end in range(len(parts), 1, -1):
        shown = ".".join(parts[:end])
        found = importlib.import_module(shown)
        if shown[5:] in PUBLIC and name in found.__all__:
            same = getattr(found, name) is getattr(importlib.import_module(module), name)
            return shown if same else None
    return None


def test_the_other_wings_use_what_is_public_but_for_a_list():
    used = {
        f"{module[5:]}.{name}"
        for path in modules()
        if layer_of(name_of(path)[5:]) in (*WINGS, *ENGINE, *ZOO)
        for module, name in imports(path)
        if module.split(".")[1:] and module.split(".")[1] not in WINGS
        if not (module[5:] in PUBLIC if name is None else home_of(module, name))
    }
    listed = [name for names in NOT_PUBLIC.values() for name in names.split()]
    assert used == {*listed}
    assert len(listed) == len({*listed})


@pytest.mark.parametrize("module", PUBLIC)
def test_what_is_public_is_documented(module):
    folder = ROOT.parents[1] / "docs" / "api"
    lines = [line for page in folder.glob("*.md") for line in page.read_text().splitlines()]
    shown = {line.split(":: mbtl.")[-1] for line in lines if line.startswith(".. auto")}
    shown |= {*re.findall(r"`mbtl\.([\w.]+)`", "\n".join(lines))}
    whole = [module, module.rpartition(".")[0]] if "." in module else [module]
    for one in {*whole} & shown:
        shown |= {*importlib.import_module(f"mbtl.{one}").__all__}
    known = importlib.import_module(f"mbtl.{module}").__all__
    assert not [name for name in known if not {name, f"{module}.{name}"} & shown]


def test_nothing_is_called_utils():
    assert not [path for path in modules() if path.stem == "utils"]


def test_no_modules_import_each_other_in_a_circle():
    """In functions and for type checkers, too.

    A package that is imported by name alone stands for what its `__init__` re-exports.
    """
    sorter = graphlib.TopologicalSorter()
    for path in modules():
        sorter.add(name_of(path), *({one for one, _ in imports(path)} - {name_of(path), "mbtl"}))
    sorter.prepare()  # raises CycleError, which names one


def test_importing_mbtl_is_light_changes_nothing_and_loads_neither_of_the_other_wings():
    program = (
        "import numpy, os, sys, warnings; before = dict(os.environ), list(warnings.filters);"
        "import mbtl; assert before == (dict(os.environ), list(warnings.filters));"
        "print(*sys.modules); mbtl.plot.curve"
    )
    loaded = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    ).stdout.split()
    assert not HEAVY & {name.split(".")[0] for name in loaded}
    ours = {name.split(".")[1] for name in loaded if name.startswith("mbtl.")}
    assert ours.isdisjoint({*WINGS, "sumo"})


def test_the_metadata_declare_the_provider_that_source_trees_use():
    project = tomllib.loads((ROOT.parents[1] / "pyproject.toml").read_text())["project"]
    assert project["entry-points"][provider.GROUP] == {"zoo": provider._BESIDE}


def test_no_word_of_the_tool_leads_to_another_wing_but_the_provider():
    """Names of modules in strings count as imports, in documentation they do not."""
    named = {
        f"{name_of(path)}: {word}"
        for path in modules()
        if layer_of(name_of(path)[5:]) in TOOL
        for word in re.findall(r'"(mbtl\.(?:engine|zoo)[\w.]*(?::\w+)?)"', path.read_text())
    }
    assert named == {"mbtl.provider: mbtl.zoo.provider"}


def test_type_checkers_see_every_public_name():
    """Those that are imported when they are asked for stand in the block for type checkers."""
    tree = ast.parse((ROOT / "__init__.py").read_text())
    imported = {
        alias.name: getattr(importlib.import_module(node.module), alias.name)
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and node.module.startswith("mbtl")
        for alias in node.names
    }
    for name in mbtl.__all__:
        assert imported[name] is getattr(mbtl, name)
    assert len(mbtl.__all__) <= 40
