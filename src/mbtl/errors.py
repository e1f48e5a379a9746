"""Errors: each message gives the rule, what was received, and the fix, in one sentence.

`MbtlError` is the single root. `InvalidInput` means the caller can mend the call (the command line
exits with 2); every other error means that the work itself failed (exit 1).
"""

from __future__ import annotations

import contextlib
import difflib
from collections.abc import Collection, Iterable, Iterator, Sequence

__all__ = [
    "CheckFailed",
    "ContextMismatch",
    "InvalidInput",
    "MbtlError",
    "MissingExtra",
    "Notice",
    "SimulationFailed",
    "StorageError",
    "StudyError",
    "StudyMismatch",
    "TrainingFailed",
    "TrainingPruned",
    "UnknownName",
    "Unreachable",
    "UnsavedPolicies",
    "cannot_write",
    "check_known",
    "few",
    "missing_extra",
    "needs",
    "unknown_name",
    "written",
]


class MbtlError(Exception):
    """Root of every error this library raises on purpose."""


class InvalidInput(MbtlError, ValueError):
    """An argument breaks a stated rule."""


class UnknownName(InvalidInput, LookupError):
    """A name (CMDP, selector, axis, ...) that nothing is registered under."""


class MissingExtra(MbtlError, ImportError):
    """An optional dependency is not installed."""


class ContextMismatch(InvalidInput):
    """A context does not belong to the context space."""


class StudyError(MbtlError):
    """A study cannot do what was asked in its present state."""


class StudyMismatch(StudyError, InvalidInput):
    """A stored study was made for another problem or with other settings."""


class StorageError(MbtlError):
    """The event log cannot be read or written."""


class Unreachable(StorageError):
    """The server of the event log does not answer now; it may in a moment."""


class TrainingFailed(MbtlError):
    """A training or evaluation gave nothing that can be used."""


class TrainingPruned(MbtlError):
    """A training is ended early on purpose: raised in `on_progress`, or by a user's own training.

    It spends budget and is not proposed again, but does not count as something that went wrong.
    """


class SimulationFailed(TrainingFailed):
    """A simulator stopped, crashed, or reached a state that no episode can go on from."""


class CheckFailed(MbtlError):
    """A CMDP breaks the contract that `mbtl check` tests."""


class Notice(UserWarning):
    """What a user should know at once; commands print it as a line."""


class UnsavedPolicies(Notice):
    """A study that is stored makes policies that are not."""


def unknown_name(kind: str, name: str, known: Iterable[str], *, hint: str = "") -> UnknownName:
    """Build the error for a mistyped name, with the nearest known one.

    Args:
        kind: what is being looked up, e.g. "CMDP".
        name: what was received.
        known: every valid name.
        hint: a sentence that says where the valid names are listed.
    """
    names = sorted(known)
    near = difflib.get_close_matches(name, names, n=1, cutoff=0.5)
    guess = f" Did you mean {near[0]!r}?" if near else ""
    where = f" {hint}" if hint else f" Known: {', '.join(names)}." if names else " There are none."
    return UnknownName(f"no {kind} is called {name!r}.{guess}{where}")


def check_known(kind: str, name: str, known: Collection[str], *, hint: str = "") -> None:
    """Raise `unknown_name` of the same arguments unless `name` is among the known ones.

    Raises:
        UnknownName: it is not.
    """
    if name not in known:
        raise unknown_name(kind, name, known, hint=hint)


def few(names: Sequence[str], most: int = 3) -> str:
    """The first of some names, for a message that may not grow long."""
    return ", ".join(names[:most]) + (", ..." if len(names) > most else "")


def cannot_write(path: object, error: OSError) -> StorageError:
    """Build the error for a file that the system refuses to write."""
    return StorageError(
        f"{path} cannot be written ({error.strerror or error}); choose another place"
    )


@contextlib.contextmanager
def written(path: object) -> Iterator[None]:
    """Raise `cannot_write` where the system refuses something while the block runs.

    Raises:
        StorageError: `path` cannot be written.
    """
    try:
        yield
    except OSError as error:
        raise cannot_write(path, error) from error


def missing_extra(package: str, extra: str) -> MissingExtra:
    """Build the error for an optional dependency, with the one-line install."""
    how = f"pip install 'mbtl[{extra}]'"
    if extra == "train":
        how += " (without a GPU install PyTorch's CPU build first, see pytorch.org)"
    return MissingExtra(f"{package} is needed for this and is not installed; run: {how}")


@contextlib.contextmanager
def needs(package: str, extra: str) -> Iterator[None]:
    """Raise `missing_extra` where a module is missing that the block imports.

    Raises:
        MissingExtra: it is not installed.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        raise missing_extra(package, extra) from error
