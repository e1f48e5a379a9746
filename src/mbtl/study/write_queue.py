"""Turns: many who write to one study on a server queue up there, instead of colliding.

An append compares by itself what it follows, so nothing depends on a turn. Without turns, though,
most appends of sixty workers come too late, and each look and each try costs all of them time.
"""

from __future__ import annotations

import threading
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sqlalchemy import Connection, Engine

_PATIENCE, _LONGEST = "3s", "20s"
"""For which a turn is waited for, and for which a worker that went away silently may keep one."""


class Turns(threading.local):
    """Of one study, for each thread its own; without effect where the database is no PostgreSQL.

    Args:
        engine: of the database.
        study: name of the study.

    Attributes:
        connection: has the turn of this thread; None: it has none. Its transaction is the turn.
    """

    def __init__(self, engine: Engine, study: str) -> None:
        self._engine = engine
        self._key = zlib.crc32(f"mbtl {study}".encode("utf-8", "surrogatepass"))
        self.connection: Connection | None = None

    @contextmanager
    def take(self) -> Iterator[None]:
        """Wait for a turn, and have it until something is written, or until the block ends."""
        if self._engine.dialect.name == "postgresql" and self.connection is None:
            self._begin()
        try:
            yield
        finally:
            self.end()

    def end(self) -> None:
        """Let the next one begin."""
        from sqlalchemy.exc import SQLAlchemyError

        connection, self.connection = self.connection, None
        if connection is not None:
            with suppress(SQLAlchemyError):
                connection.close()

    def _begin(self) -> None:
        """Whatever goes wrong here goes wrong again, and is said, when something is written."""
        from sqlalchemy import func, select
        from sqlalchemy.exc import SQLAlchemyError

        wait = select(
            func.set_config("lock_timeout", _PATIENCE, True),
            func.set_config("idle_in_transaction_session_timeout", _LONGEST, True),
            func.pg_advisory_xact_lock(self._key),
        )
        # what others wrote while this one waited is seen
        engine = self._engine.execution_options(isolation_level="READ COMMITTED")
        with suppress(SQLAlchemyError):
            connection = engine.connect()
            try:
                connection.execute(wait)
            except BaseException:
                connection.close()
                raise
            self.connection = connection
