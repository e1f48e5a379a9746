"""Files: ours appear whole or not at all, and others' are read as data alone.

Folders know what grows in them, and for whom. A path, a link or a pickled object in a study, a
portfolio or a matrix that somebody else wrote must not make this process read, copy or run what its
user never named.
"""

from __future__ import annotations

import contextlib
import json
import os
import stat
import threading
import unicodedata
import zipfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import IO, Any

import numpy as np
from filelock import FileLock, Timeout
from numpy.typing import NDArray

from mbtl.errors import InvalidInput, StorageError, cannot_write, written
from mbtl.settings import first_difference


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
        with written(path):
            with unfinished.open("wb") as file:
                yield file
                file.flush()
                os.fsync(file.fileno())
            unfinished.replace(path)
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
        # ends with the process, however it ends
        lock = FileLock(folder / ".lock", blocking=False).acquire()
    except Timeout as error:
        raise StorageError(
            f"another process works in {folder}; wait until it has ended, or choose another folder"
        ) from error
    except OSError as error:
        raise cannot_write(folder, error) from error
    with lock:
        _check_claim(folder, json.loads(json.dumps(settings)), what)
        yield


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
        with written(file):
            if not file.exists():
                with whole_file(file) as writing:
                    writing.write((json.dumps(record, indent=2) + "\n").encode())
            there = read_json(file.read_text(encoding="utf-8"))
        if not isinstance(there, dict):
            raise ValueError(f"a JSON {type(there).__name__}")
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


# ---- what others may have written ----------------------------------------------------------------


MALFORMED = (TypeError, ValueError, LookupError, AttributeError, ArithmeticError)
"""What taking a record apart raises where it is of another form than ours."""


MOST_BYTES = 1 << 31
"""Of all arrays that are read from one file."""

_ONE_AT_A_TIME = threading.Lock()
"""Numpy parses headers by `ast`, in which threads disturb each other in Python 3.11 (gh-106905)."""


def is_local(name: object) -> bool:
    """True for a relative path that stays below where it starts, on any system."""
    if not isinstance(name, str) or any(unicodedata.category(c) in ("Cc", "Cs") for c in name):
        return False  # control characters and halves of a pair are in no honest name
    paths = PurePosixPath(name), PureWindowsPath(name)
    return bool(paths[0].parts) and not any(p.anchor or ".." in p.parts for p in paths)


def inside(root: Path, name: str, owner: str) -> Path:
    """The path `name` below `root`, with no link on the way.

    Args:
        root: may itself be reached by links.
        name: relative, with "/" between its parts.
        owner: of the folder, for the message, e.g. "a portfolio".

    Raises:
        StorageError: it is absolute, leads out by "..", or passes a link.
    """
    if not is_local(name):
        raise StorageError(f"{owner} names files inside its own folder, got {name!r} in {root}")
    path = root
    try:
        for part in PurePosixPath(name).parts:
            path = path / part
            if path.is_symlink():
                raise _link(path, owner)
        if not path.resolve().is_relative_to(root.resolve()):  # links of other systems
            raise _link(path, owner)
    except OSError as error:
        raise StorageError(f"{path} cannot be looked at ({error.strerror or error})") from error
    return path


def regular_files(root: Path, owner: str) -> list[str]:
    """Every file below `root`, relative to it with "/" between parts, in order.

    Raises:
        StorageError: a link, a pipe, a device, or a folder that cannot be read.
    """
    found, folders = [], [root]
    try:
        while folders:
            for path in folders.pop().iterdir():
                mode = path.lstat().st_mode
                if stat.S_ISLNK(mode):
                    raise _link(path, owner)
                if stat.S_ISDIR(mode):
                    folders.append(path)
                elif stat.S_ISREG(mode):
                    found.append(path.relative_to(root).as_posix())
                else:
                    raise StorageError(
                        f"{owner} holds plain files, got the pipe or device {path}; remove it"
                    )
    except OSError as error:
        raise StorageError(f"{root} cannot be read ({error.strerror or error})") from error
    return sorted(found)


def read_json(text: str | bytes) -> Any:
    """Parsed JSON.

    Raises:
        ValueError: whatever is wrong with it.
    """
    try:
        return json.loads(text)
    except RecursionError:
        raise ValueError("lists or objects are nested too deeply") from None


def read_arrays(
    file: IO[bytes], wanted: Callable[[str], bool] = lambda name: True
) -> dict[str, NDArray[Any]]:
    """Arrays of an `.npz` file by name; pickled objects are never loaded.

    A few megabytes can unfold to many gigabytes: nothing is unpacked before its size is known.

    Args:
        file: to read.
        wanted: whether an array of this name is read; others stay packed.

    Raises:
        ValueError: it is no archive of plain arrays, a damaged one, or larger than `MOST_BYTES`.
    """
    try:
        if file.read(len(np.lib.format.MAGIC_PREFIX)) == np.lib.format.MAGIC_PREFIX:
            raise ValueError("a single array, no archive of named ones")
        with zipfile.ZipFile(file) as archive, _ONE_AT_A_TIME:
            files = {name.removesuffix(".npy"): name for name in archive.namelist()}
            names = [name for name in files if wanted(name)]
            total = sum(archive.getinfo(files[name]).file_size for name in names)
            if total > MOST_BYTES:
                raise ValueError(
                    f"arrays of {total / 1e9:.1f} GB; {MOST_BYTES / 1e9:.1f} GB are read at most"
                )
            arrays = {}
            for name in names:
                with archive.open(files[name]) as member:
                    arrays[name] = np.lib.format.read_array(member, allow_pickle=False)
    except Exception as error:  # numpy and zipfile raise whatever their parts raise
        raise ValueError(f"something else or a damaged file ({error})") from error
    return arrays


def _link(path: Path, owner: str) -> StorageError:
    return StorageError(
        f"files of {owner} lie inside its folder, got the link {path}; put the file itself there"
    )
