"""Artifacts: where the policies of a study are kept, whatever its database is.

A policy is written below a place that nobody else writes to: its name holds the token of the pick's
lease. The row that is told names the place and the hash of what is there, and so publishes it: an
object store has no rename. The receipt is written last; without it there is no policy.
"""

from __future__ import annotations

import atexit
import hashlib
import json
import os
import shutil
import tempfile
import uuid
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

from mbtl.errors import InvalidInput, StorageError, needs
from mbtl.files import from_home, inside, read_json, regular_files, sync_entries, sync_folder
from mbtl.study.database import check_path, database_file

RECEIPT = "trained.json"


@dataclass(frozen=True)
class Artifact:
    """A policy that is safe.

    Attributes:
        place: its folder, relative to the study's, with "/" between parts.
        sha256: of its files and their names.
    """

    place: str
    sha256: str


@dataclass(frozen=True)
class FolderStore:
    """A folder of this machine, or one that several machines share.

    Attributes:
        root: absolute; the study's own.
    """

    root: Path

    def write(
        self, place: str, fill: Callable[[Path], bool], receipt: Mapping[str, Any]
    ) -> Artifact | None:
        """Keep what `fill` writes into an empty folder; it is durable when this returns.

        It is written beside its place, and then there by one rename.

        Returns:
            None where `fill` gave False: it cannot save.
        """
        final = inside(self.root, place, "a study")
        temporary = final.with_name(f".{final.name}.{uuid.uuid4().hex[:8]}")
        try:
            temporary.mkdir(parents=True)
            if not fill(temporary):
                return None
            made = Artifact(place, _digest(temporary))
            record = json.dumps({**receipt, "sha256": made.sha256})
            (temporary / RECEIPT).write_text(record, encoding="utf-8")
            sync_folder(temporary)
            shutil.rmtree(final, ignore_errors=True)
            temporary.rename(final)
            for folder in list(final.parents)[:3]:  # the study's own is the third
                sync_entries(folder)
            return made
        finally:
            shutil.rmtree(temporary, ignore_errors=True)

    def check(self) -> None:
        """Find out that policies can be kept, before any is made, by a file that comes and goes.

        Raises:
            StorageError: nothing can be written there.
        """
        folder = self.root / "policies"
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=folder) as file:
                file.write(b"may be written")
        except OSError as error:
            raise StorageError(
                f"policies are kept in {folder}, and nothing can be written there "
                f"({error.strerror or error}), so nothing is trained; mend access, or choose "
                "another place with --artifacts (artifacts=)"
            ) from error

    def receipt(self, place: str) -> Mapping[str, Any] | None:
        """What was noted of the policy there, with its `sha256`; None: there is none."""
        try:
            return _record((inside(self.root, place, "a study") / RECEIPT).read_bytes())
        except OSError:
            return None

    def read(self, place: str, sha256: str | None = None) -> Path:
        """A folder of this machine with the policy; one that is not there, if there is none.

        Raises:
            StorageError: it is not what was told, or lies outside of the study's folder.
        """
        folder = inside(self.root, place, "a study")
        if sha256 is not None and folder.is_dir():
            _check(folder, place, sha256)
        return folder

    def remove(self, place: str) -> None:
        """Take away what is there, if anything is."""
        folder = inside(self.root, place, "a study")
        if folder.is_dir():
            shutil.rmtree(folder, ignore_errors=True)

    def partial(self, place: str) -> Path | None:
        """The file for an unfinished training, which outlives its process; None: there is none."""
        final = inside(self.root, place, "a study")
        final.parent.mkdir(parents=True, exist_ok=True)
        return final.with_name(f"{final.name}.partial")


@dataclass(frozen=True)
class RemoteStore:
    """Any place that fsspec can write to: S3, Google Cloud, Azure, SSH, ...

    Attributes:
        url: of the study's folder, e.g. "s3://bucket/studies".
    """

    url: str

    def write(
        self, place: str, fill: Callable[[Path], bool], receipt: Mapping[str, Any]
    ) -> Artifact | None:
        """File by file, the receipt last."""
        with tempfile.TemporaryDirectory() as here:
            folder = Path(here)
            if not fill(folder):
                return None
            made = Artifact(place, _digest(folder))
            names = regular_files(folder, "a study")
            with self._remote() as (files, root):
                for name in names:
                    target = f"{root}/{place}/{name}"
                    files.makedirs(target.rpartition("/")[0], exist_ok=True)
                    files.pipe_file(target, (folder / name).read_bytes())
                record = {**receipt, "sha256": made.sha256, "files": names}
                files.pipe_file(f"{root}/{place}/{RECEIPT}", json.dumps(record).encode())
        return made

    def check(self) -> None:
        """By a small object that stays."""
        with self._remote() as (files, root):
            files.makedirs(f"{root}/policies", exist_ok=True)
            files.pipe_file(f"{root}/policies/README", b"Policies of studies by mbtl.\n")

    def receipt(self, place: str) -> Mapping[str, Any] | None:
        """One small object."""
        with self._remote() as (files, root):
            try:
                return _record(files.cat_file(f"{root}/{place}/{RECEIPT}"))
            except FileNotFoundError:
                return None

    def read(self, place: str, sha256: str | None = None) -> Path:
        """A copy that lives as long as this process, fetched once."""
        folder = inside(scratch(self.url), place, "a study")
        if folder.is_dir():
            return folder
        record = self.receipt(place)
        names = record.get("files") if record else None
        if not isinstance(names, list):
            return folder
        with tempfile.TemporaryDirectory(dir=scratch(self.url)) as here:
            with self._remote() as (files, root):
                for name in names:
                    target = inside(Path(here), name, "a study")
                    target.parent.mkdir(parents=True, exist_ok=True)
                    target.write_bytes(files.cat_file(f"{root}/{place}/{name}"))
            if sha256 is not None:
                _check(Path(here), place, sha256)
            shutil.copytree(here, folder)
        return folder

    def partial(self, place: str) -> Path | None:
        """Unfinished trainings are not sent there."""
        return None

    @contextmanager
    def _remote(self) -> Iterator[tuple[Any, str]]:
        with needs("fsspec", "cluster"):
            import fsspec
        try:
            yield fsspec.core.url_to_fs(self.url)
        except StorageError:
            raise
        except ImportError as error:
            raise StorageError(
                f"{self.url} needs a package that is not installed ({error}); install it"
            ) from error
        except Exception as error:  # each kind of store has errors of its own
            raise StorageError(
                f"the artifacts at {self.url} could not be read or written "
                f"({type(error).__name__}: {error}); what was told before is kept: mend access, "
                "then run again"
            ) from error


ArtifactStore = FolderStore | RemoteStore
"""Keeps policies; it travels to other processes."""


def spools_of(database: Path | None) -> tuple[FolderStore, ...]:
    """Where policies wait that could not be saved in their store, best first: whoever runs the
    study again finds them there.

    Args:
        database: file of the study; None: it has none.
    """
    home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    beside = () if database is None else (database.parent / "waiting",)
    return tuple(FolderStore(root) for root in (*beside, Path(home, "mbtl", "waiting")))


def policy_store(address: str | None, artifacts: str | Path | None) -> ArtifactStore | None:
    """What keeps the policies of a study.

    Args:
        address: of the storage; None: the study is in memory.
        artifacts: a folder or a URL, given by the user; None: next to the database, where that is a
            file.

    Raises:
        InvalidInput: an empty text, or a path that cannot be.
    """
    if artifacts is None:
        file = None if address is None else database_file(address)
        return None if file is None else FolderStore(file.parent)
    text = str(artifacts)
    if not text:
        raise InvalidInput("artifacts must be a folder or a URL, got an empty text")
    check_path(text)
    if "://" not in text:
        return FolderStore(from_home(text).absolute())
    parts = urlsplit(text)
    if parts.scheme == "file":
        return FolderStore(Path(unquote(parts.path)).absolute())
    return RemoteStore(text.rstrip("/"))


def _digest(folder: Path) -> str:
    whole = hashlib.sha256()
    for name in regular_files(folder, "a study"):
        if name != RECEIPT:
            content = hashlib.sha256((folder / name).read_bytes()).hexdigest()
            whole.update(f"{content} {name}\n".encode())
    return whole.hexdigest()


def _check(folder: Path, place: str, sha256: str) -> None:
    if _digest(folder) != sha256:
        raise StorageError(
            f"the policy in {place} is not the one that was told: its files have changed since; "
            "restore a copy of it, or take its row back with study.void"
        )


def _record(content: bytes) -> Mapping[str, Any] | None:
    """A receipt, if it is one."""
    try:
        record = read_json(content)
    except ValueError:
        return None
    return record if isinstance(record, dict) else None


@cache
def scratch(of: str) -> Path:
    """A folder for copies of one store, or for what none keeps; removed when this process ends."""
    folder = Path(tempfile.mkdtemp(prefix="mbtl-artifacts-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder
