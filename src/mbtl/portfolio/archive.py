"""Portfolio folders: a JSON manifest, one array file, one folder per policy; no pickle of ours.

    portfolio.json             what it is, with the SHA-256 of every other file
    returns.npz                returns (k, N), float64, and what else is known of the rows
    policies/source-0049/...   whatever the trainer saved

A folder is built beside its place and renamed into it, so one that exists is whole.
The format and what is safe to open: docs/portfolio-format.md.
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
import os
import platform
import shutil
import tempfile
import zipfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from mbtl.arrays import Array
from mbtl.errors import InvalidInput, StorageError
from mbtl.portfolio.mlp import MLPPolicy, is_mlp_folder

FORMAT = 2
"""2: routes heed the scatter of episodes; portfolios of format 1 hold none, and still open."""
KIND = "mbtl portfolio"
MANIFEST = "portfolio.json"
RETURNS = "returns.npz"

_RECORDED_LIBRARIES = ("mbtl", "numpy", "gymnasium", "stable-baselines3", "sb3-contrib", "torch")

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
        arrays: "returns" (k, N), and others of its shape.
        policies: k entries.
        overwrite: replace the portfolio that is there.

    Raises:
        InvalidInput: something else is in the way, or the record is not JSON-able.
        StorageError: the place cannot be written, or a policy folder is gone.
    """
    _check_place(folder, overwrite)
    partial: Path | None = None
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        partial = Path(tempfile.mkdtemp(prefix=f".{folder.name}.partial-", dir=folder.parent))
        partial.chmod(0o755)  # mkdtemp's 0o700 would lock out everyone the portfolio is shared with
        np.savez(partial / RETURNS, **arrays)  # type: ignore[arg-type]
        entries = [_write_policy(partial, *policy) for policy in policies]
        manifest = {
            "kind": KIND,
            "format": FORMAT,
            **record,
            "returns": {"file": RETURNS, "sha256": _sha256(partial / RETURNS)},
            "policies": entries,
            "versions": _versions(),
        }
        _write_manifest(partial / MANIFEST, manifest)
        _swap(partial, folder)
    except OSError as error:
        raise StorageError(
            f"a portfolio needs a place that can be written, got {error} at {folder}; "
            "free space or choose another folder"
        ) from error
    finally:
        if partial is not None and partial.exists():
            shutil.rmtree(partial, ignore_errors=True)
    return folder


def read_portfolio(folder: Path) -> tuple[Record, dict[str, Array], list[Path | None]]:
    """Manifest, arrays (k, N) by name, the folder of each policy; every file checked by its hash.

    Raises:
        StorageError: not a portfolio, a file is missing or changed, or the format is newer.
    """
    manifest = _read_manifest(folder)
    try:
        _check_file(folder, manifest["returns"]["file"], manifest["returns"]["sha256"])
        path = _inside(folder, manifest["returns"]["file"])
        with path.open("rb") as file, np.load(file, allow_pickle=False) as loaded:
            arrays = {name: np.asarray(loaded[name], np.float64) for name in loaded.files}
        arrays["returns"]
        folders: list[Path | None] = []
        for entry in manifest["policies"]:
            place = entry["folder"]
            for name, digest in entry["files"].items():
                _check_file(folder, f"{place}/{name}", digest)
            folders.append(None if place is None else _inside(folder, place))
    except (KeyError, TypeError, ValueError, AttributeError, OSError, zipfile.BadZipFile) as error:
        raise StorageError(
            f"{folder / MANIFEST} must describe a whole portfolio, got {error!r}; save it again"
        ) from error
    return manifest, arrays, folders


def load_policy(folder: Path, policy_format: str, load: Callable[[Path], Any] | None) -> Any:
    """Read one policy folder.

    A user's `load` reads everything. Else a numpy copy is preferred, because it executes nothing;
    a Stable-Baselines3 zip is the last resort.

    Raises:
        InvalidInput: the format is a user's own and `load` is missing.
        StorageError: the folder is gone or cannot be read.
        MissingExtra: reading it needs a library that is not installed.
    """
    if not folder.is_dir():
        raise StorageError(f"the policy folder {folder} must exist; it was moved or deleted")
    if load is not None:
        return load(folder)
    if is_mlp_folder([path.name for path in folder.iterdir()]):
        return MLPPolicy.load(folder)
    if policy_format == "sb3":
        from mbtl.training import load_sb3  # outside the core: needs the `train` extra

        return load_sb3(folder)
    raise InvalidInput(
        f"policies of format {policy_format!r} are read by the trainer that wrote them; pass "
        "load=<function from folder to policy>"
    )


# ---- writing -----------------------------------------------------------------------------------


def _check_place(folder: Path, overwrite: bool) -> None:
    if folder.is_dir() and not any(folder.iterdir()):
        return
    if (folder / MANIFEST).is_file():
        if overwrite:
            return
        raise InvalidInput(
            f"{folder} already holds a portfolio; pass overwrite=True or another folder"
        )
    if folder.exists():
        raise InvalidInput(
            f"a portfolio needs a folder of its own, got {folder} with other content"
        )


def _write_policy(root: Path, name: str, saved: Path | None, policy: Any) -> Record:
    place = f"policies/{name}"
    target = root / place
    if saved is not None:
        if not saved.is_dir():
            raise StorageError(
                f"the policy folder {saved} must exist; it was moved or deleted: put it back, or "
                "start the study afresh (--new, or another name)"
            )
        shutil.copytree(saved, target)
    elif isinstance(policy, MLPPolicy):
        target.mkdir(parents=True)
        policy.save(target)
    else:
        return {"folder": None, "files": {}, "reason": "its trainer could not save it"}
    files = sorted(path for path in target.rglob("*") if path.is_file())
    return {
        "folder": place,
        "files": {path.relative_to(target).as_posix(): _sha256(path) for path in files},
    }


def _write_manifest(path: Path, manifest: Record) -> None:
    try:
        text = json.dumps(manifest, indent=2, allow_nan=False, default=_plain)
    except (TypeError, ValueError) as error:
        raise InvalidInput(
            f"a portfolio's metadata and context values must be JSON-able, got {error}"
        ) from error
    temporary = path.with_suffix(".tmp")
    with temporary.open("w", encoding="utf-8") as file:
        file.write(text + "\n")
        file.flush()
        os.fsync(file.fileno())
    os.replace(temporary, path)


def _swap(partial: Path, folder: Path) -> None:
    """Rename the finished folder into place; an old portfolio is moved aside, then removed."""
    if not folder.exists():
        partial.rename(folder)
        return
    old = Path(tempfile.mkdtemp(prefix=f".{folder.name}.old-", dir=folder.parent))
    folder.replace(old / folder.name)
    try:
        partial.rename(folder)
    except OSError:
        (old / folder.name).replace(folder)
        raise
    finally:
        shutil.rmtree(old, ignore_errors=True)


def _plain(value: Any) -> Any:
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} {value!r}")


def _versions() -> dict[str, str]:
    versions = {"python": platform.python_version()}
    for name in _RECORDED_LIBRARIES:
        try:
            versions[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return versions


# ---- reading -----------------------------------------------------------------------------------


def _read_manifest(folder: Path) -> Record:
    path = folder / MANIFEST
    try:
        manifest = json.loads(path.read_text(encoding="utf-8"))
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
        writer = manifest.get("versions", {}).get("mbtl", "?")
        raise StorageError(
            f"portfolio formats up to {FORMAT} are known, got {found!r} written by mbtl {writer}; "
            "install that version or a newer one"
        )
    return manifest


def _check_file(folder: Path, name: str, digest: str) -> None:
    path = _inside(folder, name)
    if not path.is_file():
        raise StorageError(
            f"the portfolio in {folder} lists {name}, which is missing; copy it again"
        )
    if _sha256(path) != digest:
        raise StorageError(
            f"{name} in the portfolio {folder} must be as it was saved (SHA-256 {digest[:12]}...), "
            "got other content; copy it again"
        )


def _inside(folder: Path, name: str) -> Path:
    """A listed path, which must stay inside the portfolio folder."""
    parts = PurePosixPath(name).parts
    if not parts or PurePosixPath(name).is_absolute() or ".." in parts:
        raise StorageError(
            f"a portfolio lists files inside its own folder, got {name!r} in {folder}"
        )
    path = folder.joinpath(*parts)
    if not path.resolve().is_relative_to(folder.resolve()):
        raise StorageError(f"files of a portfolio lie inside its folder, got the link {path}")
    return path


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
