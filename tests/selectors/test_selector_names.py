import sys

import pytest

from mbtl.errors import InvalidInput, UnknownName
from mbtl.selectors import get_selector

OWN = """
from mbtl.selectors import Proposal


class Lowest:
    name = "lowest"

    def __init__(self, step=1):
        self.step = step

    def propose(self, problem, history, rng):
        taken = {*history.sources, *history.pending, *history.failed}
        return Proposal(min(set(range(0, problem.n, self.step)) - taken), "lowest left")


class NeedsMore:
    name = "needs-more"

    def __init__(self, number):
        raise NotImplementedError


SECOND = Lowest(2)
NOTHING = 3
"""


@pytest.fixture
def file(tmp_path, monkeypatch):
    """A file with selectors, its module forgotten afterwards."""
    monkeypatch.setattr(sys, "path", list(sys.path))
    path = tmp_path / "own_selectors.py"
    path.write_text(OWN)
    yield str(path)
    sys.modules.pop("own_selectors", None)


def test_a_class_in_a_file_and_a_selector_made_there_are_both_found(file):
    assert get_selector(f"{file}:Lowest").step == 1
    assert get_selector(f"{file}:SECOND").step == 2
    assert get_selector("mbtl.selectors:Random").name == "random"


@pytest.mark.parametrize(
    ("name", "error", "match"),
    [
        ("NOTHING", InvalidInput, "must be a selector"),
        ("NeedsMore", InvalidInput, "without arguments"),
        ("Lowst", UnknownName, "Did you mean 'Lowest'"),
    ],
)
def test_what_is_no_selector_is_refused_in_one_sentence(file, name, error, match):
    with pytest.raises(error, match=match):
        get_selector(f"{file}:{name}")
