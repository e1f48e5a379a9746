import json
import re

import numpy as np
import pytest

import mbtl
from flat import created
from mbtl.benchmark import TransferMatrix

SPACE = mbtl.ContextSpace.grid({mbtl.Linear("x", 0.0, 1.0, unit="m"): 12})


@pytest.fixture
def stored(tmp_path):
    """A study with one of two trainings, in its folder."""
    study = created(
        SPACE, budget=2, bounds=(0.0, 1.0), storage=tmp_path / "s" / "study.db", name="s"
    )
    tell_one(study)
    return study


def tell_one(study):
    pick = study.ask()
    study.tell(pick, 1.0 - np.abs(SPACE.unit[:, 0] - SPACE.unit[pick.source, 0]))


def test_studies_and_matrices_become_one_page(mbtl_command, tmp_path, stored):
    rows = 1.0 - np.abs(SPACE.unit - SPACE.unit.T)
    TransferMatrix.of(rows[None], space=SPACE, bounds=(0, 1)).save(tmp_path / "m.npz")
    options = ["--selector", "mbtl", "--budget", "3", "--json"]
    code, out, err = mbtl_command("report", "s", "m.npz", "-o", "new/page.html", *options)
    assert code == 0, err
    done = json.loads(out)
    text = (tmp_path / "new" / "page.html").read_text(encoding="utf-8")
    assert done["bytes"] == len(text.encode())
    assert text.count("<article") == 2
    assert "mbtl-refresh" not in text.split("<style>")[0]


def test_a_live_page_is_written_until_the_study_is_finished(
    mbtl_command, tmp_path, stored, monkeypatch
):
    pages = []

    def wait(seconds):
        pages.append((tmp_path / "report.html").read_text(encoding="utf-8"))
        tell_one(stored)

    monkeypatch.setattr("mbtl.cli.report.time.sleep", wait)
    code, _, err = mbtl_command("report", "s", "--live", "5")
    assert code == 0, err
    (first,) = pages
    last = (tmp_path / "report.html").read_text(encoding="utf-8")
    head = '<meta name="mbtl-refresh" content="5">'
    assert (head in first, head in last) == (True, False)
    assert "1 trainings, 12 contexts, under way" in first
    assert "2 trainings, 12 contexts, finished" in last


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["nothing-here"], "no study or matrix is called"),
        (["s", "-o", "page.txt"], "ends in .html"),
        (["s", "--live", "0"], "2 seconds or more"),
        (["pendulum-length", "--seed", "7"], "--seed must be from 0 to 2"),
        (["pendulum-length", "--name", "s"], "--name is of a study, and no study is given"),
        (["s", "--name", "t"], "no study is called 't'. Known: s."),
    ],
)
def test_a_mistake_costs_one_line(mbtl_command, stored, arguments, said):
    code, out, err = mbtl_command("report", *arguments)
    assert (code, out) == (2, "")
    assert said in " ".join(err.split())
    assert "Traceback" not in err


def test_a_database_of_several_studies_shows_those_that_are_named(mbtl_command, tmp_path, stored):
    for name in ("second", "third"):
        database = tmp_path / "s" / "study.db"
        tell_one(created(SPACE, budget=1, bounds=(0, 1), storage=database, name=name))
    url = f"sqlite:///{tmp_path}/s/study.db"
    code, _, err = mbtl_command("report", url)
    assert code == 2
    assert "holds 3 studies (s, second, third); choose one with --name" in " ".join(err.split())
    chosen = ["--name", "third", "--name", "s", "--json"]
    code, out, err = mbtl_command("report", url, *chosen)
    assert code == 0, err
    assert json.loads(out)["subjects"] == ["third", "s"]


def test_a_folder_without_a_study_says_what_it_holds(mbtl_command, tmp_path, stored):
    code, _, err = mbtl_command("report", ".")
    assert code == 1
    assert "give one of those below: s" in " ".join(err.split())
    (tmp_path / "matrices").mkdir()
    (tmp_path / "matrices" / "m.npz").touch()
    for command in (["report", "matrices"], ["bench", "--matrix", "matrices"]):
        code, _, err = mbtl_command(*command)
        assert code == 2
        assert "matrices is a folder; give one that it holds: m.npz" in " ".join(err.split())


def test_a_study_paid_in_steps_has_a_page_and_no_rows_to_export(mbtl_command, tmp_path):
    created(
        SPACE, cost="steps", budget=1000, bounds=(0, 1), lengths=[10], episodes=2, horizon=5,
        storage=tmp_path / "s.db",
    )  # fmt: skip
    code, out, err = mbtl_command("report", "s.db", "--json")
    assert code == 0, err
    assert json.loads(out)["subjects"] == ["study"]
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "strategy pilot, 0 of 1K steps, 0 trainings, 12 contexts, under way" in page
    code, _, err = mbtl_command("study", "export", "s.db", "rows.csv")
    assert code == 1
    assert "`mbtl report s.db` draws them" in " ".join(err.split())
    code, out, _ = mbtl_command("watch", "s.db")
    assert code == 0
    assert "0 of 1K steps were paid" in out


def test_watching_prints_the_state_once_where_there_is_no_terminal(mbtl_command, stored):
    code, out, err = mbtl_command("watch", "s")
    assert code == 0, err
    assert "1 of 2 trainings asked for" in out
    assert re.search(r"1\s+x = 0.\d+ m", out)


def test_on_a_terminal_watching_goes_on_until_the_study_ends(stored, tmp_path, monkeypatch):
    import io

    from rich.console import Console

    from mbtl.cli import watch

    screen = Console(file=io.StringIO(), force_terminal=True, width=90)
    monkeypatch.setattr(watch, "printer", lambda: screen)
    monkeypatch.setattr(watch.time, "sleep", lambda seconds: tell_one(stored))
    watch.watch(tmp_path / "s")
    text = screen.file.getvalue()
    assert "1 of 2 trainings asked for" in text
    assert "The study is finished: the budget of 2 trainings is spent." in text
