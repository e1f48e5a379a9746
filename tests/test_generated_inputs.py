"""Whatever is given to commands and functions: a sentence of ours, never a traceback.

Files that were damaged: test_archive, test_checks, test_npz, test_space.

`MBTL_EXAMPLES=10000` generates so many inputs over all tests of this file; without it 120.
"""

import contextlib
import io
import json
import os
import shutil
import sys
from unittest import mock

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import mbtl
from flat import created
from mbtl.cli import main
from mbtl.faults import load_object
from mbtl.selectors import SelectionProblem
from mbtl.zoo.benchmark import TransferMatrix

TESTS = 8
EXAMPLES = int(os.environ.get("MBTL_EXAMPLES", "120"))

generated = settings(
    max_examples=max(EXAMPLES // TESTS, 1),
    deadline=None,
    derandomize="MBTL_EXAMPLES" not in os.environ,
    suppress_health_check=list(HealthCheck),
    database=None,
)

NUMBERS = st.one_of(
    st.integers(-3, 12), st.sampled_from([2**31, -(2**63), 10**400]), st.floats(width=64)
)
LETTERS = "aZ0 .,:;/\\'\"[]{}$~-_\t\n\x00\x1b\x85\u202e\u00e9\u0130\u4e00\ud800\U0001f469"
"""Of every kind that is a trouble somewhere; to know all takes seconds."""
TEXTS = st.one_of(
    st.sampled_from(["", "auto", "mbtl", "max", "..", "/etc/passwd", "a\0b", "\ud800", "x.py:y"]),
    st.text(LETTERS, max_size=8),
)
SCALARS = st.one_of(st.none(), st.booleans(), NUMBERS, TEXTS)
JSONS = st.recursive(
    SCALARS,
    lambda inner: st.one_of(
        st.lists(inner, max_size=4),
        st.dictionaries(st.text(LETTERS, max_size=4), inner, max_size=3),
    ),
    max_leaves=6,
)
ARRAYS = st.one_of(
    st.sampled_from(
        [
            np.array([]), np.zeros(()), np.full(5, np.nan), np.zeros((2, 3, 3)), np.array(["a"]),
            np.array([None]), np.array([1j]), np.zeros((1, 4, 4)) + np.inf, np.array([b"x"]),
            np.array([True]), np.array(["2020"], dtype="M8[s]"), np.eye(3, dtype=np.int8)[None],
        ]
    ),
    st.lists(st.floats(), max_size=5).map(np.array),
)  # fmt: skip
ANY = st.one_of(
    JSONS, ARRAYS, st.sampled_from([object(), 1j, b"x", int, len, range(3), np.float32(2), {1, 2}])
)
SPACE = mbtl.ContextSpace.grid({mbtl.Linear("x", 0.0, 1.0): 5})


def ours(call):
    """Errors of ours are what is wanted, each with a message; any other is a failure."""
    said = "nothing was refused"
    try:
        call()
    except mbtl.MbtlError as error:
        said = str(error)
    assert said.strip()
    assert "Traceback" not in said


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A study and a matrix, to be copied for commands."""
    folder = tmp_path_factory.mktemp("made")
    study = created(SPACE, budget=2, bounds=(0.0, 1.0), storage=folder / "study.db")
    study.tell(study.ask(), np.linspace(0.0, 1.0, 5))
    TransferMatrix.of(np.eye(5)[None], bounds=(0, 1)).save(folder / "matrix.npz")
    return folder


MANY = mbtl.ContextSpace.grid(
    {
        mbtl.Log("mass", 0.1, 10.0, unit="kg"): 3,
        mbtl.Integer("n", 1, 3): 3,
        mbtl.Categorical("kind", ("a", "b")): 2,
    }
)


@generated
@given(context=st.dictionaries(TEXTS, SCALARS, max_size=3))
def test_contexts(context):
    ours(lambda: MANY.index({"mass": 1.0, "n": 1, "kind": "a", **context}))


NAMES = st.one_of(
    TEXTS,
    st.tuples(TEXTS | st.sampled_from(["json", "mbtl", "os.path", "."]), TEXTS).map(":".join),
    st.sampled_from(["json:", ":x", "json:loads.x", "..:x", "a b:c", "x.py:", "json.nope:x", "::"]),
)


@generated
@given(name=NAMES)
def test_names_of_own_objects(name):
    for read in (load_object, mbtl.selectors.get_selector):
        with mock.patch.object(sys, "path", list(sys.path)):
            ours(lambda read=read: read(name))


SETTINGS = (
    "budget", "strategy", "bounds", "direction", "objective", "evaluation", "stopping", "seed",
    "stop_value", "cost_budget", "costs", "risk", "eval_targets", "stop_left", "stop_confidence",
    "best_return", "theta", "trial",
)  # fmt: skip
LIKELY = {
    "budget": st.integers(1, 5),
    "bounds": st.sampled_from([(0.0, 1.0), (1, 0), (0, np.inf), mbtl.Bounds(0, 1, floor=0.5)]),
    "strategy": st.sampled_from(["random", "greedy", "auto", "all-first", "one-policy"]),
}


@generated
@given(data=st.data())
def test_settings_of_a_study(data):
    chosen = data.draw(st.lists(st.sampled_from(SETTINGS), max_size=3, unique=True))
    wishes = {"budget": 3, "strategy": "random"}
    wishes |= {name: data.draw(LIKELY.get(name, ANY) | ANY) for name in chosen}
    if callable(wishes.get("costs")):
        wishes.pop("costs", None)  # a user's own function may raise what it likes
    if "costs" in wishes:
        wishes.setdefault("cost_budget", 9.0)

    def used():
        study = created(SPACE, **wishes)
        study.tell(study.ask(), np.linspace(0.0, 1.0, 5), targets=None)
        study.ask()

    ours(used)


@generated
@given(total=ANY | st.integers(1, 10**6), unit=ANY | st.integers(1, 1000), horizon=ANY)
def test_budgets_in_steps(total, unit, horizon):
    def used():
        budget = mbtl.Steps(total, unit, horizon)
        study = mbtl.create_study(SPACE, budget=budget, strategy="all-first")
        study.tell(study.ask(), np.linspace(0.0, 1.0, 5))
        study.extend(mbtl.Steps(2 * total))
        study.ask()

    ours(used)


@generated
@given(pick=ANY, returns=ANY, targets=st.none() | ANY, cost=st.none() | ANY, seconds=ANY, n=ANY)
def test_asking_and_telling(pick, returns, targets, cost, seconds, n):
    study = mbtl.create_study(SPACE, budget=3, strategy="random")
    ours(lambda: study.ask(n))
    ours(lambda: study.ask(lease=cost))
    ours(lambda: study.tell(pick, returns, targets=targets, cost=cost))
    ours(lambda: study.tell(1, np.zeros(5), cost=cost, seconds=seconds, steps=n))
    for attempt in (study.release, study.pick, study.retry, study.extend):
        ours(lambda attempt=attempt: attempt(pick))
    ours(lambda: study.void(pick, "wrong"))
    ours(lambda: study.fail(study.ask(), targets))


@generated
@given(data=st.data())
def test_axes_spaces_and_problems(data):
    low, high, count = (data.draw(ANY) for _ in range(3))
    grid, name = mbtl.ContextSpace.grid, data.draw(TEXTS)
    for kind in (mbtl.Linear, mbtl.Log, mbtl.Integer):
        ours(lambda kind=kind: grid({kind(name, low, high): count}))
        ours(lambda kind=kind: grid({kind("x", 1, 3): count}))
    ours(lambda: mbtl.Categorical("kind", low))
    ours(lambda: mbtl.Bounds(low, high, count))
    ours(lambda: SelectionProblem.of(SPACE, budget=low, theta=high, risk=count))


@generated
@given(data=st.data())
def test_matrices_and_comparisons(data):
    ours(lambda: TransferMatrix.of(data.draw(ARRAYS | ANY), bounds=data.draw(st.none() | ANY)))
    ours(lambda: mbtl.load_matrix(data.draw(TEXTS), data.draw(TEXTS)))
    matrix = TransferMatrix.of(np.eye(4)[None], bounds=(0, 1))
    names, budget = data.draw(st.lists(TEXTS, max_size=2)), data.draw(ANY)
    ours(lambda: mbtl.compare(names, [matrix], budget=2, seeds=1))
    ours(lambda: mbtl.compare(["random"], [matrix], budget=budget, seeds=1))


OPTIONS = (
    "--json", "--help", "--name", "--budget", "--seeds", "--matrix", "--selectors", "--bounds",
    "--seed", "--study", "--risk", "--out", "--variant", "--nope", "-x",
)  # fmt: skip
COMMANDS = (
    ("study", "list"), ("study", "show"), ("study", "export"), ("cmdps",), ("matrix", "show"),
    ("bench",), ("report",), ("run", "no-such-cmdp"), ("check", "nope.py:x"), ("play",),
    ("matrix",), (), ("study",), ("matrix", "import"),
)  # fmt: skip
WORDS = st.one_of(
    st.sampled_from(OPTIONS),
    st.sampled_from(
        ["study.db", "matrix.npz", "portfolio", ".", "out.json", "out.csv", "random", "0,1", "3"]
    ),
    TEXTS.map(lambda text: text.encode("utf-8", "replace").decode().replace("\0", "")),
    st.integers(-2, 4).map(str),
)


@generated
@given(command=st.sampled_from(COMMANDS), words=st.lists(WORDS, max_size=5))
def test_commands(made, tmp_path_factory, command, words):
    folder = tmp_path_factory.mktemp("command")
    for name in ("study.db", "matrix.npz"):
        shutil.copyfile(made / name, folder / name)
    arguments = ["mbtl", *command, *words]
    out, code = io.StringIO(), 0
    with (
        contextlib.chdir(folder),
        contextlib.redirect_stdout(out), contextlib.redirect_stderr(io.StringIO()),
        mock.patch.object(sys, "argv", arguments), mock.patch.object(sys, "path", list(sys.path)),
    ):  # fmt: skip
        try:
            main()
        except SystemExit as stop:
            code = stop.code or 0
    assert code in (0, 1, 2)
    if code == 0 and "--json" in words and "--help" not in words:
        json.loads(out.getvalue())
    shutil.rmtree(folder)
