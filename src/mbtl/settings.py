"""Settings as JSON, compared by value: whether what is stored was made with those of today.

What is no number or text is described by what it consists of: a schedule by its code and by the
values that it holds, an object by its attributes. Nothing of it depends on the process: no
addresses, no order of sets, no line numbers, no names of modules. Code is compared as Python
compiled it, so comments, blanks and docstrings do not count.
"""

from __future__ import annotations

import contextlib
import dataclasses
import dis
import enum
import functools
import hashlib
import json
import math
import os
import re
import sys
import sysconfig
import types
from collections.abc import Iterable, Iterator, Mapping, Set
from itertools import pairwise
from pathlib import Path, PurePath
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

CODE = "python"
_PYTHON = f"{CODE}{sys.version_info.major}.{sys.version_info.minor}:"
"""Begins the digest of code: what another Python has compiled cannot be compared."""
_DEEP, _LARGE = 20, 64
"""Things in things that are looked into, and numbers of an array that are written out."""
_KINDS = 0x4 | 0x8 | 0x20 | 0x80 | 0x200
"""Flags of code that make another function of it: *args, **kwargs, generator, coroutine, both."""
_SILENT = ("NOP", "CACHE", "EXTENDED_ARG", "PRECALL")
"""Instructions that do nothing; some stand for lines of source only."""
Inside = tuple[int, ...]
"""Addresses of what is being described, from the outermost on: nothing is part of itself."""
_WAY = re.compile("_(FORWARD|BACKWARD)")
_INSTALLED = ("site-packages", "dist-packages")


def described(value: Any) -> Any:
    """Any value as it will read back from a log: equal values, equal descriptions.

    Numbers of numpy are numbers, arrays are lists (large ones a digest), classes and functions of
    installed packages are names, and own functions are their code with all that they hold:
    captured values, defaults, and what they use of their module.
    """
    return _described(value, ())


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

    Code that different versions of Python have compiled is not compared.

    Args:
        old: JSON-like.
        new: JSON-like; a setting that only one of them has is None in the other.
        path: of what is compared, before its names.
    """
    for key in [*new, *(key for key in old if key not in new)]:
        was, now = old.get(key), new.get(key)
        if isinstance(was, Mapping) and isinstance(now, Mapping):
            yield from differences(was, now, f"{path}{key}.")
        elif was != now and not _of_another_python(was, now):
            yield f"{path}{key}", was, now


def _of_another_python(was: Any, now: Any) -> bool:
    texts = [str(one).partition(":") for one in (was, now)]
    return texts[0][0] != texts[1][0] and all(
        start.startswith(CODE) and end for start, _, end in texts
    )


# ---- values ------------------------------------------------------------------------------------


def _described(value: Any, inside: Inside) -> Any:  # noqa: C901  # one line per kind of value
    """`described`, of what is part of others."""
    if value is None or isinstance(value, bool) or type(value) in (int, str):
        return value
    if isinstance(value, enum.Enum):
        return f"{type(value).__qualname__}.{value.name}"
    if isinstance(value, (int, str)):
        return int(value) if isinstance(value, int) else str(value)
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else repr(float(value))
    if id(value) in inside or len(inside) > _DEEP:
        return type(value).__qualname__
    inside = (*inside, id(value))

    def inner(item: Any) -> Any:
        return _described(item, inside)

    if isinstance(value, np.generic):
        return inner(value.item()) if not isinstance(value.item(), np.generic) else str(value)
    if isinstance(value, (bytes, bytearray)):
        return {"bytes": len(value), "sha256": _short(bytes(value))}
    if isinstance(value, PurePath):
        return str(value)
    if isinstance(value, Mapping):
        return {k if isinstance(k, str) else _text(inner(k)): inner(v) for k, v in value.items()}
    if isinstance(value, Set):
        return sorted((inner(item) for item in value), key=_text)
    if isinstance(value, (list, tuple)):
        return [inner(item) for item in value]
    if (array := _array(value)) is not None:
        return inner(array.tolist()) if array.size <= _LARGE else _digest_of(array)
    if isinstance(value, type):
        return value.__qualname__
    if isinstance(value, functools.partial):
        return {
            "partial": inner(value.func), "args": inner(value.args),
            "keywords": inner(value.keywords),
        }  # fmt: skip
    if isinstance(value, types.MethodType):
        return {"method": inner(value.__func__), "of": inner(value.__self__)}
    if isinstance(value, types.FunctionType):
        return _function(value, inside, whole=True)
    if callable(getattr(value, "__wrapped__", None)):
        return inner(value.__wrapped__)
    if isinstance(value, (types.ModuleType, types.BuiltinFunctionType, np.ufunc)):
        return value.__name__
    return {"class": type(value).__qualname__, **_parts(value, inside)}


def _parts(value: Any, inside: Inside) -> dict[str, Any]:
    """What an object consists of: fields, attributes, or what it would be pickled as."""
    if dataclasses.is_dataclass(value):
        fields = [f.name for f in dataclasses.fields(value) if f.compare]
        return {name: _described(getattr(value, name, None), inside) for name in fields}
    code = _class(type(value), {}) if callable(value) and _is_own_class(type(value)) else None
    parts = {} if code is None else {"code": code}
    if hasattr(value, "__dict__"):
        return {**parts, **{name: _described(one, inside) for name, one in vars(value).items()}}
    try:
        made = value.__reduce_ex__(2)
    except Exception:  # it cannot be taken apart: its class is all that is known
        return parts
    state = made[1:3] if isinstance(made, tuple) else made
    return {**parts, "state": _described(state, inside)}


def _array(value: Any) -> np.ndarray[Any, Any] | None:
    """An array of numpy, or of a library that can say it as one."""
    if not hasattr(type(value), "__array__") or isinstance(value, type):
        return None
    try:
        return np.asarray(value)
    except Exception:  # on another device, perhaps
        return None


def _digest_of(array: np.ndarray[Any, Any]) -> dict[str, Any]:
    content = _text(_described(array.tolist(), ())).encode() if array.dtype.hasobject else None
    digest = _short(np.ascontiguousarray(array).tobytes() if content is None else content)
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
    if isinstance(value, types.FunctionType):
        return _function(value, inside) if _is_own_file(value.__code__.co_filename) else {}
    if isinstance(value, type):
        used: dict[str, Any] = {}
        return {"code": _class(value, used), **used} if _is_own_class(value) else {}
    if isinstance(value, functools.partial):
        name = getattr(value.func, "__qualname__", type(value.func).__qualname__)
        found = _code(value.func, inside) or {"function": name}
        held = {"args": list(value.args), **value.keywords}
    else:  # an object that can be called, such as a wrapper of ours around a user's function
        found = _code(type(value), inside)
        held = getattr(value, "__dict__", {})
    for name, one in held.items():
        if callable(one) and (inner := _code(one, inside)):
            found = {**found, name: inner}
        elif found and _is_plain(one):
            found = {**found, name: _plain(one)}
    return found


def _function(
    function: types.FunctionType,
    inside: Inside,
    used: dict[str, Any] | None = None,
    *,
    whole: bool = False,
) -> dict[str, Any]:
    """Code, captured values and defaults of a function, and what it uses of its module.

    Args:
        function: anybody's; of one of a package the name stands for the code.
        inside: it and what it is part of.
        used: what others used before, by name, is added to; None: it is part of the answer.
        whole: with objects that it holds; else with plain values and functions only.
    """
    code, held, captured = function.__code__, dict[str, Any](), set(function.__code__.co_freevars)
    if own := _is_own_file(code.co_filename):
        defaults = function.__defaults__ or ()
        last = code.co_varnames[: code.co_argcount][-len(defaults) :] if defaults else ()
        held = dict(zip(last, defaults, strict=True)) | (function.__kwdefaults__ or {})
    for name, cell in zip(code.co_freevars, function.__closure__ or (), strict=True):
        with contextlib.suppress(ValueError):  # not set so far
            held[name] = cell.cell_contents
    uses: dict[str, Any] = {} if used is None else used
    found: dict[str, Any] = {"function": f"{function.__module__}.{function.__qualname__}"}
    if own:
        found = {"code": digest(code)}
        _follow(code, function.__globals__, function.__module__, uses)
    for name, value in held.items():
        if whole:
            found[name] = _described(value, inside)
        elif isinstance(value, type):
            found[name] = _class(value, uses)
        elif name in captured and isinstance(value, (list, dict, set, np.ndarray)):
            continue  # it may be filled while it runs, and the next function captures it filled
        elif _is_plain(value):
            found[name] = _plain(value)
        elif callable(value) and (inner := _code(value, inside)):
            found[name] = inner
    return {**uses, **found} if used is None else found


def _follow(code: types.CodeType, module: dict[str, Any], name: str, used: dict[str, Any]) -> None:
    """Add what code uses of its module to `used`: functions, classes, and plain values."""
    looked_up, stored = set(), set()
    for inner in _nested(code):
        for step in dis.get_instructions(inner):
            if step.opname in ("LOAD_GLOBAL", "LOAD_NAME"):
                looked_up.add(str(step.argval))
            elif step.opname in ("STORE_GLOBAL", "DELETE_GLOBAL"):
                stored.add(str(step.argval))
    for global_ in sorted(looked_up - stored - set(used)):
        value = module.get(global_)
        value = getattr(value, "__wrapped__", value)
        if isinstance(value, types.FunctionType):
            if value.__globals__ is module and _is_own_file(value.__code__.co_filename):
                used[global_] = ""  # it may use itself
                parts = _function(value, (id(value),), used)
                used[global_] = parts["code"] if len(parts) == 1 else parts
        elif isinstance(value, type):
            if value.__module__ == name and _is_own_class(value):
                used[global_] = ""
                used[global_] = _class(value, used)
        elif global_ in module and _is_plain(value):
            used[global_] = _plain(value)


def _class(value: type, used: dict[str, Any]) -> str:
    """Digest of the methods and plain attributes of an own class; of others the name."""
    if not _is_own_class(value):
        return value.__qualname__
    parts: dict[str, Any] = {}
    for name, one in vars(value).items():
        one = getattr(one, "__func__", getattr(one, "fget", getattr(one, "__wrapped__", one)))
        if isinstance(one, types.FunctionType):
            parts[name] = digest(one.__code__)
            _follow(one.__code__, one.__globals__, value.__module__, used)
        elif not name.startswith("__") and _is_plain(one):
            parts[name] = _plain(one)
    for base in value.__bases__:
        if base.__qualname__ not in used:
            parts[f"base {base.__qualname__}"] = _class(base, used)
    return _PYTHON + _short(_text(parts).encode())


def digest(code: types.CodeType) -> str:
    """What code does, in a few letters: the same wherever it stands, and however it is laid out."""
    return _PYTHON + _short("\n".join(_instructions(code)).encode("utf-8", "surrogatepass"))


def _instructions(code: types.CodeType) -> Iterable[str]:
    """Instructions with what they are about, in place of numbers of lines and constants."""
    steps = list(dis.get_instructions(code))
    places, place, onward = {}, 0, {}
    for step in steps:
        places[step.offset] = place
        place += step.opname not in _SILENT
        if step.opname.startswith("JUMP_") and "IF" not in step.opname:
            onward[places[step.offset]] = step.argval
    arguments = code.co_argcount + code.co_kwonlyargcount
    yield f"{code.co_flags & _KINDS} {code.co_argcount} {code.co_posonlyargcount}"
    yield " ".join(code.co_varnames[: arguments + 2 * bool(code.co_flags & 0xC)])
    documented = {a.offset for a, b in pairwise(steps) if b.argval == "__doc__"}  # a class
    for step in steps:
        if step.opname in _SILENT or step.offset in documented or step.argval == "__doc__":
            continue
        about, name = step.argval, step.opname
        if step.opcode in dis.hasjrel or step.opcode in dis.hasjabs:
            target = places.get(about, place)
            for _ in onward:  # a jump to a jump is shortened where both stand in one line
                target = places.get(onward.get(target, -1), target)
            about, name = target, _WAY.sub("", step.opname)
        elif step.opcode in dis.hasconst:
            about = _constant(about)
        yield f"{name} {about}"
    for entry in getattr(dis.Bytecode(code), "exception_entries", ()):
        marks = (places.get(at, place) for at in (entry.start, entry.end, entry.target))
        yield " ".join(map(str, (*marks, entry.depth, entry.lasti)))


def _constant(value: Any) -> str:
    if isinstance(value, types.CodeType):
        return digest(value)
    if isinstance(value, tuple):
        return f"({' '.join(map(_constant, value))})"
    if isinstance(value, frozenset):
        return f"{{{' '.join(sorted(map(_constant, value)))}}}"
    return repr(value)


def _nested(code: types.CodeType) -> Iterable[types.CodeType]:
    yield code
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            yield from _nested(constant)


def _is_plain(value: Any) -> bool:
    """Numbers, texts, and collections of those: they mean the same in every run."""
    if isinstance(value, Mapping):
        return all(map(_is_plain, value)) and all(map(_is_plain, value.values()))
    if isinstance(value, (tuple, list, Set)):
        return all(map(_is_plain, value))
    simple = (bool, int, float, str, np.number, np.bool_)
    if isinstance(value, np.ndarray):
        return not value.dtype.hasobject
    return value is None or isinstance(value, simple)


def _plain(value: Any) -> Any:
    """Described, without absolute paths."""
    if isinstance(value, str):
        return "a path" if os.path.isabs(value) else value
    if isinstance(value, Mapping):
        return {str(key): _plain(one) for key, one in value.items()}
    if isinstance(value, (tuple, list)):
        return [_plain(one) for one in value]
    return described(value)


@functools.cache
def _is_own_file(name: str) -> bool:
    """Whether code is a user's: neither ours, nor Python's, nor of an installed package."""
    if name.startswith("<frozen"):
        return False
    path = Path(name)
    if any(part in _INSTALLED for part in path.parts):
        return False
    others = [sysconfig.get_path("stdlib"), str(Path(__file__).parent)]
    return not any(path.is_relative_to(folder) for folder in others)


def _is_own_class(value: type) -> bool:
    """By the file of its module; one that was typed in has none."""
    module = sys.modules.get(value.__module__)
    if module is None or value.__module__ == "builtins":
        return value.__module__ != "builtins"
    file = getattr(module, "__file__", None)
    if file is None:
        return value.__module__ == "__main__"
    return _is_own_file(file)
