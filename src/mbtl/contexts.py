"""Contexts: axes, spaces and grids; values in the unit cube and in grid steps.

An axis is one named dimension of a context, with its unit and its map to the unit interval. A
numeric axis maps to one column in [0, 1]. A categorical axis with L levels maps to L columns,
one-hot over sqrt(2), so that two different levels are at distance exactly 1. A space is a finite
list of contexts with stable indices.

Notation (shapes): N contexts, d axes, D >= d columns (a categorical axis has one per level).
    unit     (N, D)   unit-cube coordinates; what the models see
    steps    (N, D)   grid steps 0..n-1 per axis; what the paper's own selectors see
    weights  (N,)     target weights, >= 0, sum 1
"""

from __future__ import annotations

import contextlib
import math
import numbers
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from mbtl.arrays import Array, Indices, uniform_weights
from mbtl.errors import ContextMismatch, InvalidInput, MbtlError, check_known
from mbtl.faults import harmless
from mbtl.files import MALFORMED
from mbtl.plain import short

__all__ = ["Axis", "Categorical", "Context", "ContextSpace", "Integer", "Linear", "Log", "Value"]

Value = float | int | str
Context = dict[str, Value]

MOST = 10_000_000
"""Contexts of a space: a few GB."""
SINGLE = 2.0**-22
"""Two units in the last place of single precision: what float32 does to a number, relatively."""
_ROUNDING = 1e-5
"""Share of an axis that rounding, of single precision too, may move a value by."""
_DIGITS = 9
"""Contexts whose unit-cube coordinates agree to this many digits are the same context."""


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
    def _limits(self) -> tuple[float, float]:
        """Low and high, with room for rounding."""
        slack = _ROUNDING * (self.high - self.low)
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
    def _limits(self) -> tuple[float, float]:
        return self.low * (1.0 - SINGLE), self.high * (1.0 + SINGLE)

    def encode(self, values: Sequence[Value]) -> Array:
        """Unit column, proportional to the logarithm of the value."""
        return (np.log(self._checked(values) / self.low) / math.log(self.high / self.low))[:, None]

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
    def _limits(self) -> tuple[float, float]:
        return self.low, self.high  # values are whole by then

    def own(self, values: Sequence[Any]) -> list[Value]:
        """Whole numbers; see `Axis.own`."""
        return [self._whole(value) for value in super().own(values)]

    def _whole(self, value: Any) -> int:
        whole: int = round(value)
        if abs(value - whole) <= _ROUNDING:
            return whole
        raise ContextMismatch(f"axis {self.name!r} takes whole numbers, got {value!r}; use Linear")

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
    check_known("axis kind", kind, [*_NUMERIC, "categorical"])
    return _NUMERIC[kind](record["name"], record["low"], record["high"], record["unit"])


def grid_values(axis: Axis, given: int | Sequence[Value]) -> list[Value]:
    """The values of an axis on a grid: themselves, or so many that are evenly spread.

    Raises:
        InvalidInput: no axis, neither a number of values nor rising values, or far too many.
    """
    if not isinstance(axis, Axis):
        raise InvalidInput(f"grid takes axes as keys, such as Linear('x', 0, 1), got {axis!r}")
    if isinstance(given, (int, np.integer)):
        if not 1 <= given <= MOST:
            raise InvalidInput(
                f"axis {axis.name!r} needs from 1 to {MOST:,} grid values, got {short(int(given))}"
            )
        return axis.spread(int(given))
    try:
        values = axis.own(list(given))
    except TypeError:
        raise InvalidInput(
            f"axis {axis.name!r} takes a number of values, or the values, got {given!r}"
        ) from None
    if not values:
        raise InvalidInput(f"axis {axis.name!r} needs one or more values, got none")
    if not isinstance(axis, Categorical) and (np.diff(np.asarray(values, float)) <= 0).any():
        raise InvalidInput(
            f"grid values of axis {axis.name!r} must be strictly increasing, got {values}"
        )
    return values


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


# ---- spaces --------------------------------------------------------------------------------------

_FINE = 100_001
"""Values of a continuous axis among which contexts are drawn."""


class ContextSpace:
    """Every context of a problem, in a fixed order: index i means the same context for ever.

    Build one with `ContextSpace.grid` or `ContextSpace.points`.
    """

    def __init__(
        self,
        axes: Sequence[Axis],
        columns: Sequence[Sequence[Value]],
        *,
        shape: tuple[int, ...] | None = None,
        weights: ArrayLike | None = None,
    ) -> None:
        """Use the named constructors instead; `columns[q]` holds the N values of axis q."""
        names = [axis.name for axis in axes]
        if not axes or len(set(names)) != len(names):
            raise InvalidInput(
                f"a context space needs one or more axes of distinct names, got {names}"
            )
        self.axes = tuple(axes)
        self.shape = shape
        self._columns = [a.own(c) for a, c in zip(self.axes, columns, strict=True)]
        self.unit = np.hstack([a.encode(c) for a, c in zip(self.axes, self._columns, strict=True)])
        self._check_distinct()
        self.steps = self._to_steps(self.unit)
        self.weights = _checked_weights(weights, self.n)

    # ---- constructors ------------------------------------------------------------------------

    @classmethod
    def grid(
        cls, axes: Mapping[Axis, int | Sequence[Value]], *, weights: ArrayLike | None = None
    ) -> ContextSpace:
        """Full factorial grid, last axis fastest.

        Args:
            axes: for each axis either a number of values, evenly spread (evenly in ratio on a `Log`
                axis), or the strictly increasing values themselves.
            weights: (N,) target weights; uniform when missing.

        Raises:
            InvalidInput: values are not strictly increasing.
            ContextMismatch: a value lies outside its axis.
        """
        if not isinstance(axes, Mapping):
            raise InvalidInput(f"grid takes axes as {{Linear('x', 0, 1): 5}}, got {short(axes)}")
        levels = [grid_values(axis, given) for axis, given in axes.items()]
        shape = tuple(len(values) for values in levels)
        if (n := math.prod(shape)) > MOST:
            raise InvalidInput(f"a context space has at most {MOST:,} contexts, got {n:,}")
        columns = [np.asarray(v, dtype=object) for v in levels]
        mesh = [m.ravel().tolist() for m in np.meshgrid(*columns, indexing="ij")]
        return cls(tuple(axes), mesh, shape=shape, weights=weights)

    @classmethod
    def points(
        cls,
        axes: Sequence[Axis],
        contexts: Sequence[Mapping[str, Value]],
        *,
        weights: ArrayLike | None = None,
    ) -> ContextSpace:
        """An explicit list of contexts, in the given order.

        Raises:
            ContextMismatch: a context lacks an axis, names an unknown one, or lies outside.
            InvalidInput: two contexts are equal, or there is none.
        """
        if not (isinstance(axes, Sequence) and all(isinstance(axis, Axis) for axis in axes)):
            raise InvalidInput(f"points takes axes as [Linear('x', 0, 1)], got {short(axes)}")
        if not contexts:
            raise InvalidInput("a context space needs one or more contexts, got none")
        for context in contexts:
            _check_keys(axes, context)
        columns = [[context[axis.name] for context in contexts] for axis in axes]
        return cls(axes, columns, weights=weights)

    def every(self, step: int) -> ContextSpace:
        """The grid of each `step`-th value per numeric axis, from the middle of the first few.

        Raises:
            InvalidInput: `step` < 1, or this space is no grid.
        """
        if self.shape is None or step < 1:
            kind = "a list of contexts" if self.shape is None else "a grid"
            raise InvalidInput(
                f"a coarser grid needs a grid and a step of 1 or more, got {kind} and {step}"
            )
        chosen = (
            range(n) if isinstance(axis, Categorical) else range((min(step, n) - 1) // 2, n, step)
            for axis, n in zip(self.axes, self.shape, strict=True)
        )
        picked = np.ix_(*map(list, chosen))
        kept = np.arange(self.n).reshape(self.shape)[picked].ravel()
        levels = [list(dict.fromkeys(column[i] for i in kept)) for column in self._columns]
        weights = self.weights[kept]
        return ContextSpace.grid(dict(zip(self.axes, levels, strict=True)), weights=weights)

    # ---- reading -----------------------------------------------------------------------------

    @property
    def n(self) -> int:
        """Number of contexts N."""
        return len(self._columns[0])

    def __len__(self) -> int:
        return self.n

    @property
    def d(self) -> int:
        """Number of axes."""
        return len(self.axes)

    def context(self, index: int) -> Context:
        """The context at `index` as a mapping axis name -> value."""
        if not 0 <= index < self.n:
            raise InvalidInput(f"context indices run from 0 to {self.n - 1}, got {index}")
        return {a.name: c[index] for a, c in zip(self.axes, self._columns, strict=True)}

    @property
    def contexts(self) -> list[Context]:
        """All N contexts in index order."""
        return [self.context(i) for i in range(self.n)]

    def values(self, axis: str) -> list[Value]:
        """(N,) values of one axis in index order."""
        names = [a.name for a in self.axes]
        check_known("axis", axis, names)
        return list(self._columns[names.index(axis)])

    def describe(self, context: Mapping[str, Value], between: str = ", ") -> str:
        """A context for people, "length = 0.5 m"; `between` stands between its axes."""
        units = {axis.name: axis.unit for axis in self.axes}
        parts = []
        for name, value in context.items():
            number = f"{value:.4g}" if isinstance(value, float) else harmless(str(value), 60)
            parts.append(f"{name} = {number} {units.get(name, '')}".rstrip())
        return harmless(between.join(parts))

    def describe_set(self, contexts: Sequence[int], between: str = ", ") -> str:
        """Contexts by index: "all contexts", "12 contexts", or one as `describe` has it."""
        if len(contexts) == 1:
            return self.describe(self.context(contexts[0]), between)
        return "all contexts" if len(contexts) == self.n else f"{len(contexts)} contexts"

    def named(self, indices: Sequence[int] | Indices) -> Callable[[int], str]:
        """What the place-th of these contexts is called, for messages."""
        return lambda place: self.describe(self.context(int(indices[place])))

    def index(self, context: Mapping[str, Value]) -> int:
        """Index of a context; a number in single precision is the one it was rounded from.

        Raises:
            ContextMismatch: it is not one of the N contexts, or not a context of these axes.
        """
        unit = self.encode(context)
        found = self._lookup.get(_key(unit))
        if found is None:
            apart = np.abs(self.unit - unit)
            same = np.flatnonzero((apart <= _ROUNDING).all(axis=1))
            if len(same) == 1:
                return int(same[0])
            near = int(np.argmin((apart**2).sum(axis=1)))
            raise ContextMismatch(
                f"{dict(context)!r} is not one of the {self.n} contexts; the nearest is "
                f"{self.context(near)!r} (index {near})"
            )
        return found

    @property
    def middle(self) -> Context:
        """The listed context that is nearest to the middle of the space."""
        middle = (self.unit.min(axis=0) + self.unit.max(axis=0)) / 2.0
        return self.context(int(((self.unit - middle) ** 2).sum(axis=1).argmin()))

    def between(self, count: int, seed: int) -> list[Context]:
        """`count` contexts drawn evenly from the axes, on the list or off it."""
        rng, found = np.random.default_rng(seed), dict[str, list[Value]]()
        for axis in self.axes:
            if isinstance(axis, Categorical):
                levels = list(axis.choices)
            elif isinstance(axis, Integer):
                levels = list(range(int(axis.low), int(axis.high) + 1))
            else:
                levels = axis.spread(_FINE)
            found[axis.name] = [levels[i] for i in rng.integers(len(levels), size=count)]
        return [{name: values[i] for name, values in found.items()} for i in range(count)]

    def nearest(self, context: Mapping[str, Value]) -> Context:
        """The context with each number moved into the range of its axis.

        Raises:
            ContextMismatch: it is not a context of these axes.
        """
        _check_keys(self.axes, context)
        found = dict(context)
        for axis in self.axes:
            value = found.get(axis.name)
            if isinstance(axis, _Numeric) and isinstance(value, int | float):
                found[axis.name] = min(max(value, axis.low), axis.high)
        return found

    def encode(self, context: Mapping[str, Value]) -> Array:
        """(D,) unit-cube coordinates of any context within the axes, on the list or off it."""
        _check_keys(self.axes, context)
        return np.hstack([axis.encode([context[axis.name]])[0] for axis in self.axes])

    def encode_steps(self, context: Mapping[str, Value]) -> Array:
        """(D,) grid-step coordinates of any context within the axes (interpolated off the grid)."""
        return np.asarray(self._to_steps(self.encode(context)[None])[0])

    def to_json(self) -> dict[str, Any]:
        """JSON-able record; `ContextSpace.from_json` rebuilds an equal space."""
        record: dict[str, Any] = {"axes": [axis.to_json() for axis in self.axes]}
        if self.shape:
            record["grid"] = self._levels
        else:
            record["points"] = self._columns
        if not np.array_equal(self.weights, uniform_weights(self.n)):
            record["weights"] = self.weights.tolist()
        return record

    @classmethod
    def from_json(cls, record: Mapping[str, Any]) -> ContextSpace:
        """Rebuild a space from `to_json`; raises `InvalidInput` where it is of another form."""
        try:
            axes = [axis_from_json(a) for a in record["axes"]]
            weights = record.get("weights")
            if "grid" not in record:
                return cls(axes, record["points"], weights=weights)
            if len(levels := dict(zip(axes, map(list, record["grid"]), strict=True))) < len(axes):
                raise InvalidInput("a context space needs axes of distinct names")
            return cls.grid(levels, weights=weights)
        except MbtlError:
            raise
        except MALFORMED as error:
            raise InvalidInput(f"a context space is as to_json gives it: {error!r:.80}") from error

    def __eq__(self, other: object) -> bool:
        return isinstance(other, ContextSpace) and self.to_json() == other.to_json()

    def __hash__(self) -> int:
        return hash((self.axes, self.n))

    def difference(self, now: ContextSpace) -> tuple[str, Any, Any] | None:
        """What differs first, what it is here, and what it is `now`; None: the spaces are equal."""
        if self == now:
            return None
        pairs = zip(_told(self), _told(now), strict=False)  # alike up to the first difference
        return next(((name, was, other) for (name, was), (_, other) in pairs if was != other), None)

    def __repr__(self) -> str:
        names = ", ".join(axis.label for axis in self.axes)
        return f"ContextSpace({names}; {self.n} contexts)"

    # ---- inside ------------------------------------------------------------------------------

    @cached_property
    def _lookup(self) -> dict[tuple[float, ...], int]:
        return {_key(row): i for i, row in enumerate(self.unit)}

    @cached_property
    def _levels(self) -> list[list[Value]]:
        """Per axis, its distinct values in grid order."""
        return [list(dict.fromkeys(column)) for column in self._columns]

    def _to_steps(self, unit: Array) -> Array:
        """(n, D) unit-cube coordinates in grid steps; those of levels stay as they are.

        A list has as many steps per axis as a grid of N points would have.
        """
        per_axis = max(round(self.n ** (1.0 / self.d)) - 1, 1)
        steps, column = unit.copy(), 0
        for q, axis in enumerate(self.axes):
            if not isinstance(axis, Categorical) and self.shape:
                stride, n = int(np.prod(self.shape[q + 1 :])), self.shape[q]
                known = self.unit[: n * stride : stride, column]
                steps[:, column] = np.interp(unit[:, column], known, np.arange(n))
            elif not isinstance(axis, Categorical):
                steps[:, column] *= per_axis
            column += axis.width
        return steps

    def _check_distinct(self) -> None:
        rounded = np.round(self.unit, _DIGITS)
        order = np.lexsort(rounded.T)
        same = np.flatnonzero((np.diff(rounded[order], axis=0) == 0).all(axis=1))
        if same.size:
            first, second = sorted((int(order[same[0]]), int(order[same[0] + 1])))
            raise InvalidInput(
                f"contexts must be distinct, got {self.context(first)!r} at index {first} and "
                f"again at index {second}; remove one"
            )


def _told(space: ContextSpace) -> Iterator[tuple[str, Any]]:
    """All that a space consists of, by name; what decides how much follows comes first."""
    yield "the axes of the space", [axis.label for axis in space.axes]
    for axis in space.axes:
        yield from ((f"axis {axis.name!r}, {key}", value) for key, value in axis.to_json().items())
    yield "the number of contexts", space.n
    for i in range(space.n):
        yield f"the context of index {i}", space.context(i)
    for i in range(space.n):
        yield f"the weight of {space.context(i)}", float(space.weights[i])
    yield "the form of the space", "a grid" if space.shape else "a list"


def _key(unit: Array) -> tuple[float, ...]:
    return tuple((np.round(unit, _DIGITS) + 0.0).tolist())


def _check_keys(axes: Sequence[Axis], context: Mapping[str, Value]) -> None:
    if not isinstance(context, Mapping):
        example = {axis.name: "..." for axis in axes}
        raise ContextMismatch(f"a context is a mapping such as {example}, got {context!r}")
    names = [axis.name for axis in axes]
    for key in context:
        check_known("axis", str(key), names)
    missing = [name for name in names if name not in context]
    if missing:
        raise ContextMismatch(
            f"a context names every axis ({names}), got {dict(context)!r} without {missing}"
        )


def _checked_weights(weights: ArrayLike | None, n: int) -> Array:
    if weights is None:
        return uniform_weights(n)
    array = np.asarray(weights)
    numbers = array.shape == (n,) and array.dtype.kind in "fiub"
    array = array.astype(np.float64) if numbers else array
    if not (numbers and (array >= 0).all() and (array < 1e300).all() and array.any()):
        raise InvalidInput(
            f"target weights must be {n} finite numbers >= 0 with a positive sum, "
            f"got {short(weights)} of shape {array.shape}"
        )
    if abs(float(array.sum()) - 1.0) < 1e-12:  # read back from a log: keep every digit
        return array
    return np.asarray(array / array.sum())


def middle_of(contexts: Sequence[int], steps: Array) -> int:
    """The context of several, by index, that is nearest to their middle: where one is drawn."""
    if len(contexts) == 1:
        return int(contexts[0])
    places = steps[list(contexts)]
    middle = (places.min(axis=0) + places.max(axis=0)) / 2.0
    return int(contexts[int(np.linalg.norm(places - middle, axis=1).argmin())])
