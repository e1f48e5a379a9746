"""Files that appear whole or not at all, and folders that know what grows in them, and for whom."""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import IO, Any

from filelock import FileLock, Timeout

from mbtl.errors import InvalidInput, StorageError, cannot_write
from mbtl.settings import first_difference
from mbtl.untrusted import read_json


def from_home(path: str | Path) -> Path:
    """A path as a shell would read it: `~` is the home folder, `~ann` that of ann, if any."""
    try:
        return Path(path).expanduser()
    except RuntimeError:  # nobody of that name
        return Path(path)


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


def sync_folder(folder: Path) -> None:
    """Return when a folder and all below it is on the disk, so that a rename cannot outrun it.

    Raises:
        OSError: the system could not write it.
    """
    for place, _, names in os.walk(folder):
        for name in names:
            _sync(Path(place, name))
        sync_entries(Path(place))


def sync_entries(folder: Path) -> None:
    """Return when the names in a folder are on the disk, where the system can promise that."""
    with contextlib.suppress(OSError):  # not every system opens folders
        _sync(folder)


def _sync(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


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
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = FileLock(folder / ".lock", blocking=False)  # ends with the process, however it ends
        lock.acquire()
    except Timeout as error:
        raise StorageError(
            f"another process works in {folder}; wait until it has ended, or choose another folder"
        ) from error
    except OSError as error:
        raise cannot_write(folder, error) from error
    try:
        _check_claim(folder, json.loads(json.dumps(settings)), what)
        yield
    finally:
        lock.release()


def claim_of(folder: Path) -> dict[str, Any] | None:
    """Settings with which `folder` was claimed; None if it was not."""
    try:
        claim = json.loads((folder / "settings.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return claim if isinstance(claim, dict) else None


def _check_claim(folder: Path, record: dict[str, Any], what: str) -> None:
    file = folder / "settings.json"
    try:
        if not file.exists():
            with whole_file(file) as writing:
                writing.write((json.dumps(record, indent=2) + "\n").encode())
        there = read_json(file.read_text(encoding="utf-8"))
        if not isinstance(there, dict):
            raise ValueError(f"a JSON {type(there).__name__}")
    except OSError as error:
        raise cannot_write(file, error) from error
    except ValueError as error:
        raise StorageError(
            f"{file} must say with which settings the folder grew, got {error}; choose another "
            "folder, or remove it"
        ) from error
    difference = first_difference(there, record)
    if difference:
        name, was, now = difference
        raise InvalidInput(
            f"{folder} holds {what} of other settings: {name} was {was!r}, got {now!r}; choose "
            "another folder, or remove it"
        )
