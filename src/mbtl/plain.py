"""Numbers as they were given: made plain, or refused with the rule that they break."""

from __future__ import annotations

import operator
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from mbtl.errors import InvalidInput


def float_of(number: Any) -> float | None:
    """As Python's own, NaN and infinite ones too; None: it is no real number."""
    if isinstance(number, (np.ndarray, complex, np.complexfloating, np.datetime64, np.timedelta64)):
        return None
    try:
        return float(number)
    except (TypeError, ValueError, OverflowError):
        return None


def is_finite(number: Any) -> bool:
    """True for a real number that is neither NaN nor infinite."""
    value = None if isinstance(number, (str, bytes)) else float_of(number)
    return value is not None and bool(np.isfinite(value))


def whole(name: str, number: Any) -> int:
    """A whole number, as Python's own.

    Raises:
        InvalidInput: it is none.
    """
    try:
        if isinstance(number, np.ndarray):
            raise TypeError
        return operator.index(number)
    except TypeError:
        raise InvalidInput(f"{name} must be a whole number, got {short(number)}") from None


@overload
def real(name: str, number: None) -> None: ...


@overload
def real(name: str, number: float) -> float: ...


def real(name: str, number: float | None) -> float | None:
    """A finite number > 0, as Python's own, or None.

    Raises:
        InvalidInput: it is none.
    """
    value = None if number is None else _float(name, number)
    if value is not None and not (np.isfinite(value) and value > 0):
        raise InvalidInput(f"{name} must be finite and > 0, got {short(number)}")
    return value


def finite(name: str, number: float | None) -> float | None:
    """A finite number, as Python's own, or None.

    Raises:
        InvalidInput: it is none.
    """
    value = None if number is None else _float(name, number)
    if value is not None and not np.isfinite(value):
        raise InvalidInput(f"{name} must be finite, got {short(number)}")
    return value


def array_of(name: str, given: Any) -> NDArray[Any]:
    """An array of whatever kind.

    Raises:
        InvalidInput: rows of different lengths.
    """
    try:
        return np.asarray(given)
    except (TypeError, ValueError, OverflowError) as error:
        raise InvalidInput(
            f"{name} must be an array of rows of one length ({error!s:.90})"
        ) from error


def text(name: str, given: Any) -> str:
    """A text that can be written to a file.

    Raises:
        InvalidInput: something else, or one with half a character.
    """
    if isinstance(given, str):
        try:
            given.encode()
        except UnicodeEncodeError:
            pass
        else:
            return given
    raise InvalidInput(f"{name} must be a text, got {short(given)}")


def short(value: Any) -> str:
    """A value for a message: its first sixty characters."""
    try:
        shown = ascii(value)
    except ValueError:  # whole numbers of thousands of digits
        return f"a {type(value).__name__} too large to show"
    return shown if len(shown) <= 60 else f"{shown[:57]}..."


def _float(name: str, number: Any) -> float:
    value = float_of(number)
    if value is None:
        raise InvalidInput(f"{name} must be a number, got {short(number)}")
    return value
