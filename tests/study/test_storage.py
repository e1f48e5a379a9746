"""The event log and its database: what is stored, refused, and listed."""

import resource
import sqlite3

import numpy as np
import pytest
from line_problem import TRAINER, line

import mbtl
from flat import created
from mbtl.errors import InvalidInput, StorageError
from mbtl.study.events import Event
from mbtl.study.storage import Conflict, MemoryLog, SqlLog, study_names

SPACE = line(5)


@pytest.fixture
def log(storage, request):
    """Empty and new."""
    return MemoryLog() if storage is None else SqlLog(storage, request.node.name, create=True)


def test_events_come_back_numbered_and_whole(log):
    """What is read is what was appended."""
    row = np.array([1.5, np.pi, -1e300])
    assert log.append(Event("created", {"a": [1, "x", None, 0.1]}), after=0) == 1
    assert log.append(Event("told", {"source": 3}, {"returns": row}), after=1) == 2
    first, second = log.read()
    assert (first.seq, first.kind, first.data) == (1, "created", {"a": [1, "x", None, 0.1]})
    assert (second.seq, second.kind) == (2, "told")
    assert np.array_equal(second.arrays["returns"], row)
    assert second.time >= first.time > 0


def test_reading_goes_on_after_a_number(log):
    """A follower reads only what is new."""
    for i in range(5):
        log.append(Event("created", {"i": i}), after=i)
    assert [event.data["i"] for event in log.read(3)] == [3, 4]
    assert list(log.read(5)) == []


def test_the_last_heartbeat_of_each_lease_is_kept(log):
    """By the clock that stamps the events."""
    assert dict(log.beats()) == {}
    log.append(Event("created", {}), after=0)
    log.beat("a", 5.0)
    log.beat("b", 5.0)
    log.beat("a", 50.0)
    now, beats = log.now(), log.beats()
    assert set(beats) == {"a", "b"}
    assert beats["a"] > beats["b"] > log.read()[0].time
    assert now - 10.0 < beats["a"] - 50.0 <= now


def test_a_late_append_conflicts_and_changes_nothing(log):
    """Who appends second has to look again."""
    log.append(Event("created", {}), after=0)
    for stale in (0, 2, 7):
        with pytest.raises(Conflict):
            log.append(Event("asked", {"lost": True}), after=stale)
    assert [event.kind for event in log.read()] == ["created"]


def test_what_is_no_database_of_ours_is_named(tmp_path):
    (tmp_path / "prose").write_bytes(b"this is not a database, it is prose" * 100)
    (tmp_path / "garbage").write_bytes(b"SQLite format 3\0garbage" * 99)
    with sqlite3.connect(tmp_path / "other") as connection:
        connection.execute("CREATE TABLE other (x)")
    connection.close()
    for place, words in (
        (tmp_path / "none.db", "there is none at"),
        (tmp_path / "prose", "corrupt or not a study database"),
        (tmp_path / "garbage", "corrupt or not a study database"),
        (tmp_path / "other", "without mbtl studies"),
        (tmp_path, r"is a folder; give .*study\.db"),
        ("nosuchdb://x", "a URL such as postgresql"),
        ("psql://me:secret@host/x", "a URL such as postgresql"),
        ("mysql+nothing://me:secret@host/x", "a URL such as postgresql"),
        ("postgresql://me:secret@host:port/x", "a URL such as postgresql"),
    ):
        with pytest.raises(StorageError, match=words) as caught:
            SqlLog(place, "a")
        assert "secret" not in str(caught.value)
    with pytest.raises(StorageError, match="choose another"):
        SqlLog(tmp_path / "prose" / "s.db", "a", create=True)


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


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"name": "n" * 256}, "1 to 200 printable letters, got 256"),
        ({"name": ""}, "got 0"),
        ({"name": "a\x1b[31mb"}, "printable"),
        ({"storage": "n" * 256}, "got 256"),
        ({"storage": ":memory:"}, "leave it out"),
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


def study_at(folder, name, **settings):
    settings = {"budget": 2, "bounds": (0.0, 1.0), "strategy": "equidistant", **settings}
    return created(SPACE, storage=folder / "study.db", name=name, **settings)


def test_studies_of_one_database_are_listed(tmp_path):
    run, begun = study_at(tmp_path, "run", problem="mass"), study_at(tmp_path, "begun")
    run.run(trainer=TRAINER, progress=False, report=False)
    for place in (tmp_path, tmp_path / "study.db"):
        first, second = mbtl.study.list_studies(place)
        assert (first.name, first.problem, first.told, first.budget) == ("run", "mass", 2, 2)
        assert (first.value, first.stop_reason) == (run.value, run.stop_reason)
        assert (second.name, second.told, second.value) == ("begun", 0, None)
    for name, said in ((None, "holds 2 studies"), ("beg", "Did you mean 'begun'")):
        with pytest.raises(mbtl.errors.InvalidInput, match=said):
            mbtl.load_study(tmp_path, name)
    assert not begun.state.picks


def test_a_driver_that_is_missing_is_named_with_its_fix(monkeypatch):
    def missing(*args, **kwargs):
        raise ModuleNotFoundError("No module named 'psycopg'", name="psycopg")

    monkeypatch.setattr("sqlalchemy.create_engine", missing)
    with pytest.raises(mbtl.errors.MissingExtra, match=r"pip install 'mbtl\[cluster\]'") as caught:
        mbtl.load_study("postgresql+psycopg://me:secret@host/x")
    assert "secret" not in str(caught.value)


def test_a_folder_without_a_database_names_the_studies_below(tmp_path):
    (tmp_path / "a").mkdir()
    study_at(tmp_path / "a", "one")
    with pytest.raises(mbtl.StorageError, match=r"one of those below: .*/a$"):
        mbtl.load_study(tmp_path)


def test_a_study_is_deleted_with_its_policies_unless_somebody_runs_it(tmp_path):
    kept, gone = study_at(tmp_path, "kept"), study_at(tmp_path, "gone")
    for study in (kept, gone):
        study.run(trainer=TRAINER, progress=False, report=False)
    policies = [tmp_path / "policies" / study.state.uid for study in (kept, gone)]
    assert [place.is_dir() for place in policies] == [True, True]
    with pytest.raises(InvalidInput, match="holds 2 studies"):
        mbtl.study.delete_study(tmp_path)
    mbtl.study.delete_study(tmp_path, "gone")
    assert study_names(tmp_path / "study.db") == ["kept"]
    assert [place.is_dir() for place in policies] == [True, False]
    study_at(tmp_path, "open").ask(lease=60.0)
    with pytest.raises(mbtl.StudyError, match="is run by"):
        mbtl.study.delete_study(tmp_path, "open")


def test_a_study_that_was_deleted_meanwhile_says_so(tmp_path):
    study = study_at(tmp_path, "kept")
    study.tell(study.ask(), np.zeros(study.space.n))
    mbtl.study.delete_study(tmp_path)
    with pytest.raises(mbtl.StudyError, match="the study 'kept' is gone: it was deleted"):
        study.ask()


def test_a_study_that_is_deleted_while_they_are_listed_is_left_out(tmp_path, monkeypatch):
    study_at(tmp_path, "kept")
    monkeypatch.setattr("mbtl.study.listing.study_names", lambda address: ["gone", "kept"])
    assert [entry.name for entry in mbtl.study.list_studies(tmp_path)] == ["kept"]
