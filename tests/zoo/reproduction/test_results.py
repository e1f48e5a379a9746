"""Tables in two formats, results that are kept, and an item that fails."""

import csv
import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import mbtl
from mbtl.zoo.benchmark import TransferMatrix, save_shipped
from mbtl.zoo.reproduction import Bench, Item, Setting, perform
from mbtl.zoo.reproduction.item import Measured, Table
from mbtl.zoo.reproduction.page import made_from, write_index

ID = "cartpole-length"
PAGE = Path(mbtl.__file__).parents[2] / "docs" / "reproduction.md"


@pytest.fixture
def bench(tmp_path):
    save_shipped(TransferMatrix.of(np.eye(5)[None], bounds=(0, 1)), tmp_path / "matrices", ID)
    return Bench(Setting((ID,), 3, "default", tmp_path / "matrices"))


def counting(counter, name="counted", number=1):
    def compute(bench):
        counter.append(name)
        return {"of": len(bench.available()), "missing": ["something: not there"]}

    def tables(numbers):
        return {"": Table("Counted.", ("n",), ((numbers["of"],),))}

    return Item(number, name, "Counting", compute, tables)


def failing(bench):
    raise ZeroDivisionError("of course")


def test_one_table_in_two_formats():
    table = Table(
        "100 % of a_b | c",
        ("CMDP", "V_K"),
        (("a|b*", Measured(0.5, 0.01, True)), ("x & y", Measured(0.25)), ("z", None)),
        ("A note.",),
    )
    head, rule, *rows = table.markdown().splitlines()[2:]
    assert (head, rule) == (r"| CMDP | V\_K |", "|---|---:|")
    assert rows[:3] == [r"| a\|b\* | **0.5000** (0.0100) |", "| x & y | 0.2500 |", "| z | - |"]
    cells = list(csv.reader(io.StringIO(table.csv())))
    assert cells[0] == ["CMDP", "V_K mean", "V_K std", "V_K marked"]
    assert cells[1:] == [["a|b*", "0.5", "0.01", "1"], ["x & y", "0.25", "", "0"],
                         ["z", "", "", ""]]  # fmt: skip


def test_what_is_finished_is_kept_until_its_matrices_change(bench, tmp_path):
    done = []
    (first,) = perform([counting(done)], bench, tmp_path / "out")
    assert (first.status, first.missing) == ("done", ("something: not there",))
    again = Bench(bench.setting)
    (kept,) = perform([counting(done)], again, tmp_path / "out")
    assert (kept.status, kept.files, done) == ("kept", first.files, ["counted"])
    (tmp_path / "out" / kept.files[-1]).unlink()  # somebody tidied up
    assert perform([counting(done)], again, tmp_path / "out")[0].status == "done"
    save_shipped(TransferMatrix.of(np.ones((1, 5, 5)), bounds=(0, 1)), bench.setting.folder, ID)
    (changed,) = perform([counting(done)], Bench(bench.setting), tmp_path / "out")
    assert changed.status == "done"
    assert perform([counting(done)], again, tmp_path / "out", again=True)[0].status == "done"


def test_an_item_that_fails_leaves_the_results_of_the_others(bench, tmp_path):
    done = []
    bad = replace(counting(done, "bad", 2), compute=failing)
    items = [counting(done, "one", 1), bad, counting(done, "three", 3)]
    outcomes = perform(items, bench, tmp_path)
    assert [outcome.status for outcome in outcomes] == ["done", "failed", "done"]
    assert outcomes[1].error == "ZeroDivisionError: of course"
    assert "in failing" in (tmp_path / "02-bad.error.txt").read_text()
    write_index(tmp_path / "README.md", outcomes, [])
    text = (tmp_path / "README.md").read_text()
    assert "Failed: ZeroDivisionError" in text
    assert "not available: something: not there" in text
    assert "tables/03-three.csv" in text
    mended = [items[0], counting(done, "bad", 2), items[2]]
    assert [o.status for o in perform(mended, bench, tmp_path)] == ["kept", "done", "kept"]
    assert not (tmp_path / "02-bad.error.txt").exists()


def test_the_page_is_of_the_shipped_matrices():
    marks = made_from(Bench()).strip()
    assert marks in PAGE.read_text(encoding="utf-8"), (
        "docs/reproduction.md is older than the shipped matrices; write it again with: "
        "mbtl reproduce --page docs/reproduction.md"
    )
