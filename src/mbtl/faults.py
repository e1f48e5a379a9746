"""Other people's code: how it is found, what counts as a fault of it, and how its words are shown.

A text of somebody else (the message of an error, a name, a level) may hold anything. `harmless` is
what it passes through before people see it.
"""

from __future__ import annotations

import contextlib
import importlib
import re
import sys
import traceback
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import ModuleType
from typing import Any, TextIO

from mbtl.errors import InvalidInput, TrainingFailed, unknown_name

FAULTS = (Exception, SystemExit)
"""What other people's code raises where it fails: `sys.exit` there must not end our program."""

REASON = 500
"""Characters of a reason that are kept."""
_WHERE = "in the context "
_TRACEBACK = 8000
"""Characters of a traceback that are kept: its end, which says what happened."""

_HARMFUL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069\ud800-\udfff]")
"""What moves a cursor, colours, rings, turns the direction of writing, or is half a character."""


class TookTooLong(TrainingFailed):
    """A training or an evaluation was ended at its time limit."""


def harmless(text: str, most: int | None = None) -> str:
    r"""A text of others as it may be printed: `\x1b[31m` is shown and does not colour anything.

    Args:
        text: of any origin; new lines and tabs stay.
        most: characters that are kept of it, and dots; None: all.
    """
    cut = text if most is None or len(text) <= most else f"{text[: most - 3]}..."
    return _HARMFUL.sub(lambda found: ascii(found[0])[1:-1], cut)


def say(line: str, to: TextIO | None) -> None:
    """Print a line of progress, which is not worth the work that it is about.

    A closed pipe or a full disk takes no line.
    """
    if to is None:  # a process may have no standard error
        return
    with contextlib.suppress(OSError, ValueError):  # of a closed file
        print(writable(harmless(line), to), file=to, flush=True)


def writable(text: str, to: TextIO) -> str:
    """A text in the letters that a file or terminal knows."""
    known = getattr(to, "encoding", None) or "utf-8"
    return text.encode(known, "backslashreplace").decode(known)


def reason_of(error: BaseException) -> str:
    """A fault in words, of which a log keeps no more than `REASON` characters.

    An exit is said to be one, since `SystemExit: 0` looks as if all were well.
    """
    said = f"{type(error).__name__}: {error}"
    if isinstance(error, SystemExit):
        said = f"sys.exit({error.code!r}) was called, where it must return or raise"
    where = f", {harmless(noted, REASON // 2)}" if (noted := _place_of(error)) else ""
    return harmless(said, REASON - len(where)) + where


@contextlib.contextmanager
def located(context: Mapping[str, Any] | None) -> Iterator[None]:
    """A fault in the block says in which context, if that is known: in a note for `reason_of`."""
    try:
        yield
    except FAULTS as error:
        if context and not _place_of(error):  # the innermost block knows best
            error.add_note(f"{_WHERE}{context}")
        raise


def _place_of(error: BaseException) -> str:
    notes = getattr(error, "__notes__", ())
    return next((note for note in notes if note.startswith(_WHERE)), "")


def traceback_of(error: BaseException) -> str:
    """As Python prints it, without our own frame at its beginning."""
    below = error.__traceback__.tb_next if error.__traceback__ else None
    text = "".join(traceback.format_exception(type(error), error, below or error.__traceback__))
    return harmless(text if len(text) <= _TRACEBACK else f"...\n{text[-_TRACEBACK:]}")


# ---- objects of a user's own ---------------------------------------------------------------------


_FORM = "module:attribute or path/to/file.py:attribute"


def load_object(reference: str) -> Any:
    """Import what `module:attribute` names. The working folder is searched first.

    Args:
        reference: e.g. "my_problem:make_env", "package.module:Class.method", "dir/file.py:cmdp".

    Raises:
        InvalidInput: another form, no such module or file, or the import itself failed.
        UnknownName: the module has no such attribute.
    """
    source, colon, path = reference.rpartition(":")
    if not (colon and source and path):
        raise InvalidInput(f"an object of your own is named as {_FORM}, got {reference!r}")
    found: Any = _load_file(Path(source)) if source.endswith(".py") else _load_module(source)
    for name in path.split("."):
        try:
            found = getattr(found, name)
        except AttributeError:
            public = [public for public in dir(found) if not public.startswith("_")]
            raise unknown_name(f"attribute of {source!r}", name, public) from None
    return found


def _load_file(path: Path) -> ModuleType:
    """Import a file under its own name, so that its objects can be sent to other processes."""
    if not path.is_file():
        raise InvalidInput(f"no file {str(path)!r}; give its path from here, as {_FORM}")
    module = _load_module(path.stem, folder=path.resolve().parent)
    home = getattr(module, "__file__", None)
    if home is None or Path(home).resolve() != path.resolve():
        raise InvalidInput(
            f"a file is imported under its own name, got {path.name!r} while {path.stem!r} is "
            f"already {home or 'built in'}; rename the file"
        )
    return module


def _load_module(name: str, folder: Path | None = None) -> ModuleType:
    home = str(folder or Path.cwd())
    if home not in sys.path:
        sys.path.insert(0, home)
    importlib.invalidate_caches()
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name is None or not f"{name}.".startswith(f"{error.name}."):
            raise _failed(name, error) from error
        raise InvalidInput(
            f"no module is called {name!r} in {home} or among the installed packages; run from the "
            f"folder that holds it, or give {_FORM}"
        ) from None
    except FAULTS as error:
        raise _failed(name, error) from error


def _failed(name: str, error: BaseException) -> InvalidInput:
    return InvalidInput(f"{name!r} must import without an error, got {reason_of(error)}")
