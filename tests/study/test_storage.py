import resource
import threading
from functools import partial

import numpy as np
import pytest

import mbtl
from flat import created
from mbtl.errors import InvalidInput, StorageError
from mbtl.study.events import Event
from mbtl.study.storage import Conflict, MemoryLog, SqlLog, study_names
from mbtl.testing.storage import EventLogContract

SPACE = mbtl.ContextSpace.grid({mbtl.Linear("x", 0.0, 1.0): 5})
SETTINGS = {"budget": 3, "strategy": "random", "load_if_exists": True}


class TestLogs(EventLogContract):
    @pytest.fixture(params=["memory", "sqlite"])
    def log(self, request, tmp_path):
        return (
            MemoryLog()
            if request.param == "memory"
            else SqlLog(tmp_path / "s.db", "a", create=True)
        )


def test_one_database_holds_many_studies(tmp_path):
    for name in ("first", "second"):
        SqlLog(tmp_path / "s.db", name, create=True).append(
            Event("created", {"name": name}), after=0
        )
    assert study_names(tmp_path / "s.db") == ["first", "second"]
    assert SqlLog(tmp_path / "s.db", "second").read()[0].data == {"name": "second"}


def test_many_writers_never_share_a_number(tmp_path):
    SqlLog(tmp_path / "s.db", "a", create=True)
    written = []

    def write(worker):
        log, done = SqlLog(tmp_path / "s.db", "a"), 0
        while done < 10:
            try:
                written.append(log.append(Event("asked", {"w": worker}), after=len(log.read())))
                done += 1
            except Conflict:
                continue

    threads = [threading.Thread(target=write, args=(w,)) for w in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(written) == list(range(1, 41))


def test_a_missing_database_is_an_error_unless_it_is_to_be_created(tmp_path):
    with pytest.raises(StorageError, match="there is none at"):
        SqlLog(tmp_path / "none.db", "a")


@pytest.mark.parametrize(
    "content", [b"this is not a database, it is prose" * 100, b"SQLite format 3\0garbage" * 99]
)
def test_a_corrupt_database_is_named(tmp_path, content):
    (tmp_path / "s.db").write_bytes(content)
    with pytest.raises(StorageError, match="corrupt or not a study database"):
        SqlLog(tmp_path / "s.db", "a")


def test_another_programs_database_is_refused(tmp_path):
    import sqlite3

    with sqlite3.connect(tmp_path / "s.db") as connection:
        connection.execute("CREATE TABLE other (x)")
    connection.close()
    with pytest.raises(StorageError, match="without mbtl studies"):
        SqlLog(tmp_path / "s.db", "a")


def test_a_place_that_cannot_be_written_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(StorageError, match="choose another"):
        SqlLog(tmp_path / "file" / "s.db", "a", create=True)


def test_an_unknown_url_is_refused():
    with pytest.raises(StorageError, match="a URL such as postgresql"):
        SqlLog("nosuchdb://x", "a", create=True)


def test_a_full_disk_loses_nothing_that_was_told(tmp_path):
    """RLIMIT_FSIZE stands in for the full disk."""
    path = tmp_path / "s.db"
    log = SqlLog(path, "a", create=True)
    log.append(Event("created", {"kept": True}), after=0)
    old = resource.getrlimit(resource.RLIMIT_FSIZE)
    noise = np.random.default_rng(0).normal(size=100_000)
    resource.setrlimit(resource.RLIMIT_FSIZE, (path.stat().st_size + 4096, old[1]))
    try:
        with pytest.raises(StorageError, match="what was told before is kept"):
            log.append(Event("told", {}, {"returns": noise}), after=1)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, old)
    assert [event.data for event in SqlLog(path, "a").read()] == [{"kept": True}]
    assert log.append(Event("told", {}, {"returns": noise}), after=1) == 2


def test_a_database_at_its_page_limit_loses_nothing(tmp_path):
    log = SqlLog(tmp_path / "s.db", "a", create=True)
    log.append(Event("created", {}), after=0)
    with log._engine.connect() as connection:
        connection.exec_driver_sql("PRAGMA max_page_count = 10")
    with pytest.raises(StorageError, match="full"):
        log.append(Event("told", {}, {"r": np.random.default_rng(0).normal(size=99_999)}), after=1)
    assert len(log.read()) == 1


@pytest.mark.parametrize("again", [mbtl.load_study, partial(mbtl.create_study, SPACE, **SETTINGS)])
def test_a_study_is_read_once_when_it_is_opened(tmp_path, monkeypatch, again):
    """A thousand rows of a million contexts take a minute each time."""
    study = created(SPACE, storage=tmp_path / "study.db", **SETTINGS)
    study.tell(study.ask(), np.zeros(5))
    read, whole = SqlLog.read, []

    def counted(log, after=0):
        found = read(log, after)
        whole.append(len(found))
        return found

    monkeypatch.setattr(SqlLog, "read", counted)
    assert len(again(storage=tmp_path / "study.db").state.rows) == 1
    assert sum(whole) == 4


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"name": "n" * 256}, "1 to 200 printable letters, got 256"),
        ({"name": ""}, "got 0"),
        ({"name": "a\x1b[31mb"}, "printable"),
        ({"storage": "n" * 256}, "got 256"),
        ({"storage": "caf\udce9/s.db"}, "written in UTF-8"),
        ({"artifacts": "caf\udce9"}, "written in UTF-8"),
        ({"artifacts": "n" * 300}, "got 300"),
    ],
)
def test_names_and_paths_that_cannot_be_are_refused_before_anything_is_made(
    tmp_path, monkeypatch, settings, words
):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InvalidInput, match=words):
        created(SPACE, budget=2, **{"storage": "s.db", **settings})
    assert list(tmp_path.iterdir()) == []


def test_a_clock_that_shows_no_date_is_refused_before_anything_is_written(tmp_path, monkeypatch):
    study = created(SPACE, budget=2, bounds=(0.0, 1.0), storage=tmp_path / "s.db")
    pick = study.ask()
    before = len(study.log.read())
    for wrong in (-86400.0, 1e12):
        monkeypatch.setattr("mbtl.study.database.time.time", lambda: wrong)  # noqa: B023
        with pytest.raises(StorageError, match=r"the clock of this machine says .*set it"):
            study.tell(pick, np.zeros(5))
        with pytest.raises(StorageError, match="the clock of this machine"):
            mbtl.create_study(SPACE, budget=2, storage=tmp_path / "new.db")
        monkeypatch.undo()
    assert len(mbtl.load_study(tmp_path / "s.db").log.read()) == before
    study.tell(pick, np.zeros(5))
