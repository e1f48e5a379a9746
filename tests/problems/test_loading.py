import pytest

from mbtl.errors import InvalidInput, UnknownName
from mbtl.problems import get_cmdp, load_object, resolve_cmdp

PROBLEM = """
from mbtl.problems import CMDP
from mbtl.contexts import ContextSpace, Linear

class Inner:
    value = 7

space = ContextSpace.grid({Linear("x", 0.0, 1.0): 3})
cmdp = CMDP.from_functions(
    "mine", space, train=lambda c, s: 0, evaluate=lambda p, c, s: [0.0] * len(c)
)

def make_env(context):
    raise NotImplementedError
"""


BROKEN = {
    "broken_import": "import not_installed_at_all", "broken_sum": "1 / 0", "broken_text": "def",
    "json": "cmdp = 1",
}  # fmt: skip


@pytest.fixture
def folder(folder):
    """The working folder has a module of its own."""
    (folder / "own_problem.py").write_text(PROBLEM)
    return folder


def test_ids_and_own_problems_resolve_alike(folder):
    assert resolve_cmdp("cartpole-length").id == "cartpole-length"
    assert resolve_cmdp("own_problem:cmdp").id == "mine"
    assert load_object("own_problem:Inner.value") == 7
    assert resolve_cmdp("own_problem.py:cmdp") is resolve_cmdp("own_problem:cmdp")


def test_a_file_elsewhere_and_the_modules_beside_it(folder):
    (folder / "deep").mkdir()
    (folder / "deep" / "own_part.py").write_text("NUMBER = 41\n")
    (folder / "deep" / "other_file.py").write_text("import own_part\nANSWER = own_part.NUMBER + 1")
    assert load_object("deep/other_file.py:ANSWER") == 42


@pytest.mark.parametrize(
    ("reference", "error", "match"),
    [
        ("own_problem", InvalidInput, "named as module:attribute"),
        (":cmdp", InvalidInput, "named as module:attribute"),
        ("own_problem:", InvalidInput, "named as module:attribute"),
        ("own_problm:cmdp", InvalidInput, "no module is called 'own_problm'"),
        ("own_problem:cmpd", UnknownName, "Did you mean 'cmdp'"),
        ("nowhere.py:cmdp", InvalidInput, "no file 'nowhere.py'"),
        ("broken_import:cmdp", InvalidInput, "No module named 'not_installed_at_all'"),
        ("broken_sum:cmdp", InvalidInput, "ZeroDivisionError"),
        ("broken_text:cmdp", InvalidInput, "SyntaxError"),
        ("json.py:cmdp", InvalidInput, "rename the file"),  # an installed module has that name
    ],
)
def test_what_cannot_be_loaded_is_named(folder, reference, error, match):
    for name, code in BROKEN.items():
        (folder / f"{name}.py").write_text(code)
    with pytest.raises(error, match=match):
        load_object(reference)


def test_only_a_cmdp_is_a_cmdp(folder):
    with pytest.raises(InvalidInput, match="must be a CMDP, got a function"):
        resolve_cmdp("own_problem:make_env")
    with pytest.raises(InvalidInput, match=r"must be a CMDP, got <class .*ContextSpace"):
        resolve_cmdp("own_problem:space")
    with pytest.raises(InvalidInput, match=r"write own_problem\.py:<name>"):
        resolve_cmdp("own_problem.py")
    with pytest.raises(UnknownName, match="`mbtl cmdps` lists all"):
        resolve_cmdp("cartpole")
    assert get_cmdp("cartpole-length").id == "cartpole-length"
