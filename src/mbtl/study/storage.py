"""The event log: append and read, nothing else. SQLite by default, any SQLAlchemy database by URL.

An append says which event it follows. If another process appended first, it fails with `Conflict`
and the caller looks again: that is how two processes never get the same pick. Each append is one
transaction, so a killed process leaves either the whole event or nothing.
"""

from __future__ import annotations

import io
import json
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, cast

import numpy as np

from mbtl.arrays import python_value
from mbtl.errors import InvalidInput, StorageError
from mbtl.study.events import KINDS, Event, Kind
from mbtl.untrusted import read_arrays, read_json

if TYPE_CHECKING:
    from sqlalchemy import Connection, Engine, Table

_BUSY_SECONDS = 60.0
_LATEST = 2e11
"""Seconds since the epoch that are still a date."""

_WRITES = "mbtl_writes"  # a reader takes no write lock, so a study may be read-only


class Conflict(StorageError):
    """Another process appended first; read again and decide anew."""


class EventLog(Protocol):
    """Where the events of one study live."""

    def append(self, event: Event, *, after: int) -> int:
        """Append `event` right after number `after` and return its own number.

        Raises:
            Conflict: the log has grown past `after`.
            StorageError: it cannot be written; nothing was changed.
        """
        ...

    def read(self, after: int = 0) -> Sequence[Event]:
        """All events with a number greater than `after`, in order."""
        ...


class MemoryLog:
    """A log that lives and dies with the process."""

    def __init__(self) -> None:
        self._events: list[Event] = []

    def append(self, event: Event, *, after: int) -> int:
        """Append after `after`; see `EventLog`."""
        if after != len(self._events):
            raise Conflict(f"event {after + 1} is taken; the log has {len(self._events)} events")
        numbered = Event(event.kind, event.data, event.arrays, after + 1, time.time())
        self._events.append(numbered)
        return after + 1

    def read(self, after: int = 0) -> Sequence[Event]:
        """Events after number `after`."""
        return self._events[after:]


class SqlLog:
    """Events of one named study in a database table.

    Args:
        url: an SQLAlchemy URL, or the path of an SQLite file.
        study: name of the study; one database holds many.
        create: make the file and table when they are missing.

    Raises:
        StorageError: the database is missing, unreadable or not ours.
    """

    def __init__(self, url: str | Path, study: str, *, create: bool = False) -> None:
        self.url = as_url(url)
        self.study = study
        self._engine, self._table = _open(self.url, create=create)

    def append(self, event: Event, *, after: int) -> int:
        """Append in one transaction; see `EventLog`."""
        from sqlalchemy import insert
        from sqlalchemy.exc import IntegrityError

        row = {
            "study": self.study,
            "seq": after + 1,
            "time": time.time(),
            "kind": event.kind,
            "data": _text(event),
            "arrays": _pack(event),
        }
        with self._connection(write=True) as connection:
            if self._last(connection) != after:
                raise Conflict(f"event {after + 1} of study {self.study!r} is taken")
            try:
                connection.execute(insert(self._table).values(**row))
            except IntegrityError as error:  # the primary key: another process was faster
                raise Conflict(f"event {after + 1} of study {self.study!r} is taken") from error
        return after + 1

    def read(self, after: int = 0) -> Sequence[Event]:
        """Events after number `after`."""
        from sqlalchemy import select

        t = self._table.c
        query = select(t.seq, t.time, t.kind, t.data, t.arrays)
        query = query.where((t.study == self.study) & (t.seq > after)).order_by(t.seq)
        events = []
        try:
            with self._connection() as connection:
                for row in connection.execute(query):
                    events.append(_unpack(*row))
        except (TypeError, ValueError, MemoryError) as error:  # columns of other types than ours
            raise StorageError(
                f"the event after {len(events) + after} of the study {self.study!r} cannot be read "
                f"({error}); restore a copy of {self.url}"
            ) from error
        return events

    def _last(self, connection: Connection) -> Any:
        """Number of the last event; anything, where the log is damaged."""
        from sqlalchemy import func, select

        t = self._table.c
        query = select(func.coalesce(func.max(t.seq), 0)).where(t.study == self.study)
        return connection.execute(query).scalar_one()

    @contextmanager
    def _connection(self, *, write: bool = False) -> Iterator[Connection]:
        engine = self._engine.execution_options(**{_WRITES: write})
        with _database_errors(self.url), engine.begin() as connection:
            yield connection


def study_names(url: str | Path) -> list[str]:
    """Names of the studies in a database, oldest first."""
    from sqlalchemy import func, select

    address = as_url(url)
    engine, table = _open(address, create=False)
    query = select(table.c.study).group_by(table.c.study).order_by(func.min(table.c.time))
    with _database_errors(address), engine.begin() as connection:
        return [str(name) for (name,) in connection.execute(query)]


def as_url(url: str | Path) -> str:
    """A path becomes an SQLite URL, whatever characters it has; a URL stays as it is.

    Raises:
        InvalidInput: ":memory:"; a study in memory needs no storage.
    """
    from sqlalchemy import URL

    text = str(url)
    if "://" in text:
        return text
    if text in ("", ":memory:"):
        raise InvalidInput(
            f"storage must be a path or a URL, got {text!r}; leave it out for memory"
        )
    return URL.create("sqlite", database=text).render_as_string(hide_password=False)


def sqlite_path(url: str) -> Path | None:
    """The file of an SQLite URL; None for other databases and for what is no URL."""
    from sqlalchemy import make_url
    from sqlalchemy.exc import ArgumentError

    try:
        parsed = make_url(url)
    except ArgumentError:
        return None
    name = parsed.database or ""
    if (
        parsed.get_backend_name() != "sqlite"
        or name in ("", ":memory:")
        or name.startswith("file:")
    ):
        return None  # "file:...?uri=true" is SQLite's own way to open a file, e.g. read-only
    return Path(name)


def _open(url: str, *, create: bool) -> tuple[Engine, Table]:
    from sqlalchemy import (
        Column,
        Float,
        Integer,
        LargeBinary,
        MetaData,
        String,
        Table,
        Text,
        create_engine,
        event,
        inspect,
    )
    from sqlalchemy.exc import ArgumentError, NoSuchModuleError

    path = sqlite_path(url)
    if path is not None and not path.is_file():
        if not create:
            raise StorageError(f"a study lives in a database file, and there is none at {path}")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise StorageError(
                f"a study needs a folder it can write to, and {path.parent} is not "
                f"({error.strerror}); choose another with --study or storage="
            ) from error
    try:
        engine = create_engine(url)
    except (ArgumentError, NoSuchModuleError, ModuleNotFoundError) as error:
        raise StorageError(
            f"storage must be a path or an SQLAlchemy URL, got {url!r} ({error})"
        ) from error
    if engine.dialect.name == "sqlite":

        @event.listens_for(engine, "connect")
        def _configure(connection: Any, _: Any) -> None:
            # the driver's own transactions start too late to lock before we read
            connection.isolation_level = None
            connection.execute(f"PRAGMA busy_timeout = {int(_BUSY_SECONDS * 1000)}")
            connection.execute("PRAGMA synchronous = FULL")

        @event.listens_for(engine, "begin")
        def _lock(connection: Any) -> None:
            writes = connection.get_execution_options().get(_WRITES, False)
            connection.exec_driver_sql("BEGIN IMMEDIATE" if writes else "BEGIN")

    table = Table(
        "mbtl_events",
        MetaData(),
        Column("study", String(200), primary_key=True),
        Column("seq", Integer, primary_key=True, autoincrement=False),
        Column("time", Float, nullable=False),
        Column("kind", String(20), nullable=False),
        Column("data", Text, nullable=False),
        Column("arrays", LargeBinary(length=2**31 - 1), nullable=False),
    )
    writer = engine.execution_options(**{_WRITES: create})
    with _database_errors(url), writer.begin() as connection:
        if create:
            table.create(connection, checkfirst=True)
        elif not inspect(connection).has_table(table.name):
            raise StorageError(
                f"{url} is a database without mbtl studies; give the path of a study"
            )
    return engine, table


@contextmanager
def _database_errors(url: str) -> Iterator[None]:
    from sqlalchemy.exc import DatabaseError

    try:
        yield
    except DatabaseError as error:
        cause = str(error.orig)
        if "not a database" in cause or "malformed" in cause:
            raise StorageError(
                f"{url} is corrupt or not a study database ({cause}); restore a copy, or start a "
                "new study elsewhere"
            ) from error
        raise StorageError(
            f"the study at {url} could not be read or written ({cause}); what was told before is "
            "kept: free space or mend access, then run the same command again"
        ) from error


def _pack(event: Event) -> bytes:
    if not event.arrays:
        return b""
    buffer = io.BytesIO()
    np.savez_compressed(
        buffer, allow_pickle=False, **{k: np.asarray(v) for k, v in event.arrays.items()}
    )
    return buffer.getvalue()


def _unpack(seq: int, when: float, kind: str, data: str, arrays: bytes) -> Event:
    if kind not in KINDS:
        raise StorageError(
            f"event {seq} is of kind {kind!r}, which this version does not know; upgrade mbtl"
        )
    try:
        facts = read_json(data)
        if not isinstance(facts, dict):
            raise ValueError(f"facts as a JSON {type(facts).__name__}")
        if not 0 <= when < _LATEST:
            raise ValueError(f"the time {when!r}")
        packed = read_arrays(io.BytesIO(arrays)) if arrays else {}
    except (TypeError, ValueError) as error:
        raise StorageError(
            f"event {seq} ({kind}) of the study is damaged or not ours: {error}; restore a copy of "
            "the study"
        ) from error
    return Event(cast(Kind, kind), facts, packed, seq, when)


def _text(event: Event) -> str:
    try:
        return json.dumps(event.data, allow_nan=False, default=python_value)
    except (TypeError, ValueError) as error:
        raise InvalidInput(
            f"what a study records must be JSON-able, got {error} in {event.kind!r}"
        ) from error
