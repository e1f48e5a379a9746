"""Databases: how a study's is named, opened and made, and what its errors mean."""

from __future__ import annotations

import math
import random
import re
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from logging import getLogger
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import unquote

from mbtl.errors import InvalidInput, MissingExtra, StorageError, Unreachable, few
from mbtl.files import from_home
from mbtl.plain import short

if TYPE_CHECKING:
    import sqlalchemy as sa

_logger = getLogger(__name__)

_BUSY_SECONDS = 60.0

PATIENCE = 300.0
"""Seconds without an answer after which a study gives up."""
_PAUSE, _LONGEST_PAUSE = 0.1, 2.0

_FILES = ("sqlite", "duckdb")
"""Databases that are no servers."""

_FOR_GOOD = ("authentication failed", "no password supplied", "does not exist", "pg_hba.conf")
"""What a server says that will say the same in a minute."""

LATEST = 2e11
"""Seconds since the epoch that are still a date."""

_LONGEST_NAME, _LONGEST_PART = 200, 255
"""Letters of a study's name, as its column has them, and bytes of a name in a path."""

WRITES = "mbtl_writes"
"""Option of a connection that writes: a reader takes no lock, so a study may be read-only."""


def check_path(path: str | Path) -> None:
    """Refuse what can be no path of a study, or no URL.

    Raises:
        InvalidInput: it is not written in UTF-8, or a name in it is too long.
    """
    text = str(path)
    try:
        longest = max(len(part) for part in text.encode("utf-8").split(b"/"))
    except UnicodeEncodeError:
        raise InvalidInput(
            f"the path of a study is written in UTF-8, got {text!r}; choose another, or rename it"
        ) from None
    if "\0" in text or (longest > _LONGEST_PART and "://" not in text):
        raise InvalidInput(
            f"each name in a path has up to {_LONGEST_PART} bytes and no zeros, got {longest} in "
            f"{short(text)}; choose a shorter one"
        )


def check_name(name: str) -> None:
    """Refuse what can be no name of a study.

    Raises:
        InvalidInput: so it is.
    """
    if not 1 <= len(name) <= _LONGEST_NAME or not name.isprintable():
        raise InvalidInput(
            f"the name of a study, or of its folder, has 1 to {_LONGEST_NAME} printable letters, "
            f"got {len(name)}: {short(name)}; choose another"
        )


def as_url(url: str | Path) -> str:
    """A path becomes an SQLite URL, whatever characters it has; `~` is the home folder.

    A URL stays as it is.

    Raises:
        InvalidInput: ":memory:", since a study in memory needs no storage; or no path at all.
    """
    import sqlalchemy as sa

    text = str(url)
    check_path(text)
    if "://" in text:
        return text
    if text in ("", ":memory:"):
        raise InvalidInput(
            f"storage must be a path or a URL, got {text!r}; leave it out for memory"
        )
    made = sa.URL.create("sqlite", database=str(from_home(text)))
    return made.render_as_string(hide_password=False)


def _parsed(address: str) -> sa.URL | None:
    """A URL taken apart; None: it is none, which opening it says in our words."""
    import sqlalchemy as sa

    with suppress(sa.exc.ArgumentError, ValueError):
        return sa.make_url(address)
    return None


def fixed_url(storage: str | Path) -> str:
    """The storage as a URL that stays right in whatever folder the process works."""
    address = as_url(storage)
    url, file = _parsed(address), database_file(address)
    if url is None or file is None or str(url.database).startswith("file:"):
        return address
    return url.set(database=str(file)).render_as_string(hide_password=False)


def database_file(address: str) -> Path | None:
    """The absolute path of the file behind a URL; None for a server and for memory."""
    url = _parsed(address)
    name = (url and url.database) or ""
    if url is None or url.get_backend_name() not in _FILES or ":memory:" in name or not name:
        return None
    if name.startswith("file:"):  # SQLite's own way to open a file, e.g. read-only
        if url.query.get("mode") == "memory":
            return None
        name = unquote(name.removeprefix("file:").partition("?")[0])
        name = "/" + name.lstrip("/") if name.startswith("/") else name
    return Path(name).absolute()


def shown(url: str) -> str:
    """A URL as logs and people may see it: without its password."""
    parsed = _parsed(url)
    if parsed is None:
        return re.sub(r"(://[^/@:]*:)[^/@]*@", r"\1***@", url)
    return parsed.render_as_string(hide_password=True)


def clock(engine: sa.Engine) -> Any:
    """The time: an expression for a server, whose answer `check_date` is for; of a file, a number.

    Raises:
        StorageError: this machine's clock shows no date.
    """
    import sqlalchemy as sa

    name = engine.dialect.name
    if name == "postgresql":
        return sa.extract("epoch", sa.func.clock_timestamp()).cast(sa.Float(53))
    if name in ("mysql", "mariadb"):
        return sa.func.unix_timestamp(sa.func.now(6)).cast(sa.Float(53))
    return sa.literal(check_date(time.time(), "this machine"), sa.Float(53))


def check_date(now: float, whose: str) -> float:
    """The time by a clock, if it is a date.

    Raises:
        StorageError: it is none.
    """
    if 0.0 <= now < LATEST:
        return now
    raise StorageError(
        f"a study notes when things happen, and the clock of {whose} says {now:.0f} s after the "
        "beginning of 1970; set it, then run again"
    )


def open_database(url: str, *, create: bool) -> tuple[sa.Engine, sa.Table, sa.Table]:
    """An engine with the tables of events and of heartbeats; made where they are missing.

    Raises:
        StorageError: the database is missing, unreadable or not ours.
    """
    import sqlalchemy as sa

    path = database_file(url)
    if path is not None and path.is_dir():
        raise StorageError(
            f"a study lives in a database file, and {path} is a folder; give {path / 'study.db'}"
        )
    if path is not None and not path.is_file():
        if not create:
            raise _no_file(path)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise StorageError(
                f"a study needs a folder it can write to, and {path.parent} is not "
                f"({error.strerror}); choose another with --study or storage="
            ) from error
    # of a server's connections a worker keeps one; its heartbeats may need another for a moment
    pool = {} if path is not None or url.startswith(_FILES) else {"pool_size": 1}
    try:
        engine = sa.create_engine(url, **pool)
    except ModuleNotFoundError as error:
        fix = (
            "run: pip install 'mbtl[cluster]'"
            if url.startswith("postgresql")
            else f"install the package that gives {error.name}"
        )
        raise MissingExtra(f"the driver of {shown(url)} is not installed; {fix}") from error
    except (sa.exc.ArgumentError, sa.exc.NoSuchModuleError, ValueError) as error:
        raise StorageError(
            f"storage must be a path, or a URL such as postgresql+psycopg://me@host/studies, got "
            f"{shown(url)!r} ({error})"
        ) from error
    if engine.dialect.name == "sqlite":

        @sa.event.listens_for(engine, "connect")
        def _configure(connection: Any, _: Any) -> None:
            # the driver's own transactions start too late to lock before we read
            connection.isolation_level = None
            connection.execute(f"PRAGMA busy_timeout = {int(_BUSY_SECONDS * 1000)}")
            connection.execute("PRAGMA synchronous = FULL")

        @sa.event.listens_for(engine, "begin")
        def _lock(connection: Any) -> None:
            writes = connection.get_execution_options().get(WRITES, False)
            connection.exec_driver_sql("BEGIN IMMEDIATE" if writes else "BEGIN")

    table = sa.Table(
        "mbtl_events",
        sa.MetaData(),
        sa.Column("study", sa.String(200), primary_key=True),
        sa.Column("seq", sa.Integer, primary_key=True, autoincrement=False),
        sa.Column("time", sa.Float(53), nullable=False),
        sa.Column("kind", sa.String(20), nullable=False),
        sa.Column("data", sa.Text, nullable=False),
        sa.Column("arrays", sa.LargeBinary(length=2**31 - 1), nullable=False),
        sa.Column("checksum", sa.String(16), nullable=False),
    )
    heartbeats = sa.Table(
        "mbtl_heartbeats",
        table.metadata,
        sa.Column("study", sa.String(200), primary_key=True),
        sa.Column("token", sa.String(64), primary_key=True),
        sa.Column("expires", sa.Float(53), nullable=False),
    )
    writer = engine.execution_options(**{WRITES: create})
    with database_errors(url), writer.begin() as connection:
        if create:
            table.create(connection, checkfirst=True)
            heartbeats.create(connection, checkfirst=True)
        if not sa.inspect(connection).has_table(table.name):
            raise StorageError(
                f"{shown(url)} is a database without mbtl studies; give the path of a study"
            )
    return engine, table, heartbeats


@contextmanager
def database_errors(url: str) -> Iterator[None]:
    """What the database refuses in the block is said in our words.

    Raises:
        Unreachable: the server does not answer.
        StorageError: it refused something.
    """
    import sqlalchemy as sa

    try:
        yield
    except UnicodeDecodeError as error:  # SQLite gives its names as they are in the file
        raise StorageError(
            f"{shown(url)} is corrupt ({error}); restore a copy, or start a new study elsewhere"
        ) from error
    except sa.exc.DBAPIError as error:
        cause, url = " ".join(str(error.orig).split()), shown(url)
        if _is_away(error, url):
            raise Unreachable(
                f"the database at {url} does not answer ({cause}); what was told before is "
                "kept: see that the server runs and can be reached, then run the same command again"
            ) from error
        if "not a database" in cause or "malformed" in cause:
            raise StorageError(
                f"{url} is corrupt or not a study database ({cause}); restore a copy, or start a "
                "new study elsewhere"
            ) from error
        if "does not exist" in cause and "database" in cause:
            raise StorageError(
                f"the server has no database for {url} ({cause}); make it once, for PostgreSQL "
                "with `createdb NAME`, and run the same command again"
            ) from error
        raise StorageError(
            f"the study at {url} could not be read or written ({cause}); what was told before is "
            "kept: free space or mend access, then run the same command again"
        ) from error


def _no_file(path: Path) -> StorageError:
    """There is no such database; studies of the folders below may be meant."""
    with suppress(ValueError):  # as people near it say it
        path = path.relative_to(Path.cwd())
    said = f"a study lives in a database file, and there is none at {path}"
    folder = path.parent if path.name == "study.db" else path
    below = [
        str(f.parent) for f in sorted([*folder.glob("*/study.db"), *folder.glob("*/*/study.db")])
    ]
    if not below:
        return StorageError(f"{said}; `mbtl study list FOLDER` shows the studies below a folder")
    return StorageError(f"{said}; give one of those below: {few(below)}")


def _is_away(error: sa.exc.DBAPIError, url: str) -> bool:
    """True where a server, asked again in a moment, may answer."""
    import sqlalchemy as sa

    kinds = sa.exc.InterfaceError, sa.exc.OperationalError
    if url.startswith(_FILES) or not isinstance(error, kinds):
        return False
    lost = error.connection_invalidated or error.statement is None  # or never had
    return lost and not any(words in str(error.orig) for words in _FOR_GOOD)


class Patience:
    """How long is waited for one database.

    When that was too long nothing is waited for again until it has answered: whoever cleans up
    after the error hears at once that it cannot.

    Args:
        seconds: for which it may be away.
    """

    def __init__(self, seconds: float = PATIENCE) -> None:
        self.seconds = seconds
        self._since: float | None = None

    def wait(self, error: Unreachable) -> None:
        """Sleep a moment before the next try.

        Raises:
            Unreachable: the error itself, when it has lasted too long.
        """
        now = time.monotonic()
        if self._since is None:
            self._since = now
            if self.seconds > 0.0:
                _logger.warning("%s; trying again for %.0f s", error, self.seconds)
        away = now - self._since
        if away >= self.seconds:
            raise error
        pause = min(_PAUSE + away / 5.0, _LONGEST_PAUSE) * random.uniform(0.5, 1.0)
        try:
            time.sleep(min(pause, self.seconds - away))
        except BaseException:  # an interrupt: who wants to end has no patience left
            self._since = -math.inf
            raise

    def answered(self) -> None:
        """It is there."""
        if self._since is not None:
            self._since = None
            _logger.warning("the database answers again")
