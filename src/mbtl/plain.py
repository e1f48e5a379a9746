"""Settings as they were given: made plain, or refused with the rule that they break."""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from mbtl.errors import InvalidInput

LARGEST = 1e30
"""Magnitude of any number that is told: nothing that is measured is larger, only what has diverged.

Performance is a return over the width of bounds, which is 1 / LARGEST or more. Its fourth powers,
which models take, and sums of them over all contexts, are numbers then, too.
"""


def float_of(number: Any) -> float | None:
    """As Python's own, NaN and infinite ones too; None: it is no real number."""
    if isinstance(number, (np.ndarray, complex, np.complexfloating, np.datetime64, np.timedelta64)):
        return None
    try:
        return float(number)
    except (TypeError, ValueError, OverflowError):
        return None


def is_finite(number: Any, most: float = LARGEST) -> bool:
    """True for a real number of magnitude up to `most`: neither NaN nor infinite, nor nearly so."""
    value = None if isinstance(number, (str, bytes)) else float_of(number)
    return value is not None and abs(value) <= most


def whole(name: str, number: Any, least: float = -np.inf) -> int:
    """A whole number of `least` or more, as Python's own.

    Raises:
        InvalidInput: it is none.
    """
    try:
        if isinstance(number, (np.ndarray, bool)):
            raise TypeError
        value = operator.index(number)
    except TypeError:
        raise InvalidInput(f"{name} must be a whole number, got {short(number)}") from None
    if value < least:
        raise InvalidInput(f"{name} is {least} or more, got {short(value)}")
    return value


@overload
def real(name: str, number: None) -> None: ...


@overload
def real(name: str, number: float) -> float: ...


def real(name: str, number: float | None) -> float | None:
    """A number > 0 and within `LARGEST`, as Python's own, or None.

    Raises:
        InvalidInput: it is none.
    """
    rule = f"finite and > 0, at most {LARGEST:g}"
    return _number(name, number, lambda value: 0 < value <= LARGEST, rule)


def finite(name: str, number: float | None, least: float = -LARGEST) -> float | None:
    """A number within `LARGEST`, and not below `least`, as Python's own, or None.

    Raises:
        InvalidInput: it is none.
    """
    rule = f"finite, from {least:g} to {LARGEST:g}"
    return _number(name, number, lambda value: least <= value <= LARGEST, rule)


def floats(given: Any) -> NDArray[np.float64]:
    """Numbers as float64: NaN where a masked array has none, and tensors as they are now.

    Raises:
        TypeError: they are no real numbers.
        ValueError: rows of different lengths.
    """
    if hasattr(given, "detach"):  # a tensor that gradients flow through
        given = given.detach().cpu()
    parts = given if isinstance(given, (list, tuple)) else [given]
    if any(isinstance(part, np.ma.MaskedArray) for part in parts):
        given = np.ma.array(given, dtype=np.float64).filled(np.nan)
    if np.iscomplexobj(given):
        raise TypeError("complex numbers")
    return np.asarray(given, dtype=np.float64)


def refused(numbers: NDArray[Any]) -> NDArray[np.bool_]:
    """True where one is NaN, infinite, or beyond `LARGEST`."""
    return np.asarray(~(np.abs(numbers) <= np.float64(LARGEST)))  # half precision ends before


def array_of(name: str, given: Any) -> NDArray[Any]:
    """An array of whatever kind; NaN where a masked array has no number.

    Raises:
        InvalidInput: rows of different lengths.
    """
    try:
        return floats(given) if isinstance(given, np.ma.MaskedArray) else np.asarray(given)
    except (TypeError, ValueError, OverflowError) as error:
        raise InvalidInput(
            f"{name} must be an array of rows of one length ({error!s:.90})"
        ) from error


def record(name: str, given: Any, usual: Any, *kinds: type) -> Any:
    """A record of its kind; `usual` for None.

    Raises:
        InvalidInput: it is something else.
    """
    if given is None:
        return usual
    if isinstance(given, kinds):
        return given
    raise InvalidInput(
        f"{name} must be a mbtl.{' or '.join(kind.__name__ for kind in kinds)}(...), got "
        f"{type(given).__name__} {short(given)}"
    )


def short(value: Any) -> str:
    """A value for a message: its first sixty characters."""
    try:
        shown = ascii(value)
    except ValueError:  # whole numbers of thousands of digits
        return f"a {type(value).__name__} too large to show"
    return shown if len(shown) <= 60 else f"{shown[:57]}..."


def _number(name: str, number: Any, holds: Callable[[float], bool], rule: str) -> float | None:
    """None, or a number that keeps a rule."""
    if number is None:
        return None
    value = float_of(number)
    if value is None or not holds(value):
        rule = "a number" if value is None else rule
        raise InvalidInput(f"{name} must be {rule}, got {short(number)}")
    return value
