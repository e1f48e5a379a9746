"""Finding a user's own object: `module:attribute` or `path/to/file.py:attribute`."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

from mbtl.errors import InvalidInput, unknown_name
from mbtl.faults import FAULTS, reason_of

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
            public = _own_names(found)
            raise unknown_name(f"attribute of {source!r}", name, public) from None
    return found


def _own_names(found: Any) -> list[str]:
    """Public names that were defined there, not imported; all public ones where there is none."""
    public = [name for name in dir(found) if not name.startswith("_")]
    home = getattr(found, "__name__", None)
    if not isinstance(found, ModuleType):
        return public
    values = {name: getattr(found, name) for name in public}
    own = [
        name
        for name, value in values.items()
        if not isinstance(value, ModuleType)
        and (getattr(value, "__module__", None) == home or not isinstance(value, type | Callable))
    ]
    return own or public


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
