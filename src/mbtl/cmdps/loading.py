"""Finding a user's own problem: `module:attribute` or `path/to/file.py:attribute`."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

from mbtl.cmdps.cmdp import CMDP
from mbtl.cmdps.registry import get_cmdp
from mbtl.errors import InvalidInput, unknown_name

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
            public = [known for known in dir(found) if not known.startswith("_")]
            raise unknown_name(f"attribute of {source!r}", name, public) from None
    return found


def resolve_cmdp(
    name: str,
    *,
    visibility: str | None = None,
    physics: str = "intended",
    engine: str | None = None,
) -> CMDP:
    """A CMDP by id, or a user's own by `module:attribute`.

    Args:
        name: id, or "module:attribute".
        visibility: of ours, what of the context the policy sees; see `get_cmdp`.
        physics: of ours, how contexts act on CartPole.
        engine: where one of ours is simulated.

    Raises:
        UnknownName: no CMDP has this id.
        InvalidInput: no CMDP is there, it cannot be imported, or a switch for a user's own.
    """
    if ":" not in name:
        if name.endswith(".py"):
            raise InvalidInput(
                f"a file needs the name of the CMDP inside it, got {name!r}; write {name}:<name>"
            )
        return get_cmdp(name, visibility=visibility, physics=physics, engine=engine)
    if visibility is not None or engine is not None or physics != "intended":
        raise InvalidInput(
            "visibility, physics and engine are switches of our CMDPs, got "
            f"{visibility or engine or physics!r} with {name!r}; set it in your problem"
        )
    found = load_object(name)
    if not isinstance(found, CMDP):
        raise InvalidInput(
            f"{name!r} must be a CMDP, got {_kind(found)}; build one with CMDP.from_functions or "
            "CMDP.from_env"
        )
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
    except Exception as error:
        raise _failed(name, error) from error


def _failed(name: str, error: Exception) -> InvalidInput:
    return InvalidInput(
        f"{name!r} must import without an error, got {type(error).__name__}: {error}"
    )


def _kind(found: Any) -> str:
    return "a function" if callable(found) and not isinstance(found, type) else repr(type(found))
