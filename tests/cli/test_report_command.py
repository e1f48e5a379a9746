import re

import numpy as np
import pytest

import mbtl
from flat import created, told
from mbtl.trainers import FunctionTrainer
from mbtl.zoo.benchmark import TransferMatrix

SPACE = mbtl.ContextSpace.grid({mbtl.Linear("x", 0.0, 1.0, unit="m"): 12})


@pytest.fixture
def stored(tmp_path):
    """A study with one of two trainings, in its folder."""
    database = tmp_path / "s" / "study.db"
    return told(created(SPACE, budget=2, bounds=(0, 1), storage=database, name="s"), near)


def near(source):
    return 1.0 - np.abs(SPACE.unit[:, 0] - SPACE.unit[source, 0])


def test_studies_and_matrices_become_one_page(mbtl_command, tmp_path, stored):
    rows = 1.0 - np.abs(SPACE.unit - SPACE.unit.T)
    TransferMatrix.of(rows[None], space=SPACE, bounds=(0, 1)).save(tmp_path / "m.npz")
    options = ["--selector", "mbtl", "--budget", "3", "-o", "new/page.html"]
    done = mbtl_command.document("report", "s", "m.npz", *options)
    text = (tmp_path / "new" / "page.html").read_text(encoding="utf-8")
    assert done["bytes"] == len(text.encode())
    assert text.count("<article") == 2
    assert "1 training, 12 contexts, under way" in text


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["nothing-here"], "no study or matrix is called"),
        (["s", "-o", "page.txt"], "ends in .html"),
        (["pendulum-length", "--seed", "7"], "--seed must be from 0 to 2"),
        (["pendulum-length", "--selector", "auto"], "a matrix holds specialists alone, and 'auto'"),
        (["pendulum-length", "--name", "s", "--budget", "1"], "--name is of a study, and no study"),
        (["s", "--name", "t"], "no study is called 't'. Known: s."),
    ],
)
def test_a_mistake_costs_one_line(mbtl_command, stored, arguments, said):
    assert said in mbtl_command.refusal("report", *arguments)


def test_a_database_of_several_studies_shows_those_that_are_named(mbtl_command, tmp_path, stored):
    for name in ("second", "third"):
        database = tmp_path / "s" / "study.db"
        told(created(SPACE, budget=1, bounds=(0, 1), storage=database, name=name), near)
    url = f"sqlite:///{tmp_path}/s/study.db"
    words = "holds 3 studies (s, second, third); choose one with name= (--name)"
    assert words in mbtl_command.refusal("report", url)
    chosen = mbtl_command.document("report", url, "--name", "third", "--name", "s")
    assert chosen["subjects"] == ["third", "s"]


def test_a_study_paid_in_steps_says_what_was_spent_on_what(mbtl_command, tmp_path):
    paid = mbtl.create_study(
        SPACE, budget=mbtl.Steps(1000, unit=100, horizon=5), strategy="all-first",
        objective=mbtl.Objective(bounds=(0.0, 1.0)), storage=tmp_path / "s.db",
    )  # fmt: skip
    paid.equip(FunctionTrainer(lambda contexts, seed, *, start=None, length=None: 0, max))
    everyone = paid.ask()
    paid.tell(everyone, np.full(12, 0.5), steps=90, evaluation_steps=55)
    paid.tell(paid.ask(), np.full(12, 0.6), steps=100, evaluation_steps=45)
    out = mbtl_command.done("study", "show", "s.db")
    assert "all-first, 1K steps, N = 12" in out
    assert re.search(r"1\s+all contexts", out)
    said = " ".join(out.split())
    assert "Spent: 290 of 1K steps: 190 on trainings, 100 on evaluation." in said
    (listed,) = mbtl_command.document("study", "list", "s.db")
    assert (listed["spent"], listed["steps_spent"]) == ("290 of 1K steps", 290.0)
    mbtl_command.done("report", "s.db", "--json")
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "<td>all contexts</td>" in page
    mbtl_command.done("study", "export", "s.db", "rows.csv")
    lines = (tmp_path / "rows.csv").read_text().splitlines()
    assert lines[0] == ("policy,sources,start,length,source_x,target,target_x,return,std,episodes")
    assert lines[1].startswith("0,0 1 2 3 4 5 6 7 8 9 10 11,,1.0,,0,")
    assert len(lines) == 1 + 2 * 12
