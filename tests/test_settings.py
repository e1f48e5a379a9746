"""Settings are compared by value: two records differ by the first setting that does, at any depth,
and functions and objects by what they are made of."""

import ast
import dataclasses
import functools
import importlib
import json
import math
import os
import subprocess
import sys
import types
from pathlib import Path

import numpy as np
import pytest

import mbtl.settings
from mbtl.settings import described, described_code, digest, first_difference

OLD = {"seed": 1, "recipe": {"steps": 5, "sizes": [4, 4]}, "note": None}


def test_equal_records_have_no_difference():
    assert first_difference(OLD, dict(reversed(OLD.items()))) is None
    assert first_difference(OLD, {k: v for k, v in OLD.items() if k != "note"}) is None


@pytest.mark.parametrize(
    ("change", "difference"),
    [
        ({"seed": 2}, ("seed", 1, 2)),
        ({"recipe": {"steps": 5, "sizes": [4]}}, ("recipe.sizes", [4, 4], [4])),
        ({"recipe": {"steps": 5}}, ("recipe.sizes", [4, 4], None)),
        ({"recipe": 7}, ("recipe", OLD["recipe"], 7)),
        ({"recipe": {**OLD["recipe"], "new": None}, "note": "x"}, ("note", None, "x")),
        ({"more": 1}, ("more", None, 1)),
    ],
)
def test_the_first_difference_is_named_with_both_values(change, difference):
    assert first_difference(OLD, {**OLD, **change}) == difference


# ---- values ------------------------------------------------------------------------------------


def falling(first):
    def rate(left):
        return first * left

    return rate


def sinking(first):
    def other_name(left):
        return first * left  # the same, said elsewhere

    return other_name


def scaled(first, left):
    return first * left


@dataclasses.dataclass(frozen=True)
class Steps:
    at: tuple[float, ...]
    cache: dict = dataclasses.field(default_factory=dict, compare=False)

    def __call__(self, left):
        return self.at[int(left)]


class Noise:
    """As Stable-Baselines3's: attributes, some of them hidden."""

    def __init__(self, sigma):
        self._sigma = np.full(3, sigma)
        self._itself = self


SAME = [
    (3e-4, np.float64(3e-4)),
    (np.float32(0.5), 0.5),
    (np.arange(3), [0, 1, 2]),
    ({"a": 1, "b": 2}, {"b": 2, "a": 1}),
    ({"x", "y", "z"}, {"z", "y", "x"}),
    (falling(1e-3), sinking(np.float64(1e-3))),
    (lambda left, k=2: k * left, lambda left, k=2: k * left),
    (functools.partial(scaled, 1e-3), functools.partial(scaled, 1e-3)),
    (Noise(0.1), Noise(0.1)),
    (Steps((1.0, 0.5), {"a": 1}), Steps((1.0, 0.5))),
    (np.zeros(1000), np.zeros(1000)),
    (math.nan, float("nan")),
]
DIFFERENT = [
    (np.float32(3e-4), 3e-4),
    (falling(1e-3), falling(0.3)),
    (lambda left: 1e-3 * left, lambda left: 0.3 * left),
    (lambda left, k=2: k * left, lambda left, k=3: k * left),
    (lambda left, *, k=2: k * left, lambda left, *, k=3: k * left),
    (lambda left: left**2, lambda left: left**3),
    (falling((0.1, 0.2)), falling((0.1, 0.3))),
    (functools.partial(scaled, 1e-3), functools.partial(scaled, 0.3)),
    (functools.partial(scaled, first=1e-3), functools.partial(scaled, first=0.3)),
    (functools.partial(scaled, 1.0), functools.partial(falling, 1.0)),
    (Noise(0.1), Noise(0.2)),
    (Noise(0.1)._sigma, Noise(0.1)._sigma.astype(int)),
    (Steps((1.0, 0.5)), Steps((1.0, 0.25))),
    (np.zeros(1000), np.eye(1, 1000)[0]),
    (Steps, Noise),
    (math.inf, 1e308),
    (len, max),
    (json.dumps, json.loads),
]


@pytest.mark.parametrize(("one", "other"), SAME)
def test_equal_values_have_one_description(one, other):
    assert first_difference({"it": described(one)}, {"it": described(other)}) is None


@pytest.mark.parametrize(("one", "other"), DIFFERENT)
def test_other_values_have_another_description(one, other):
    assert first_difference({"it": described(one)}, {"it": described(other)}) is not None


def test_a_difference_says_which_value_a_schedule_holds():
    was, now = ({"rate": described(falling(first))} for first in (1e-3, 0.3))
    assert first_difference(was, now) == ("rate.first", 1e-3, 0.3)


OWN = """
import functools
import numpy as np
RATE, TABLE, PLACE, CALLS = 0.1, {{"k": (1, 2)}}, {place!r}, []
def deeper(x, power={power}):
    {docstring}
    return {deeper} * x**power
class World:
    gravity = 9.8
    def step(self, x):
        return deeper(x) + self.gravity + TABLE["k"][0]
def make_env(context, size=3):
    global CALLS
    CALLS = [*CALLS, context]
    return World(), PLACE, np.float32(RATE)
def schedule(left):
    return RATE * left
VALUES = {{"a": schedule, "b": functools.partial(schedule, left=np.float64(0.5)),
          "c": {{"q", "r", "s"}}, "d": lambda left: left in {{"u", "v", "w"}}}}
if __name__ == "__main__":
    import json
    from mbtl.settings import described, described_code
    print(json.dumps([described(VALUES), described_code(make_env)]))
"""


def own_module(folder, name, **changes):
    filled = {"place": "/tmp/one", "docstring": "pass", "deeper": "2.0", "power": 1, **changes}
    (folder / f"{name}.py").write_text(OWN.format(**filled))
    sys.path.insert(0, str(folder))
    try:
        importlib.invalidate_caches()
        return importlib.import_module(name)
    finally:
        sys.path.remove(str(folder))
        sys.modules.pop(name, None)


def test_descriptions_are_the_same_in_every_process_and_by_whatever_name(tmp_path):
    module = own_module(tmp_path, "described_module")
    here = json.loads(json.dumps([described(module.VALUES), described_code(module.make_env)]))
    assert here[1].keys() == {"code", "size", "World", "deeper", "RATE", "TABLE", "PLACE"}
    package = str(Path(mbtl.settings.__file__).parents[1])
    said = subprocess.run(
        [sys.executable, tmp_path / "described_module.py"], text=True, check=True,
        env={**os.environ, "PYTHONHASHSEED": "1", "PYTHONPATH": package}, capture_output=True,
    ).stdout  # fmt: skip
    assert json.loads(said) == here


def test_what_own_code_uses_of_its_module_counts_and_where_it_writes_does_not(tmp_path):
    was = described_code(own_module(tmp_path, "own_was").make_env)
    docstring = own_module(tmp_path, "own_said", docstring='"""Twice."""', place="/tmp/two")
    assert described_code(docstring.make_env) == was
    module = own_module(tmp_path, "own_now", deeper="2.5")
    assert first_difference(was, described_code(module.make_env))[0] == "deeper.code"
    module = own_module(tmp_path, "own_power", power=2)
    assert first_difference(was, described_code(module.make_env)) == ("deeper.power", 1, 2)
    module = own_module(tmp_path, "own_rate")
    module.RATE = 0.3
    assert first_difference(was, described_code(module.make_env)) == ("RATE", 0.1, 0.3)
    module = own_module(tmp_path, "own_class")
    module.World.gravity = 1.6
    assert first_difference(was, described_code(module.make_env))[0] == "World"


class Maker:
    """A factory that counts, as many do."""

    everything = []  # noqa: RUF012

    def __init__(self, gravity):
        self.gravity, self.made = gravity, 0

    def __call__(self, context):
        self.made += 1
        self.everything.append(context)


def test_what_code_counts_while_it_runs_is_no_change():
    calls, make = [], Maker(9.8)

    def trainer():
        def train(context, seed):
            calls.append(context)

        return train

    train = trainer()
    was = described_code(train), described_code(make)
    for _ in range(3):
        train({}, 0)
        make({})
    assert (described_code(train), described_code(make)) == was
    assert described_code(trainer()) == was[0]
    assert was[1]["gravity"] == 9.8 != described_code(Maker(1.6))["gravity"]


def test_code_of_packages_is_known_by_its_name_alone():
    assert described_code(json.dumps) is None
    held = {"function": "dumps", "args": [[1]], "indent": 2}
    assert described_code(functools.partial(json.dumps, [1], indent=2)) == held
    assert described(json.dumps) == {"function": "json.dumps"}


def test_neither_layout_nor_comments_nor_docstrings_change_the_digest_of_code(tmp_path):
    """Of all functions of this package, written anew by Python's own printer."""
    compared, digests = 0, set()
    for file in sorted(Path(mbtl.settings.__file__).parent.glob("*.py")):
        tree = ast.parse(file.read_text(encoding="utf-8"))
        for node in ast.walk(tree):
            if isinstance(node, ast.Module | ast.FunctionDef | ast.ClassDef) and (
                ast.get_docstring(node) is not None
            ):
                node.body = node.body[1:] or [ast.Pass()]
        printed = tmp_path / file.name
        printed.write_text(ast.unparse(tree), encoding="utf-8")
        one, other = (
            compile(place.read_text(encoding="utf-8"), str(place), "exec")
            for place in (file, printed)
        )
        pairs = list(zip(functions_of(one), functions_of(other), strict=True))
        assert [a.co_qualname for a, b in pairs if digest(a) != digest(b)] == []
        compared += len(pairs)
        digests |= {digest(a) for a, _ in pairs}
    assert compared > 200
    assert len(digests) > 0.9 * compared


def test_code_whose_source_is_nowhere_has_a_name_alone():
    spaces = {}
    for power in (2, 3):
        exec(f"def typed(x):\n    return x**{power}", space := {})
        spaces[power] = digest(space["typed"].__code__)
    assert spaces[2] == spaces[3]


def functions_of(code):
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            if constant.co_flags & 1 and constant.co_name not in ANONYMOUS:
                yield constant  # a function, not the body of a class
            yield from functions_of(constant)


ANONYMOUS = ("<genexpr>", "<listcomp>", "<setcomp>", "<dictcomp>")
"""Functions that Python makes of what is part of others."""
