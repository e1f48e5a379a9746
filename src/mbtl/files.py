"""Files that appear whole or not at all, and folders that know what grows in them, and for whom."""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import IO, Any

from mbtl.errors import InvalidInput, StorageError, cannot_write
from mbtl.settings import first_difference

try:
    import fcntl
except ModuleNotFoundError:  # not on Windows
    fcntl = None  # type: ignore[assignment]


@contextlib.contextmanager
def whole_file(path: Path) -> Iterator[IO[bytes]]:
    """Write to a file that replaces `path` only when the block ends without an error.

    Raises:
        StorageError: the place cannot be written.
    """
    unfinished = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        with unfinished.open("wb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        unfinished.replace(path)
    except OSError as error:
        raise cannot_write(path, error) from error
    finally:
        with contextlib.suppress(OSError):
            unfinished.unlink()


@contextlib.contextmanager
def claimed_folder(folder: Path, settings: Mapping[str, Any], what: str) -> Iterator[None]:
    """While the block runs nobody else works in `folder`, and nobody ever with other settings.

    Args:
        folder: made when missing.
        settings: JSON-able; all that the contents depend on.
        what: of its contents, for the message, e.g. "a transfer matrix".

    Raises:
        InvalidInput: the folder was claimed with other settings.
        StorageError: the place cannot be read or written, or another process works there.
    """
    record = json.loads(json.dumps(settings))
    file = folder / "settings.json"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if not file.exists():
            with whole_file(file) as writing:
                writing.write((json.dumps(record, indent=2) + "\n").encode())
        there = json.loads(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise cannot_write(file, error) from error
    difference = first_difference(there, record)
    if difference:
        name, was, now = difference
        raise InvalidInput(
            f"{folder} holds {what} of other settings: {name} was {was!r}, got {now!r}; choose "
            "another folder, or remove it"
        )
    with _alone(folder):
        yield


@contextlib.contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """A lock that ends with the process, however it ends; none where the system has no such."""
    if fcntl is None:
        yield
        return
    place = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(place, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        os.close(place)
        raise StorageError(
            f"another process works in {folder}; wait until it has ended, or choose another folder"
        ) from error
    except OSError:  # a file system without locks
        pass
    try:
        yield
    finally:
        os.close(place)
