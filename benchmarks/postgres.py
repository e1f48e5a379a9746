"""A PostgreSQL server for tests and benchmarks: started, stopped and killed as they please."""

from __future__ import annotations

import os
import pwd
import shutil
import signal
import socket
import subprocess
import time
from pathlib import Path
from typing import Any

from mbtl.errors import StorageError
from mbtl.study.storage import SqlLog


def missing() -> str | None:
    """Why no server can be started here; None where one can."""
    try:
        import psycopg  # noqa: F401
    except ImportError:
        return "psycopg is not installed"
    if _program("initdb") is None or _program("postgres") is None:
        return "PostgreSQL is not installed here"
    if os.geteuid() == 0:  # the server refuses to run as root
        try:
            pwd.getpwnam("postgres")
        except KeyError:
            return "PostgreSQL does not run as root, and there is no user postgres"
    return None


class Server:
    """An empty server on a free port of this machine, which trusts everybody; a context manager.

    Attributes:
        url: of its database.
    """

    def __init__(self) -> None:
        self._user: dict[str, Any] = {}
        if os.geteuid() == 0:
            owner = pwd.getpwnam("postgres")
            self._user = {"user": owner.pw_uid, "group": owner.pw_gid, "extra_groups": []}
        place = subprocess.check_output(["mktemp", "-d"], text=True, **self._user)
        self._place = Path(place.strip())
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self._port = probe.getsockname()[1]
        self.url = f"postgresql+psycopg://mbtl@127.0.0.1:{self._port}/postgres"
        self._process: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> Server:
        initdb = [str(_program("initdb")), "-D", self._data, "-U", "mbtl", "--auth=trust", "-N"]
        subprocess.run(initdb, check=True, **self._quiet)
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop(signal.SIGINT)  # at once, whoever is connected
        shutil.rmtree(self._place, ignore_errors=True)

    def start(self) -> None:
        """Start it, and wait until it answers."""
        settings = {
            "port": self._port,
            "listen_addresses": "127.0.0.1",
            "unix_socket_directories": "",
            "max_connections": 200,
        }
        options = [part for name, value in settings.items() for part in ("-c", f"{name}={value}")]
        command = [str(_program("postgres")), "-D", self._data, *options]
        self._process = subprocess.Popen(command, **self._quiet)
        while True:
            try:
                SqlLog(self.url, "probe", create=True)
                return
            except StorageError:
                assert self._process.poll() is None, "the server ended"
                time.sleep(0.05)

    def stop(self, number: int = signal.SIGQUIT) -> None:
        """End it: SIGQUIT is `pg_ctl stop -m immediate`, SIGKILL a machine that loses power."""
        assert self._process is not None
        children = _children(self._process.pid) if number == signal.SIGKILL else []
        self._process.send_signal(number)
        for child in children:  # the kernel would end them, too
            try:
                os.kill(child, number)
            except ProcessLookupError:
                continue
        self._process.wait()
        if number == signal.SIGKILL:
            (Path(self._data) / "postmaster.pid").unlink(missing_ok=True)

    @property
    def _data(self) -> str:
        return str(self._place / "data")

    @property
    def _quiet(self) -> dict[str, Any]:
        silent = subprocess.DEVNULL
        return {"stdout": silent, "stderr": silent, "cwd": "/", **self._user}


def _program(name: str) -> str | None:
    """On the path, or where Debian keeps it."""
    found = sorted(Path("/usr/lib/postgresql").glob(f"*/bin/{name}"))
    return str(found[-1]) if found else shutil.which(name)


def _children(pid: int) -> list[int]:
    listed = Path(f"/proc/{pid}/task/{pid}/children")
    return [int(child) for child in listed.read_text().split()] if listed.is_file() else []
