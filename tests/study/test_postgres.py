"""A study on a PostgreSQL server, which the tests start themselves where it is installed."""

import os
import pwd
import shutil
import signal
import socket
import subprocess
import threading
import time
from pathlib import Path

import numpy as np
import pytest

import mbtl
from mbtl.study import SqlLog, StudyFinished, study_names
from mbtl.testing.storage import EventLogContract

SPACE = mbtl.ContextSpace.grid({mbtl.Linear("x", 0.0, 1.0): 100})


def server_program(name):
    """On the path, or where Debian keeps it."""
    found = sorted(Path("/usr/lib/postgresql").glob(f"*/bin/{name}"))
    return str(found[-1]) if found else shutil.which(name)


@pytest.fixture(scope="session")
def postgres(tmp_path_factory):
    """URL of an empty server of this test run, on a port of its own."""
    pytest.importorskip("psycopg")
    initdb, program = server_program("initdb"), server_program("postgres")
    if initdb is None or program is None:
        pytest.skip("PostgreSQL is not installed here")
    user = {}
    if os.geteuid() == 0:  # the server refuses to run as root
        try:
            owner = pwd.getpwnam("postgres")
        except KeyError:
            pytest.skip("PostgreSQL does not run as root, and there is no user postgres")
        user = {"user": owner.pw_uid, "group": owner.pw_gid, "extra_groups": []}
    place = Path(subprocess.check_output(["mktemp", "-d"], text=True, **user).strip())
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "cwd": "/", **user}
    data = str(place / "data")
    subprocess.run([initdb, "-D", data, "-U", "mbtl", "--auth=trust", "-N"], check=True, **quiet)
    settings = {
        "port": port, "listen_addresses": "127.0.0.1", "unix_socket_directories": "",
        "max_connections": 200,
    }  # fmt: skip
    options = [part for name, value in settings.items() for part in ("-c", f"{name}={value}")]
    serving = subprocess.Popen([program, "-D", data, *options], **quiet)
    url = f"postgresql+psycopg://mbtl@127.0.0.1:{port}/postgres"
    try:
        for _ in range(600):
            try:
                SqlLog(url, "probe", create=True)
                break
            except mbtl.MbtlError:
                assert serving.poll() is None
                time.sleep(0.1)
        yield url
    finally:
        serving.send_signal(signal.SIGINT)  # at once, whoever is connected
        serving.wait()
        shutil.rmtree(place, ignore_errors=True)


@pytest.fixture
def name(request):
    return request.node.name


class TestPostgres(EventLogContract):
    @pytest.fixture
    def log(self, postgres, name):
        return SqlLog(postgres, name, create=True)


def test_sixty_four_workers_never_share_a_pick(postgres, name):
    """Each has a connection of its own, and they all begin at once, with the tables to be made."""
    settings = {
        "budget": 96, "bounds": (0.0, 1.0), "selector": "random", "storage": postgres,
        "name": name, "load_if_exists": True,
    }  # fmt: skip
    begin, told, errors = threading.Barrier(64), [], []

    def work():
        try:
            begin.wait()
            study = mbtl.create_study(SPACE, **settings)
            while True:
                pick = study.ask(lease=60.0)
                if study.tell(pick, np.full(100, pick.source / 100)):
                    told.append(pick.source)
        except StudyFinished:
            pass
        except Exception as error:
            errors.append(error)

    workers = [threading.Thread(target=work) for _ in range(64)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    assert not errors
    assert len(told) == len(set(told)) == 96
    study = mbtl.load_study(postgres, name)
    assert study.is_finished
    assert sorted(row.source for row in study.state.rows) == sorted(told)
    assert not study.state.late
    assert name in study_names(postgres)


def test_leases_end_by_the_clock_of_the_server(postgres, name, monkeypatch):
    made = mbtl.create_study(SPACE, budget=3, bounds=(0.0, 1.0), storage=postgres, name=name)
    monkeypatch.setattr(time, "time", lambda: 1e9)  # of this machine, 2001
    pick = made.ask(lease=0.05)
    other = mbtl.load_study(postgres, name)
    assert abs(other.log.now() - made.state.picks[0].asked_at) < 60.0
    while not other.orphans:
        assert other.log.now() > 1.7e9
    taken = other.ask(lease=60.0)
    assert taken == pick
    assert not made.heartbeat(pick)
    assert other.heartbeat(taken, steps=5)
    assert not made.tell(pick, np.zeros(100))
    assert other.tell(taken, np.ones(100))


@pytest.mark.filterwarnings("ignore::mbtl.errors.UnsavedPolicies")
def test_a_run_keeps_its_policies_in_a_folder_of_its_own(postgres, name, tmp_path):
    study = mbtl.create_study(
        SPACE, budget=3, bounds=(0.0, 1.0), storage=postgres, name=name, artifacts=tmp_path
    )
    study.run(
        lambda c, s: c["x"],
        lambda p, cs, s: [1 - abs(p - c["x"]) for c in cs],
        save=lambda policy, folder: (folder / "x").write_text(str(policy)),
        load=lambda folder: float((folder / "x").read_text()),
    )
    assert study.is_finished
    assert len(list(tmp_path.rglob("x"))) == 3
