import io
import json
import sqlite3
import sys

import numpy as np
import pytest

import mbtl
from flat import created, told
from mbtl.objective import Bounds
from mbtl.portfolio import Portfolio
from mbtl.zoo.cli.play import _opened

SPACE = mbtl.ContextSpace.grid({mbtl.Linear("mass", 1.0, 3.0): 3})


@pytest.fixture
def place(tmp_path):
    """A folder whose database holds two studies, and one beside it that holds one."""
    for folder, name, picks in (("a", "first", 1), ("a", "the second", 2), ("b", "study", 1)):
        database = tmp_path / "runs" / folder / "study.db"
        study = created(SPACE, budget=2, bounds=(0, 4), storage=database, name=name)
        told(study, lambda source, level=float(picks): np.full(3, level), picks)
    return tmp_path / "runs"


def test_list_shows_every_study_of_every_database(mbtl_command, place):
    rows = mbtl_command.document("study", "list")
    found = [(row["study"], row["name"], row["told"]) for row in rows]
    assert found == [("runs/a", "first", 1), ("runs/a", "the second", 2), ("runs/b", "study", 1)]
    out = mbtl_command.done("study", "list")
    assert "runs/a --name 'the second'" in out
    assert "runs/b --name" not in out
    assert len(mbtl_command.document("study", "list", place / "a/study.db")) == 2
    (place / "b" / "study.db").rename(place / "b" / "mine.db")
    (place / "thumbs.db").write_text("of another program")
    sqlite3.connect(place / "b" / "other.db").execute("CREATE TABLE other (a)").connection.close()
    code, out, err = mbtl_command("study", "list", "--json")
    assert [row["study"] for row in json.loads(out)] == ["runs/a", "runs/a", "runs/b/mine.db"]
    assert (code, err) == (0, "")


def test_list_takes_the_address_of_a_database(mbtl_command, place):
    url = f"sqlite:///{place}/a/study.db"
    found = [(row["study"], row["name"]) for row in mbtl_command.document("study", "list", url)]
    assert found == [(url, "first"), (url, "the second")]
    nowhere = f"sqlite:///{place}/none.db"
    assert "there is none at" in mbtl_command.refusal("study", "list", nowhere, code=1)


@pytest.mark.parametrize("command", [("show",), ("export", "rows.json")])
def test_one_of_several_studies_is_chosen_by_its_name(mbtl_command, place, tmp_path, command):
    verb, *file = command
    one = ("study", verb, "runs/a", *file)
    words = "holds 2 studies (first, the second); choose one with name= (--name)"
    assert words in mbtl_command.refusal(*one)
    document = mbtl_command.document(*one, "--name", "the second")
    assert len(document["picks"]) == 2 if verb == "show" else document["rows"] == 2
    assert "Did you mean 'first'?" in mbtl_command.refusal(*one, "--name", "frist")


def test_a_damaged_study_gets_one_line_and_hides_no_other(mbtl_command, place):
    with sqlite3.connect(place / "a" / "study.db") as connection:
        connection.execute("UPDATE mbtl_events SET data = '{' WHERE study = 'first' AND seq = 3")
    connection.close()
    first = ("study", "show", "runs/a", "--name", "first")
    assert "event 3 of the study is damaged" in mbtl_command.refusal(*first, code=1)
    _, out, err = mbtl_command("study", "list", "--json")
    assert [row["name"] for row in json.loads(out)] == ["the second", "study"]
    assert "event 3 of the study is damaged" in " ".join(err.split())


def test_trust_reaches_the_policies_that_are_played(tmp_path):
    portfolio = Portfolio(SPACE, (0,), np.ones((1, 3)), Bounds(0, 1), cmdp="ring-acc")
    folder = portfolio.save(tmp_path / "p", allow_missing=True)
    for trust in (True, False):
        played, cmdp, _ = _opened(str(folder), None, None, trust)
        assert (played.trust, cmdp.id) == (trust, "ring-acc")


@pytest.mark.parametrize("console", ["cp437", "cp1252", "latin-1", "ascii"])
def test_letters_that_a_console_lacks_are_escaped_and_end_nothing(
    mbtl_command, monkeypatch, tmp_path, console
):
    space = mbtl.ContextSpace.grid({mbtl.Linear("\u03b8\u4e00", 0.0, 1.0, "\u00b5m"): 3})
    mbtl.create_study(space, budget=1, storage=tmp_path / "study.db").tell(0, np.arange(3.0))
    out = io.TextIOWrapper(io.BytesIO(), encoding=console)
    monkeypatch.setattr(sys, "stdout", out)
    code, _, err = mbtl_command("study", "show", tmp_path)
    out.flush()
    shown = out.buffer.getvalue().decode(console)
    assert (code, err) == (0, "")
    assert "\\u03b8\\u4e00 = 0" in shown
