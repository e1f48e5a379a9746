"""Where a study lives: its database, and the folder of its policies.

Both are made absolute when a study is made or opened, so that no change of the working folder moves
them; the log itself names policies relative to their folder.
"""

from __future__ import annotations

from pathlib import Path
from urllib.parse import unquote

from mbtl.study.artifacts import ArtifactStore, store_at
from mbtl.study.database import as_url

_IN_FILES = ("sqlite", "duckdb")
"""Databases that are files of this machine."""


def fixed_url(storage: str | Path) -> str:
    """The storage as a URL that stays right in whatever folder the process works."""
    from sqlalchemy import make_url
    from sqlalchemy.exc import ArgumentError

    address = as_url(storage)
    try:
        url = make_url(address)
    except ArgumentError:  # opening it says so in our words
        return address
    file = database_file(address)
    if file is None or str(url.database).startswith("file:"):
        return address
    return url.set(database=str(file)).render_as_string(hide_password=False)


def database_file(address: str) -> Path | None:
    """The absolute path of the file behind a URL; None for a server and for memory."""
    from sqlalchemy import make_url
    from sqlalchemy.exc import ArgumentError

    try:
        url = make_url(address)
    except ArgumentError:
        return None
    name = url.database or ""
    if url.get_backend_name() not in _IN_FILES or ":memory:" in name or not name:
        return None
    if name.startswith("file:"):  # SQLite's own way to open a file, e.g. read-only
        if url.query.get("mode") == "memory":
            return None
        name = unquote(name.removeprefix("file:").partition("?")[0])
        name = "/" + name.lstrip("/") if name.startswith("/") else name
    return Path(name).absolute()


def policy_store(address: str | None, artifacts: str | Path | None) -> ArtifactStore | None:
    """What keeps the policies.

    Args:
        address: of the storage; None: the study is in memory.
        artifacts: given by the user; None: next to the database, where that is a file.
    """
    file = None if address is None else database_file(address)
    return store_at(artifacts, None if file is None else file.parent)
