"""Axes: one named dimension of a context each, with its unit and its map to the unit interval.

A numeric axis maps to one column in [0, 1]. A categorical axis with L levels maps to L columns,
one-hot over sqrt(2), so that two different levels are at distance exactly 1.
"""

from __future__ import annotations

import contextlib
import math
import numbers
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from typing import Any

import numpy as np

from mbtl.arrays import Array
from mbtl.errors import ContextMismatch, InvalidInput, unknown_name
from mbtl.plain import short

Value = float | int | str

MOST = 10_000_000
"""Contexts of a space: a few GB."""
SINGLE = 2.0**-22
"""Two units in the last place of single precision: what float32 does to a number, relatively."""
_LEAST_ROUNDING, _MOST_ROUNDING = 1e-9, 1e-3
"""Share of an axis that rounding may move a value by: of sums and powers, and at most."""


class Axis(ABC):
    """One dimension of a context space."""

    name: str
    unit: str

    @property
    def label(self) -> str:
        """Name and unit for people, e.g. "length [m]"."""
        return f"{self.name} [{self.unit}]" if self.unit else self.name

    @property
    @abstractmethod
    def width(self) -> int:
        """Number of unit-cube columns."""

    @property
    def rounding(self) -> float:
        """How far apart in the unit cube two values may be that are one in single precision."""
        return _LEAST_ROUNDING

    @abstractmethod
    def own(self, values: Sequence[Any]) -> list[Value]:
        """The values as contexts of this axis hold them: Python's own, whole ones as `int`.

        Raises:
            ContextMismatch: a value is of another kind than the axis.
        """

    @abstractmethod
    def encode(self, values: Sequence[Value]) -> Array:
        """Values -> (len(values), width) unit columns.

        Raises:
            ContextMismatch: a value lies outside the axis.
        """

    @abstractmethod
    def decode(self, unit: Array) -> list[Value]:
        """(n, width) unit columns -> values; the inverse of `encode` up to rounding."""

    @abstractmethod
    def spread(self, n: int) -> list[Value]:
        """`n` values evenly spaced on the unit interval, both ends included."""

    @abstractmethod
    def to_json(self) -> dict[str, Any]:
        """JSON-able record; `axis_from_json` reads it."""


@dataclass(frozen=True)
class _Numeric(Axis):
    """Shared frame of the numeric axes: bounds, checks, JSON, and an even scale."""

    name: str
    low: float
    high: float
    unit: str = ""

    def __post_init__(self) -> None:
        _check_names(self.name, self.unit)
        for bound in ("low", "high"):
            given = getattr(self, bound)
            number = _number(given)
            if number is None:
                raise InvalidInput(f"axis {self.name!r} needs numbers as bounds, got {given!r}")
            object.__setattr__(self, bound, number)
        if not (self.low < self.high and math.isfinite(self.high - self.low)):
            raise InvalidInput(
                f"axis {self.name!r} needs finite bounds with low < high, "
                f"got ({self.low}, {self.high})"
            )

    @property
    def width(self) -> int:
        """One column."""
        return 1

    def own(self, values: Sequence[Any]) -> list[Value]:
        """Finite numbers; see `Axis.own`."""
        with contextlib.suppress(ValueError):  # the usual case at once; ragged lists are no arrays
            array = np.asarray(values)
            if array.ndim == 1 and array.dtype.kind in "fiu" and np.isfinite(array).all():
                return list(
                    (array.astype(np.float64) if array.dtype.kind == "f" else array).tolist()
                )
        return [self._own(value) for value in values]

    def _own(self, value: Any) -> float | int:
        number = _number(value)
        if number is None:
            raise ContextMismatch(f"axis {self.name!r} takes finite numbers, got {value!r}")
        return number

    @property
    def rounding(self) -> float:
        """Of the largest values; see `Axis.rounding`."""
        largest = max(abs(self.low), abs(self.high))
        return _rounding(SINGLE * (largest / (self.high - self.low)))

    @property
    def _limits(self) -> tuple[float, float]:
        """Low and high, with room for rounding."""
        slack = self.rounding * (self.high - self.low)
        return self.low - slack, self.high + slack

    def _checked(self, values: Sequence[Value]) -> Array:
        array = np.asarray(self.own(values), dtype=np.float64)
        low, high = self._limits
        bad = ~((array >= low) & (array <= high))
        if bad.any():
            span = f"[{self.low:g}, {self.high:g}] {self.unit}".rstrip()
            raise ContextMismatch(
                f"axis {self.name!r} takes values in {span}, got {float(array[bad][0])!r}; "
                "widen the axis or leave this context out"
            )
        return np.clip(array, self.low, self.high)

    def encode(self, values: Sequence[Value]) -> Array:
        """Unit column of the share of the range that lies below each value."""
        return ((self._checked(values) - self.low) / (self.high - self.low))[:, None]

    def decode(self, unit: Array) -> list[Value]:
        """Values; see `Axis.decode`."""
        return list((self.low + unit[:, 0] * (self.high - self.low)).tolist())

    def spread(self, n: int) -> list[Value]:
        """`n` values at equal differences."""
        return list(np.linspace(self.low, self.high, n).tolist())

    def to_json(self) -> dict[str, Any]:
        """Kind, name, unit and bounds."""
        record = {"kind": type(self).__name__.lower(), "name": self.name, "unit": self.unit}
        return {**record, "low": self.low, "high": self.high}


@dataclass(frozen=True)
class Linear(_Numeric):
    """A continuous axis on which equal differences mean equal change."""


@dataclass(frozen=True)
class Log(_Numeric):
    """A continuous positive axis on which equal ratios mean equal change."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.low <= 0:
            raise InvalidInput(f"log axis {self.name!r} needs low > 0, got {self.low}; use Linear")
        if not math.isfinite(self.high / self.low):
            raise InvalidInput(
                f"log axis {self.name!r} needs bounds whose ratio is a number, got ({self.low}, "
                f"{self.high})"
            )

    @property
    def rounding(self) -> float:
        """The same for all values; see `Axis.rounding`."""
        return _rounding(SINGLE / math.log(self.high / self.low))

    @property
    def _limits(self) -> tuple[float, float]:
        slack = (self.high / self.low) ** self.rounding
        return self.low / slack, self.high * slack

    def encode(self, values: Sequence[Value]) -> Array:
        """Unit column, proportional to the logarithm of the value."""
        return (np.log(self._checked(values) / self.low) / math.log(self.high / self.low))[:, None]

    def decode(self, unit: Array) -> list[Value]:
        """Values; see `Axis.decode`."""
        return list((self.low * (self.high / self.low) ** unit[:, 0]).tolist())

    def spread(self, n: int) -> list[Value]:
        """`n` values at equal ratios."""
        return list(np.geomspace(self.low, self.high, n).tolist())


@dataclass(frozen=True)
class Integer(_Numeric):
    """An axis of whole numbers, evenly spaced; both bounds are whole."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.low != round(self.low) or self.high != round(self.high):
            raise InvalidInput(
                f"axis {self.name!r} needs whole bounds, got ({self.low}, {self.high}); use Linear"
            )

    @property
    def rounding(self) -> float:
        """That of sums alone, since neighbouring numbers are others; see `Axis.rounding`."""
        return _LEAST_ROUNDING

    @property
    def _limits(self) -> tuple[float, float]:
        return self.low, self.high  # values are whole by then

    def own(self, values: Sequence[Any]) -> list[Value]:
        """Whole numbers; see `Axis.own`."""
        return [self._whole(value) for value in super().own(values)]

    def _whole(self, value: Any) -> int:
        whole: int = round(value)
        if abs(value - whole) <= _rounding(SINGLE * abs(value)):
            return whole
        raise ContextMismatch(f"axis {self.name!r} takes whole numbers, got {value!r}; use Linear")

    def decode(self, unit: Array) -> list[Value]:
        """The nearest whole numbers."""
        return [int(v) for v in np.round(self.low + unit[:, 0] * (self.high - self.low))]

    def spread(self, n: int) -> list[Value]:
        """`n` distinct whole numbers; raises `InvalidInput` when there are fewer."""
        values = np.round(np.linspace(self.low, self.high, n)).astype(int)
        if len(np.unique(values)) < n:
            count = int(self.high - self.low) + 1
            raise InvalidInput(
                f"axis {self.name!r} has {count} whole values, got a request for {n}"
            )
        return [int(v) for v in values]


@dataclass(frozen=True)
class Categorical(Axis):
    """An axis of unordered levels; every two levels are equally far apart."""

    name: str
    choices: tuple[Value, ...]
    unit: str = ""

    def __post_init__(self) -> None:
        _check_names(self.name, self.unit)
        given = self.choices
        try:
            choices = () if isinstance(given, str) else tuple(_python(choice) for choice in given)
        except TypeError:  # nothing that can be gone through
            choices = ()
        object.__setattr__(self, "choices", choices)
        if not all(isinstance(c, str) or _number(c) is not None for c in choices):
            raise InvalidInput(f"axis {self.name!r} takes texts and numbers, got {choices!r}")
        if len(choices) < 2 or len(set(choices)) != len(choices):
            raise InvalidInput(
                f"axis {self.name!r} needs two or more distinct choices, got {given!r}"
            )

    @property
    def width(self) -> int:
        """One column per level."""
        return len(self.choices)

    def own(self, values: Sequence[Any]) -> list[Value]:
        """The choices that equal the values; see `Axis.own`."""
        return [self._own(_python(value)) for value in values]

    def _own(self, value: Any) -> Value:
        if not isinstance(value, np.ndarray) and value in self.choices:
            return self.choices[self.choices.index(value)]
        number = _number(value)
        if number is not None:
            levels = [c for c in self.choices if not isinstance(c, str)]
            same = [c for c in levels if abs(c - number) <= SINGLE * abs(c)]
            if len(same) == 1:
                return same[0]
        raise ContextMismatch(f"axis {self.name!r} takes one of {self.choices!r}, got {value!r}")

    def encode(self, values: Sequence[Value]) -> Array:
        """One-hot rows over sqrt(2); see `Axis.encode`."""
        levels = [self.choices.index(value) for value in self.own(values)]
        return np.asarray(np.eye(self.width)[levels] / math.sqrt(2.0))

    def decode(self, unit: Array) -> list[Value]:
        """The level of the largest column."""
        return [self.choices[level] for level in unit.argmax(axis=1)]

    def spread(self, n: int) -> list[Value]:
        """All levels in their order; raises `InvalidInput` unless `n` is their number."""
        if n != self.width:
            raise InvalidInput(f"axis {self.name!r} has {self.width} levels, got a request for {n}")
        return list(self.choices)

    def to_json(self) -> dict[str, Any]:
        """Kind, name, unit and choices."""
        record = {"kind": "categorical", "name": self.name, "unit": self.unit}
        return {**record, "choices": list(self.choices)}


_NUMERIC: dict[str, type[_Numeric]] = {"linear": Linear, "log": Log, "integer": Integer}


def axis_from_json(record: Mapping[str, Any]) -> Axis:
    """Rebuild an axis from `Axis.to_json`."""
    kind = record["kind"]
    if kind == "categorical":
        return Categorical(record["name"], tuple(record["choices"]), record["unit"])
    if kind not in _NUMERIC:
        raise unknown_name("axis kind", kind, [*_NUMERIC, "categorical"])
    return _NUMERIC[kind](record["name"], record["low"], record["high"], record["unit"])


def grid_values(axis: Axis, given: int | Sequence[Value]) -> list[Value]:
    """The values of an axis on a grid: themselves, or so many that are evenly spread.

    Raises:
        InvalidInput: neither a number of values nor values, or far too many.
    """
    if not isinstance(given, (int, np.integer)):
        try:
            return axis.own(list(given))
        except TypeError:
            raise InvalidInput(
                f"axis {axis.name!r} takes a number of values, or the values, got {given!r}"
            ) from None
    count = int(given)
    if not 1 <= count <= MOST:
        raise InvalidInput(
            f"axis {axis.name!r} needs from 1 to {MOST:,} grid values, got {short(count)}"
        )
    return axis.spread(count)


def _rounding(share: float) -> float:
    return min(max(share, _LEAST_ROUNDING), _MOST_ROUNDING)


def _check_names(name: str, unit: str) -> None:
    if not (isinstance(name, str) and name and isinstance(unit, str)):
        raise InvalidInput(
            f"an axis needs a non-empty name, and its unit as text, got {name!r} and {unit!r}"
        )


def _python(value: Any) -> Any:
    """A number of numpy as Python's own, so that it can be stored."""
    if isinstance(value, (np.generic, np.ndarray)) and np.ndim(value) == 0:
        return value.item()
    return value


def _number(value: Any) -> float | int | None:
    """A finite number as Python's own; None for anything else, texts included."""
    value = _python(value)
    if not isinstance(value, (numbers.Real, Decimal)):
        return None
    with contextlib.suppress(OverflowError):
        if math.isfinite(float(value)):
            return int(value) if isinstance(value, int) else float(value)
    return None
