"""The event log: append and read. SQLite by default, any SQLAlchemy database by URL.

An append says which event it follows. If another process appended first, it fails with `Conflict`
and the caller looks again: that is how two processes never get the same pick. Each append is one
transaction, so a killed process leaves either the whole event or nothing.

Heartbeats are kept beside the log, one per lease: they come every few seconds and decide nothing
for ever; what follows from one that is missing is an event again.
"""

from __future__ import annotations

import hashlib
import io
import json
import threading
import time
import weakref
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, cast

import numpy as np

from mbtl.arrays import python_value
from mbtl.errors import InvalidInput, StorageError, Unreachable
from mbtl.files import read_arrays, read_json
from mbtl.study.database import (
    LATEST,
    WRITES,
    Patience,
    as_url,
    check_date,
    check_name,
    clock,
    database_errors,
    open_database,
    shown,
)
from mbtl.study.events import KINDS, Event, Kind

if TYPE_CHECKING:
    import sqlalchemy as sa

T = TypeVar("T")


class Conflict(StorageError):
    """Another process appended first; read again and decide anew."""


class MemoryLog:
    """A log that lives and dies with the process."""

    def __init__(self) -> None:
        self._events: list[Event] = []
        self._beats: dict[str, float] = {}
        self._lock = threading.Lock()

    def append(self, event: Event, *, after: int) -> int:
        """Append `event` right after number `after` and return its own number.

        Raises:
            Conflict: the log has grown past `after`.
            StorageError: it cannot be written; nothing was changed.
        """
        with self._lock:
            taken = len(self._events)
            if after != taken:
                raise Conflict(f"event {after + 1} is taken; the log has {taken} events")
            numbered = Event(event.kind, event.data, event.arrays, after + 1, time.time())
            self._events.append(numbered)
        return after + 1

    def read(self, after: int = 0) -> Sequence[Event]:
        """All events with a number greater than `after`, in order."""
        return self._events[after:]

    def now(self) -> float:
        """Seconds since the epoch, by the one clock that also stamps the events."""
        return time.time()

    def beat(self, token: str, seconds: float) -> None:
        """The holder of a lease lives, and will be heard of again within so many seconds."""
        self._beats[token] = time.time() + seconds

    def beats(self) -> Mapping[str, float]:
        """Until when each lease was last said to live, by its token."""
        return dict(self._beats)


class SqlLog:
    """Events of one named study in a database table.

    Once it is open, a server that is away is waited for, for as long as `patience` says.

    Args:
        url: an SQLAlchemy URL, or the path of an SQLite file.
        study: name of the study; one database holds many.
        create: make the file and table when they are missing.

    Raises:
        InvalidInput: a name or path that cannot be.
        Unreachable: the server does not answer.
        StorageError: the database is missing, unreadable or not ours.
    """

    def __init__(self, url: str | Path, study: str, *, create: bool = False) -> None:
        self.url = as_url(url)
        self.study = study
        if create:
            check_name(study)
        self.patience = Patience()
        self._engine, self._table, self._heartbeats = open_database(self.url, create=create)
        weakref.finalize(self, self._engine.dispose)  # a server's connections end with the log

    def append(self, event: Event, *, after: int) -> int:
        """Append in one transaction; see `MemoryLog`."""
        import sqlalchemy as sa

        t = self._table
        facts: dict[str, Any] = {"kind": event.kind, "data": _text(event), "arrays": _pack(event)}
        row = {"study": self.study, "seq": after + 1, "time": clock(self._engine), **facts}
        row["checksum"] = checksum_of(after + 1, **facts)
        values = [row["time"] if c is t.c.time else sa.literal(row[c.name], c.type) for c in t.c]
        # one statement: the server may be far away, and is asked thousands of times
        dated = row["time"].between(0.0, LATEST)
        last = sa.select(sa.func.coalesce(sa.func.max(t.c.seq), 0)).where(t.c.study == self.study)
        is_last = sa.select(*values).where((last.scalar_subquery() == after) & dated)
        statement = sa.insert(t).from_select([*t.c], is_last, include_defaults=False)
        statement = statement.execution_options(preserve_rowcount=True)
        taken = Conflict(f"event {after + 1} of study {self.study!r} is taken")

        def write(connection: sa.Connection) -> None:
            try:
                if connection.execute(statement).rowcount != 1:
                    self._now(connection)
                    raise taken
            except sa.exc.IntegrityError as error:  # the primary key: another process was faster
                raise taken from error

        in_doubt = False
        while True:
            try:
                self._try(write, writes=True, single=True)
                return after + 1
            except Unreachable as error:  # perhaps after the event was written
                in_doubt = True
                self.patience.wait(error)
            except Conflict:
                if in_doubt and self._holds(row):
                    return after + 1
                raise

    def read(self, after: int = 0) -> Sequence[Event]:
        """Events after number `after`."""
        t = self._table.c
        query = self._table.select().where((t.study == self.study) & (t.seq > after))
        events: list[Event] = []

        def fetch(connection: sa.Connection) -> None:
            events.clear()
            for _, *facts in connection.execute(query.order_by(t.seq)):
                events.append(_unpack(*facts))

        try:
            self._do(fetch)
        except (TypeError, ValueError, MemoryError) as error:  # columns of other types than ours
            raise StorageError(
                f"the event after {len(events) + after} of the study {self.study!r} cannot be read "
                f"({error}); restore a copy of {shown(self.url)}"
            ) from error
        return events

    def now(self) -> float:
        """The server's clock; of a file, this machine's."""
        return self._do(self._now)

    def beat(self, token: str, seconds: float) -> None:
        """Write the row of this lease; see `MemoryLog`."""
        t = self._heartbeats
        facts = {"expires": clock(self._engine) + seconds}
        mine = (t.c.study == self.study) & (t.c.token == token)

        def write(connection: sa.Connection) -> None:
            if not connection.execute(t.update().where(mine).values(**facts)).rowcount:
                connection.execute(t.insert().values(study=self.study, token=token, **facts))

        self._do(write, writes=True)

    def beats(self) -> Mapping[str, float]:
        """The rows of this study; see `MemoryLog`."""
        query = self._heartbeats.select().where(self._heartbeats.c.study == self.study)
        return self._do(lambda one: {row.token: row.expires for row in one.execute(query)})

    def delete(self) -> None:
        """All events and heartbeats of the study, for ever; `delete_study` asks first."""

        def write(connection: sa.Connection) -> None:
            for one in (self._table, self._heartbeats):
                connection.execute(one.delete().where(one.c.study == self.study))

        self._do(write, writes=True)

    # ---- inside ------------------------------------------------------------------------------

    def _now(self, connection: sa.Connection) -> float:
        import sqlalchemy as sa

        now = float(connection.execute(sa.select(clock(self._engine))).scalar_one())
        return check_date(now, "the server")

    def _holds(self, row: Mapping[str, Any]) -> bool:
        """True when the log has this very event at this place.

        Events of workers name the token of a lease, so that nobody else writes the same; of those
        that do not, it makes no difference who did.
        """
        t = self._table.c
        query = self._table.select().where((t.study == self.study) & (t.seq == row["seq"]))
        found = self._do(lambda connection: connection.execute(query).mappings().one_or_none())
        return found is not None and all(found[k] == row[k] for k in ("kind", "data", "arrays"))

    def _do(self, work: Callable[[sa.Connection], T], *, writes: bool = False) -> T:
        """What `work` gives in one transaction, again where the server did not answer."""
        while True:
            try:
                return self._try(work, writes=writes, single=not writes)
            except Unreachable as error:
                self.patience.wait(error)

    def _try(self, work: Callable[[sa.Connection], T], *, writes: bool, single: bool) -> T:
        """Once; a single statement is a transaction by itself, and needs no words around it."""
        options: dict[str, Any] = {WRITES: writes}
        if single and self._engine.dialect.name == "postgresql":
            options["isolation_level"] = "AUTOCOMMIT"
        engine = self._engine.execution_options(**options)
        with database_errors(self.url), engine.begin() as connection:
            done = work(connection)
        self.patience.answered()
        return done


EventLog = MemoryLog | SqlLog
"""Where the events of one study live."""


def study_names(url: str | Path) -> list[str]:
    """Names of the studies in a database, oldest first."""
    import sqlalchemy as sa

    address = as_url(url)
    engine, table, _ = open_database(address, create=False)
    query = sa.select(table.c.study).group_by(table.c.study).order_by(sa.func.min(table.c.time))
    try:
        with database_errors(address), engine.begin() as connection:
            return [str(name) for (name,) in connection.execute(query)]
    finally:
        engine.dispose()


def names_in(file: Path) -> list[str]:
    """The same of a file; none where there is none, or it cannot be read: opening it says why."""
    with suppress(StorageError):
        return study_names(file) if file.is_file() else []
    return []


def _pack(event: Event) -> bytes:
    if not event.arrays:
        return b""
    buffer, arrays = io.BytesIO(), {k: np.asarray(v) for k, v in event.arrays.items()}
    assert not any(array.dtype.hasobject for array in arrays.values())
    np.savez_compressed(buffer, **arrays)  # type: ignore[arg-type]  # numpy 1 has no allow_pickle
    return buffer.getvalue()


def checksum_of(seq: int, kind: str, data: str, arrays: bytes) -> str:
    """Of an entry as it is stored, so that a bit that flips on a disk is noticed."""
    digest = hashlib.sha256(json.dumps([seq, kind, data]).encode())
    digest.update(arrays)
    return digest.hexdigest()[:16]


def _unpack(seq: int, when: float, kind: str, data: str, arrays: bytes, checksum: str) -> Event:
    if checksum != checksum_of(seq, kind, data, arrays):
        raise StorageError(
            f"event {seq} of the study is damaged or not ours: it does not fit its checksum; "
            "restore a copy of the study"
        )
    if kind not in KINDS:
        raise StorageError(
            f"event {seq} is of kind {kind!r}, which this version does not know; upgrade mbtl"
        )
    try:
        facts = read_json(data)
        if not isinstance(facts, dict):
            raise ValueError(f"facts as a JSON {type(facts).__name__}")
        if not 0 <= when < LATEST:
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
