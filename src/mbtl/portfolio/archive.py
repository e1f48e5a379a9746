"""Portfolio folders: a JSON manifest, one array file, one folder per policy; no pickle of ours.

    portfolio.json             what it is, with the SHA-256 of every other file
    returns.npz                returns (k, N), float64, and what else is known of the rows
    policies/source-0049/...   whatever the trainer saved

A folder is built beside its place and renamed into it, so one that exists is whole. It may come
from a stranger: nothing outside it is read, and nothing in it that the manifest does not list.
The format and what is safe to open: docs/portfolio-format.md.
"""

from __future__ import annotations

import hashlib
import json
import platform
import shutil
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbtl.arrays import Array, python_value
from mbtl.errors import InvalidInput, StorageError
from mbtl.files import (
    MALFORMED,
    inside,
    read_arrays,
    read_json,
    regular_files,
    sync_entries,
    sync_folder,
)
from mbtl.portfolio.mlp import MLPPolicy, is_mlp_folder
from mbtl.version import installed

FORMAT = 2
"""Of the folder; another one is not read."""
KIND = "mbtl portfolio"
MANIFEST = "portfolio.json"
RETURNS = "returns.npz"
OWNER = "a portfolio"

_RECORDED_LIBRARIES = ("mbtl", "numpy", "gymnasium", "stable-baselines3", "sb3-contrib", "torch")

READERS: dict[str, Callable[[Path], Any]] = {}
"""Policy format -> folder -> policy, for formats of adapters, which are outside the core; the
package itself names them (`mbtl/__init__.py`), so that nothing here knows of them."""

Record = dict[str, Any]
SavedPolicy = tuple[str, Path | None, Any]
"""Folder name, where it was saved (None: nowhere), the policy itself if it is at hand."""


def write_portfolio(
    folder: Path,
    record: Record,
    arrays: Mapping[str, Array],
    policies: Sequence[SavedPolicy],
    *,
    overwrite: bool,
) -> Path:
    """Write a whole portfolio folder, or nothing.

    Args:
        folder: does not exist, is empty, or holds a portfolio and `overwrite` is set.
        record: JSON-able description; hashes, policies and versions are added here.
        arrays: "returns" (k, N), and what else is known of the rows.
        policies: k entries.
        overwrite: replace the portfolio that is there.

    Raises:
        InvalidInput: something else is in the way, or the record is not JSON-able.
        StorageError: the place cannot be written, or a policy folder is gone.
    """
    try:
        place = folder.resolve()
        place.parent.mkdir(parents=True, exist_ok=True)
        _put_back(place)
        _check_place(place, overwrite)
        partial = Path(tempfile.mkdtemp(prefix=f".{place.name}.partial-", dir=place.parent))
        try:
            _fill(partial, record, arrays, policies)
            _swap(partial, place)
        finally:
            shutil.rmtree(partial, ignore_errors=True)
    except OSError as error:
        raise StorageError(
            f"a portfolio needs a place that can be written, got {error} at {folder}; "
            "free space or choose another folder"
        ) from error
    return folder


def read_portfolio(folder: Path) -> tuple[Record, dict[str, Array], list[Path | None]]:
    """Manifest, arrays by name, the folder of each policy; every file checked by its hash.

    Raises:
        StorageError: not a portfolio, a file is missing, changed or not listed, a link or a path
            leads out of the folder, or the format is newer.
    """
    try:
        folder = _standing(folder)
        manifest = _read_manifest(folder)
        folders = [
            None if name is None else inside(folder, name, OWNER) for name in manifest["policies"]
        ]
        _check_files(folder, dict(manifest["files"]))
        with (folder / RETURNS).open("rb") as file:
            arrays = {name: _real(name, array) for name, array in read_arrays(file).items()}
        arrays["returns"]
    except (*MALFORMED, OSError) as error:
        raise StorageError(
            f"{folder / MANIFEST} must describe a whole portfolio, got {error!r}; save it again"
        ) from error
    return manifest, arrays, folders


def load_policy(
    folder: Path, policy_format: str, load: Callable[[Path], Any] | None, *, trust: bool = False
) -> Any:
    """Read one policy folder.

    A user's `load` reads everything. Else a numpy copy is preferred, because it executes nothing;
    a Stable-Baselines3 zip, which can execute code, is the last resort and needs `trust`.

    Raises:
        InvalidInput: the format is a user's own and `load` is missing, or it needs `trust`.
        StorageError: the folder is gone or cannot be read.
        MissingExtra: reading it needs a library that is not installed.
    """
    if not folder.is_dir():
        raise StorageError(
            f"the policy folder {folder} must exist; it was moved or deleted, or the study keeps "
            "its policies elsewhere: give artifacts= as it was made with"
        )
    if load is not None:
        return load(folder)
    if is_mlp_folder(regular_files(folder, "a policy")):
        return MLPPolicy.load(folder)
    if policy_format not in READERS:
        raise InvalidInput(
            f"policies of format {policy_format!r} are read by the trainer that wrote them; pass "
            "load=<function from folder to policy>"
        )
    if not trust:
        raise InvalidInput(
            f"a Stable-Baselines3 zip can run code of whoever made it, and {folder} has no other "
            "copy of its policy; if you trust its maker, pass trust=True (--trust), or the trainer "
            "that wrote it"
        )
    return READERS[policy_format](folder)


# ---- writing -----------------------------------------------------------------------------------


def _check_place(folder: Path, overwrite: bool) -> None:
    if (folder / MANIFEST).is_file():
        if not overwrite:
            raise InvalidInput(
                f"{folder} already holds a portfolio; pass overwrite=True or another folder"
            )
    elif folder.exists() and not (folder.is_dir() and not any(folder.iterdir())):
        raise InvalidInput(
            f"a portfolio needs a folder of its own, got {folder} with other content"
        )


def _real(name: str, array: NDArray[Any]) -> Array:
    if array.dtype.kind not in "fiu":
        raise ValueError(f"{name} of {array.dtype}, which are no real numbers")
    return np.asarray(array, dtype=np.float64)


def _fill(
    root: Path, record: Record, arrays: Mapping[str, Array], policies: Sequence[SavedPolicy]
) -> None:
    """Write every file of a portfolio into an empty folder, to the disk."""
    root.chmod(0o755)  # mkdtemp's 0o700 would lock out everyone the portfolio is shared with
    np.savez(root / RETURNS, **arrays)  # type: ignore[arg-type]
    folders = [_write_policy(root, *policy) for policy in policies]
    files = regular_files(root, OWNER)
    manifest = {
        "kind": KIND,
        "format": FORMAT,
        **record,
        "policies": folders,
        "files": {name: _sha256(root / name) for name in files},
        "versions": {"python": platform.python_version(), **installed(*_RECORDED_LIBRARIES)},
    }
    try:
        text = json.dumps(manifest, indent=2, allow_nan=False, default=python_value)
    except (TypeError, ValueError) as error:
        raise InvalidInput(
            f"a portfolio's metadata and context values must be JSON-able, got {error}"
        ) from error
    (root / MANIFEST).write_text(text + "\n", encoding="utf-8")
    sync_folder(root)


def _write_policy(root: Path, name: str, saved: Path | None, policy: Any) -> str | None:
    """Its folder below the portfolio; None: its trainer could not save it."""
    place = f"policies/{name}"
    target = root / place
    if saved is not None:
        if not saved.is_dir():
            raise StorageError(
                f"the policy folder {saved} must exist; it was moved or deleted: put it back, or "
                "start the study afresh (--new, or another name)"
            )
        regular_files(saved, "a policy")  # a copy must not follow what leads elsewhere
        shutil.copytree(saved, target, symlinks=True)
    elif isinstance(policy, MLPPolicy):
        target.mkdir(parents=True)
        policy.save(target)
    else:
        return None
    return place


def _swap(partial: Path, folder: Path) -> None:
    """Rename the finished folder into place; an old portfolio is moved aside, then removed.

    Whatever happens between the two renames, the old one is kept: it is put back here, or by the
    next `save`, and read where it is until then (`_standing`).
    """
    if (folder / MANIFEST).is_file():
        folder.rename(_aside(folder))
    try:
        partial.rename(folder)
        sync_entries(folder.parent)
    finally:
        _put_back(folder)


def _put_back(folder: Path) -> None:
    """Undo a replacement that was cut short; where it was not, remove what it replaced."""
    old = _aside(folder)
    if not folder.exists() and (old / MANIFEST).is_file():
        old.rename(folder)
    if (folder / MANIFEST).is_file():
        (old / MANIFEST).unlink(missing_ok=True)  # what is half removed is none
        shutil.rmtree(old, ignore_errors=True)


def _standing(folder: Path) -> Path:
    """The folder; of a replacement that was cut short, the old portfolio where it was put."""
    old = _aside(folder.resolve())
    return old if not folder.exists() and (old / MANIFEST).is_file() else folder


def _aside(folder: Path) -> Path:
    """Where a portfolio is while another one takes its place."""
    return folder.with_name(f".{folder.name}.mbtl-replaced")


# ---- reading -----------------------------------------------------------------------------------


def _read_manifest(folder: Path) -> Record:
    path = folder / MANIFEST
    try:
        manifest = read_json(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise StorageError(
            f"a portfolio folder holds {MANIFEST}, got {folder} without it; it is another folder, "
            "or its copy is not complete"
        ) from None
    except (OSError, ValueError) as error:
        raise StorageError(f"{path} must be readable JSON, got {error}") from error
    if not isinstance(manifest, dict) or manifest.get("kind") != KIND:
        raise StorageError(f"{path} must describe a portfolio (kind {KIND!r}), got something else")
    found = manifest.get("format")
    if not isinstance(found, int) or found > FORMAT:
        versions = manifest.get("versions")
        writer = versions.get("mbtl", "?") if isinstance(versions, dict) else "?"
        raise StorageError(
            f"portfolio formats up to {FORMAT} are known, got {found!r} written by mbtl {writer}; "
            "install that version or a newer one"
        )
    return manifest


def _check_files(folder: Path, listed: Mapping[str, str]) -> None:
    for name in listed:
        inside(folder, name, OWNER)
    found = set(regular_files(folder, OWNER))
    for name, digest in listed.items():
        if name not in found:
            raise StorageError(
                f"the portfolio in {folder} lists {name}, which is missing; copy it again"
            )
        if _sha256(folder / name) != digest:
            raise StorageError(
                f"{name} in the portfolio {folder} must be as it was saved (SHA-256 "
                f"{digest[:12]}...), got other content; copy it again"
            )
    for name in sorted(found - {*listed, MANIFEST}):
        raise StorageError(
            f"a portfolio holds only what its manifest lists, got {name} in {folder}; move it "
            "elsewhere, or copy the portfolio again"
        )


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
