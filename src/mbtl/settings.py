"""Settings as JSON, compared by value: whether what is stored was made with those of today.

What is no number or text is described by what it consists of: a schedule by its source and by the
values that it holds, an object by its attributes. Nothing of it depends on the process: no
addresses, no order of sets, no line numbers, no names of modules. Code is compared as Python's own
printer writes its source, so comments, blanks and docstrings do not count; code whose source is
nowhere, as of what was typed in, has no more than a name.
"""

from __future__ import annotations

import ast
import contextlib
import dataclasses
import enum
import functools
import hashlib
import inspect
import json
import linecache
import math
import os
import sys
import sysconfig
import types
from collections.abc import Callable, Iterator, Mapping, Set
from pathlib import Path, PurePath
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from mbtl.plain import short

CODE = "source:"
"""Begins the digest of code."""
_DEEP, _LARGE = 20, 64
"""Things in things that are looked into, and numbers of an array that are written out."""
_INSTALLED = ("site-packages", "dist-packages")
Inside = tuple[int, ...]
"""Addresses of what is being described, from the outermost on: nothing is part of itself."""
Function = ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda


def described_code(value: Any) -> dict[str, Any] | None:
    """The code of a user's function or class, and of what it uses of its own module.

    Args:
        value: anything that can be called.

    Returns:
        "code" -> digest, and by name what it uses: functions and classes of the same module as
        digests, numbers, texts and plain collections of those as they are when this is called
        first. Neither objects nor absolute paths are compared, as they differ in every run. None:
        it is a package's.
    """
    return _code(value, ()) or None


def first_difference(old: Mapping[str, Any], new: Mapping[str, Any]) -> tuple[str, Any, Any] | None:
    """Dotted name of the first setting that differs, with both values; None if all are equal."""
    return next(differences(old, new), None)


def differences(
    old: Mapping[str, Any], new: Mapping[str, Any], path: str = ""
) -> Iterator[tuple[str, Any, Any]]:
    """Dotted names of the settings that differ, with both values.

    Args:
        old: JSON-like.
        new: JSON-like; a setting that only one of them has is None in the other.
        path: of what is compared, before its names.
    """
    for key in [*new, *(key for key in old if key not in new)]:
        was, now = old.get(key), new.get(key)
        if isinstance(was, Mapping) and isinstance(now, Mapping):
            yield from differences(was, now, f"{path}{key}.")
        elif was != now:
            yield f"{path}{key}", was, now


def changed_code(known: Mapping[str, Any], given: Mapping[str, Any]) -> list[str]:
    """What changed in a user's own code, for people.

    Args:
        known: descriptions of code, by the role that it has.
        given: of today.
    """
    found = []
    for path, was, now in differences(known, given):
        role, *names = [part for part in path.split(".") if part != "code"]
        said = f"`{'.'.join(names)}`, which `{role}` uses" if names else f"`{role}`"
        values = [one for one in (was, now) if one is not None and not str(one).startswith(CODE)]
        found.append(
            f"{said} (was {short(was)}, is {short(now)})" if names and len(values) > 1 else said
        )
    return found


# ---- values ------------------------------------------------------------------------------------


def described(value: Any, inside: Inside = ()) -> Any:  # noqa: C901  # one line per kind of value
    """Any value as it will read back from a log: equal values, equal descriptions.

    Numbers of numpy are numbers, arrays are lists (large ones a digest), classes and functions of
    installed packages are names, and own functions are their code with the plain values that they
    hold and use.

    Args:
        value: to describe.
        inside: addresses of what it is part of.
    """
    if value is None or isinstance(value, bool):
        return value
    if isinstance(value, enum.Enum):
        return f"{type(value).__qualname__}.{value.name}"
    if isinstance(value, (int, str, PurePath)):
        return int(value) if isinstance(value, int) else str(value)
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else repr(float(value))
    if id(value) in inside or len(inside) > _DEEP:
        return type(value).__qualname__
    inner = functools.partial(described, inside=(*inside, id(value)))
    if isinstance(value, Mapping):
        return {k if isinstance(k, str) else _text(inner(k)): inner(v) for k, v in value.items()}
    if isinstance(value, Set):
        return sorted(map(inner, value), key=_text)
    if isinstance(value, (list, tuple)):
        return [inner(item) for item in value]
    if isinstance(value, (bytes, bytearray)):
        return {"bytes": len(value), "sha256": _short(bytes(value))}
    if hasattr(type(value), "__array__") and not isinstance(value, type):
        with contextlib.suppress(Exception):  # on another device, perhaps
            return _array(np.asarray(value))
    if isinstance(value, functools.partial):
        return {"partial": inner(value.func), "args": inner(value.args),
                "keywords": inner(value.keywords)}  # fmt: skip
    if isinstance(value, types.MethodType):
        return {"method": inner(value.__func__), "of": inner(value.__self__)}
    if isinstance(value, type):
        return value.__qualname__
    if isinstance(value, types.FunctionType) or callable(getattr(value, "__wrapped__", None)):
        name = f"{value.__module__}.{value.__qualname__}"
        return _code(value, inside) or {"function": name}
    if isinstance(value, (types.ModuleType, types.BuiltinFunctionType, np.ufunc)):
        return value.__name__
    return {"class": type(value).__qualname__, **_parts(value, inner)}


def _parts(value: Any, inner: Callable[[Any], Any]) -> dict[str, Any]:
    """What an object consists of: the code of its class, if that is called, and its attributes."""
    if dataclasses.is_dataclass(value):
        names = [field.name for field in dataclasses.fields(value) if field.compare]
        return {name: inner(getattr(value, name, None)) for name in names}
    own = callable(value) and _is_own(type(value))
    code = {"code": _class(type(value), {})} if own else {}
    return {**code, **{name: inner(one) for name, one in getattr(value, "__dict__", {}).items()}}


def _array(array: np.ndarray[Any, Any]) -> Any:
    """A list; of a large one a digest."""
    if array.size <= _LARGE or array.dtype.hasobject:
        return described(array.tolist())
    digest = _short(np.ascontiguousarray(array).tobytes())
    return {"array": str(array.dtype), "shape": list(array.shape), "sha256": digest}


def _text(value: Any) -> str:
    return json.dumps(value, sort_keys=True)


def _short(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:16]


# ---- code --------------------------------------------------------------------------------------

_FIRST: WeakKeyDictionary[Any, dict[str, Any]] = WeakKeyDictionary()
"""What functions used when they were looked at first: later they may have counted something."""


def _code(value: Any, inside: Inside) -> dict[str, Any]:
    """`described_code`; empty for what is of a package, or part of itself."""
    while callable(bare := getattr(value, "__wrapped__", getattr(value, "__func__", None))):
        value = bare
    if id(value) in inside or len(inside) > _DEEP:
        return {}
    try:
        if value not in _FIRST:
            _FIRST[value] = _code_now(value, (*inside, id(value)))
        return _FIRST[value]
    except TypeError:  # it cannot be remembered
        return _code_now(value, (*inside, id(value)))


def _code_now(value: Any, inside: Inside) -> dict[str, Any]:
    """`_code`, as the value is at this moment."""
    used: dict[str, Any] = {}
    if isinstance(value, type):
        return {"code": _class(value, used)} | used if _is_own(value) else {}
    if isinstance(value, types.FunctionType):
        return _function(value, inside, used) | used if _is_own(value) else {}
    if isinstance(value, functools.partial):
        name = getattr(value.func, "__qualname__", type(value.func).__qualname__)
        found = _code(value.func, inside) or {"function": name}
        held = {"args": list(value.args), **value.keywords}
    else:  # an object that can be called, such as a wrapper of ours around a user's function
        found, held = _code(type(value), inside), getattr(value, "__dict__", {})
    return {**found, **_held(held, inside, plain=bool(found))}


def _function(function: types.FunctionType, inside: Inside, used: dict[str, Any]) -> dict[str, Any]:
    """Code, defaults and captured values of an own function.

    What it uses of its module is added to `used`, by name. What was captured and may be filled
    while the function runs is left out: the next function captures it filled.
    """
    parameters = inspect.signature(function).parameters.values()
    held = {one.name: one.default for one in parameters if one.default is not one.empty}
    for name, cell in zip(function.__code__.co_freevars, function.__closure__ or (), strict=True):
        with contextlib.suppress(ValueError):  # not set so far
            if not isinstance(cell.cell_contents, (list, dict, set, np.ndarray)):
                held[name] = cell.cell_contents
    _follow(function, used)
    return {"code": digest(function.__code__), **_held(held, inside)}


def _held(held: Mapping[str, Any], inside: Inside, *, plain: bool = True) -> dict[str, Any]:
    """What values are part of code: own functions and classes, and what is `plain`."""
    found: dict[str, Any] = {}
    for name, one in held.items():
        if callable(one) and (inner := _code(one, inside)):
            found[name] = inner
        elif isinstance(one, type) and plain:
            found[name] = one.__qualname__
        elif plain and _is_plain(one):
            found[name] = _plain(one)
    return found


def _follow(function: types.FunctionType, used: dict[str, Any]) -> None:
    """Add what code uses of its module to `used`: functions, classes, and plain values."""
    module, node = function.__globals__, _node(function.__code__)
    inner = [] if node is None else [*ast.walk(node)]
    names = {one.id for one in inner if isinstance(one, ast.Name)}
    written = {name for one in inner if isinstance(one, ast.Global) for name in one.names}
    for name in sorted((names & module.keys()) - written - used.keys()):
        value = getattr(module[name], "__wrapped__", module[name])
        if isinstance(value, (types.FunctionType, type)):
            if value.__module__ == function.__module__ and _is_own(value):
                used[name] = ""  # it may use itself
                if isinstance(value, type):
                    used[name] = _class(value, used)
                else:
                    parts = _function(value, (id(value),), used)
                    used[name] = parts["code"] if len(parts) == 1 else parts
        elif _is_plain(value):
            used[name] = _plain(value)


def _class(value: type, used: dict[str, Any]) -> str:
    """Digest of the methods and plain attributes of an own class; of others the name."""
    if not _is_own(value):
        return value.__qualname__
    parts: dict[str, Any] = {}
    for name, one in vars(value).items():
        one = getattr(one, "__func__", getattr(one, "fget", getattr(one, "__wrapped__", one)))
        if isinstance(one, types.FunctionType):
            parts[name] = digest(one.__code__)
            _follow(one, used)
        elif not name.startswith("__") and _is_plain(one):
            parts[name] = _plain(one)
    for base in value.__bases__:
        if base.__qualname__ not in used:
            parts[f"base {base.__qualname__}"] = _class(base, used)
    return CODE + _short(_text(parts).encode())


def digest(code: types.CodeType) -> str:
    """What code does, in a few letters: the same wherever it stands, and however it is laid out."""
    node, said = _node(code), code.co_qualname
    if node is not None:
        body = node.body if isinstance(node.body, list) else [node.body]
        said = "\n".join([str(inspect.getargs(code)), *map(ast.unparse, body)])
    return CODE + _short(said.encode("utf-8", "surrogatepass"))


def _node(code: types.CodeType) -> Function | None:
    """The source of a function; None: it is nowhere."""
    linecache.checkcache(code.co_filename)
    functions = _functions("".join(linecache.getlines(code.co_filename)))
    found = functions.get((code.co_firstlineno, code.co_name), [])
    if len(found) > 1:  # lambdas in one line
        steps = [at for line, _, at, _ in code.co_positions() if line == code.co_firstlineno]
        last = max(at or 0 for at in steps)
        found = [node for node in found if node.col_offset <= last]
    return found[-1] if found else None


@functools.lru_cache(maxsize=8)
def _functions(source: str) -> dict[tuple[int, str], list[Function]]:
    """Those of a file by first line and name, from left to right, without docstrings."""
    found: dict[tuple[int, str], list[Function]] = {}
    try:
        nodes = [*ast.walk(ast.parse(source))]
    except SyntaxError:  # of a notebook's own commands
        return found
    for node in nodes:
        if isinstance(body := getattr(node, "body", None), list):
            node.body = [one for one in body if not _does_nothing(one)]  # type: ignore[attr-defined]
        if isinstance(node, Function):
            first = min([node, *getattr(node, "decorator_list", ())], key=lambda one: one.lineno)
            key = first.lineno, getattr(node, "name", "<lambda>")
            found.setdefault(key, []).append(node)
            found[key].sort(key=lambda one: one.col_offset)
    return found


def _does_nothing(statement: ast.stmt) -> bool:
    """A docstring, or `pass`."""
    said = isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant)
    return said or isinstance(statement, ast.Pass)


def _is_plain(value: Any) -> bool:
    """Numbers, texts, and collections of those: they mean the same in every run."""
    if isinstance(value, Mapping):
        return all(map(_is_plain, (*value, *value.values())))
    if isinstance(value, (tuple, list, Set)):
        return all(map(_is_plain, value))
    if isinstance(value, np.ndarray):
        return not value.dtype.hasobject
    return value is None or isinstance(value, (int, float, str, np.number, np.bool_))


def _plain(value: Any) -> Any:
    """Described, without absolute paths."""
    if isinstance(value, Mapping):
        return {str(key): _plain(one) for key, one in value.items()}
    if isinstance(value, (tuple, list)):
        return [_plain(one) for one in value]
    return "a path" if isinstance(value, str) and os.path.isabs(value) else described(value)


def _is_own(value: types.FunctionType | type) -> bool:
    """Whether a function or class is a user's; one that was typed in has no file."""
    if isinstance(value, types.FunctionType):
        return _is_own_file(value.__code__.co_filename)
    file = getattr(sys.modules.get(value.__module__), "__file__", None)
    if file is None:
        return value.__module__ not in sys.builtin_module_names
    return _is_own_file(file)


@functools.cache
def _is_own_file(name: str) -> bool:
    """Whether code is a user's: neither ours, nor Python's, nor of an installed package."""
    path = Path(name)
    if name.startswith("<frozen") or not set(_INSTALLED).isdisjoint(path.parts):
        return False
    others = (sysconfig.get_path("stdlib"), Path(__file__).parent)
    return not any(path.is_relative_to(folder) for folder in others)
