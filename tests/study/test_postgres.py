"""A study on a PostgreSQL server, which the tests start themselves where it is installed."""

import signal
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import sqlalchemy
from line_problem import line

import mbtl
from flat import created
from mbtl.errors import StorageError, Unreachable
from mbtl.study import SqlLog, StudyFinished, study_names
from mbtl.study.events import Event
from mbtl.study.storage import Conflict

SPACE = line(100)


@pytest.fixture
def postgres(server):
    return server.url


@pytest.fixture
def name(request):
    return request.node.name


@pytest.mark.parametrize("workers", [6, pytest.param(64, marks=pytest.mark.long)])
def test_many_workers_never_share_a_pick(postgres, name, workers):
    """Each has a connection of its own, and they all begin at once, with the tables to be made."""
    settings = {
        "budget": 3 * workers // 2, "bounds": (0.0, 1.0), "strategy": "random", "storage": postgres,
        "name": name, "load_if_exists": True,
    }  # fmt: skip
    begin, told, errors = threading.Barrier(workers), [], []

    def work(_):
        try:
            begin.wait()
            study = created(SPACE, **settings)
            while True:
                pick = study.ask(lease=60.0)
                if study.tell(pick, np.full(100, pick.source / 100)):
                    told.append(pick.source)
        except StudyFinished:
            pass
        except Exception as error:
            errors.append(error)

    with ThreadPoolExecutor(workers) as threads:
        list(threads.map(work, range(workers)))
    assert not errors
    assert len(told) == len(set(told)) == settings["budget"]
    study = mbtl.load_study(postgres, name)
    assert study.is_finished
    assert sorted(row.source for row in study.state.rows) == sorted(told)
    assert not [event for event in study.log.read() if event.kind == "late"]
    assert name in study_names(postgres)


def test_leases_end_by_the_clock_of_the_server(postgres, name, monkeypatch):
    made = created(SPACE, budget=3, bounds=(0.0, 1.0), storage=postgres, name=name)
    monkeypatch.setattr(time, "time", lambda: 1e9)  # of this machine, 2001
    pick = made.ask(lease=0.05)
    other = mbtl.load_study(postgres, name)
    assert abs(other.log.now() - made.state.picks[0].asked_at) < 60.0
    while not other.orphans:
        assert other.log.now() > 1.7e9
    taken = other.ask(lease=60.0)
    assert taken == pick
    assert not made.heartbeat(pick)
    assert other.heartbeat(taken)
    assert not made.tell(pick, np.zeros(100))
    assert other.tell(taken, np.ones(100))


@pytest.mark.parametrize(
    "how", [signal.SIGKILL, pytest.param(signal.SIGQUIT, marks=pytest.mark.long)]
)
def test_a_restart_of_the_server_costs_a_study_nothing(server, name, how, caplog):
    study = created(
        SPACE, budget=3, bounds=(0.0, 1.0), storage=server.url, name=name, strategy="random"
    )
    pick = study.ask(lease=60.0)
    server.stop(how)
    again = threading.Timer(0.3, server.start)
    again.start()
    assert study.tell(pick, np.ones(100))
    again.join()
    assert [row.source for row in mbtl.load_study(server.url, name).state.rows] == [pick.source]
    assert "does not answer" in caplog.text
    assert "answers again" in caplog.text


def test_an_event_is_appended_once_where_its_commit_was_not_heard_of(server, name):
    """The server wrote it, and then the connection was lost."""
    log = SqlLog(server.url, name, create=True)
    cut = []

    @sqlalchemy.event.listens_for(log._engine, "commit")
    def _write_and_lose(connection):
        if not cut:
            cut.append(True)
            connection.connection.driver_connection.commit()
            raise Unreachable("the connection was lost")

    assert log.append(Event("created", {"by": "me"}), after=0) == 1
    assert cut
    assert [event.data for event in log.read()] == [{"by": "me"}]
    cut.clear()
    with pytest.raises(Conflict):  # of somebody else, in doubt or not
        log.append(Event("created", {"by": "another"}), after=0)


def test_a_database_that_was_not_made_says_how_to_make_it(postgres):
    address = sqlalchemy.make_url(postgres).set(database="not_made")
    with pytest.raises(StorageError, match=r"no database .*not_made.* `createdb NAME`"):
        mbtl.study.list_studies(address.render_as_string(hide_password=False))


def test_a_server_that_stays_away_is_given_up_in_one_sentence_without_the_password(server, name):
    study = created(
        SPACE, budget=3, bounds=(0.0, 1.0), storage=server.url.replace("mbtl@", "mbtl:pw9@"),
        name=name,
    )  # fmt: skip
    study.log.patience.seconds = 0.2
    server.stop()
    try:
        with pytest.raises(Unreachable, match="does not answer") as caught:
            study.ask()
        assert "pw9" not in str(caught.value)
    finally:
        server.start()
    with pytest.raises(StorageError, match="does not exist") as caught:
        mbtl.load_study(server.url.replace("/postgres", "/nothing"), name)
    assert not isinstance(caught.value, Unreachable)  # nor will it be there in a minute
