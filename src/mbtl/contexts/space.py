"""Context spaces: a finite list of contexts with stable indices, and its coordinates.

Notation (shapes): N contexts, d axes, D >= d columns (a categorical axis has one per level).
    unit     (N, D)   unit-cube coordinates; what the models see
    steps    (N, D)   grid steps 0..n-1 per axis; what the paper's own selectors see
    weights  (N,)     target weights, >= 0, sum 1
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mbtl.arrays import Array, uniform_weights
from mbtl.contexts.axes import (
    MOST,
    Axis,
    Categorical,
    Integer,
    Value,
    axis_from_json,
    grid_values,
)
from mbtl.errors import ContextMismatch, InvalidInput, MbtlError, unknown_name
from mbtl.faults import harmless
from mbtl.files import MALFORMED

Context = dict[str, Value]

_DIGITS = 9
"""Contexts whose unit-cube coordinates agree to this many digits are the same context."""


class ContextSpace:
    """Every context of a problem, in a fixed order: index i means the same context for ever.

    Build one with `ContextSpace.grid`, `ContextSpace.points` or `ContextSpace.sample`.
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
        self.steps = self._grid_steps() if shape else self._scaled_steps()
        self.weights = _checked_weights(weights, self.n)

    # ---- constructors ------------------------------------------------------------------------

    @classmethod
    def grid(
        cls,
        axes: Mapping[Axis, int | Sequence[Value]],
        *,
        weights: ArrayLike | None = None,
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
        for axis in axes:
            if not isinstance(axis, Axis):
                raise InvalidInput(
                    f"grid takes axes as keys, such as Linear('x', 0, 1), got {axis!r}"
                )
        levels = [grid_values(axis, given) for axis, given in axes.items()]
        for axis, values in zip(axes, levels, strict=True):
            if not values:
                raise InvalidInput(f"axis {axis.name!r} needs one or more values, got none")
            if not isinstance(axis, Categorical) and np.any(
                np.diff(np.asarray(values, float)) <= 0
            ):
                raise InvalidInput(
                    f"grid values of axis {axis.name!r} must be strictly increasing, got {values}"
                )
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
        if not contexts:
            raise InvalidInput("a context space needs one or more contexts, got none")
        for context in contexts:
            _check_keys(axes, context)
        columns = [[context[axis.name] for context in contexts] for axis in axes]
        return cls(axes, columns, weights=weights)

    @classmethod
    def sample(
        cls, axes: Sequence[Axis], n: int, *, seed: int, weights: ArrayLike | None = None
    ) -> ContextSpace:
        """`n` distinct contexts spread over the axes by a scrambled Halton sequence.

        Raises:
            InvalidInput: n < 1, or the axes do not have `n` distinct contexts.
        """
        from scipy.stats import qmc  # kept out of `import mbtl`: it takes longer than all the rest

        if n < 1:
            raise InvalidInput(f"a sample needs n >= 1 contexts, got {n}")
        halton = qmc.Halton(len(axes), seed=seed)
        seen: dict[tuple[Value, ...], None] = {}
        for _ in range(50):
            for row in halton.random(n):
                values = tuple(_from_fraction(a, u) for a, u in zip(axes, row, strict=True))
                seen.setdefault(values)
                if len(seen) == n:
                    return cls(axes, list(zip(*seen, strict=True)), weights=weights)
        raise InvalidInput(f"the axes have fewer than {n} distinct contexts; ask for {len(seen)}")

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
        if axis not in names:
            raise unknown_name("axis", axis, names)
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

    def named(self, indices: Sequence[int] | NDArray[np.intp]) -> Callable[[int], str]:
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
            same = np.flatnonzero((apart <= self._rounding).all(axis=1))
            if len(same) == 1:
                return int(same[0])
            near = int(np.argmin((apart**2).sum(axis=1)))
            raise ContextMismatch(
                f"{dict(context)!r} is not one of the {self.n} contexts; the nearest is "
                f"{self.context(near)!r} (index {near})"
            )
        return found

    def encode(self, context: Mapping[str, Value]) -> Array:
        """(D,) unit-cube coordinates of any context within the axes, on the list or off it."""
        _check_keys(self.axes, context)
        return np.hstack([axis.encode([context[axis.name]])[0] for axis in self.axes])

    def encode_steps(self, context: Mapping[str, Value]) -> Array:
        """(D,) grid-step coordinates of any context within the axes (interpolated off the grid)."""
        unit = self.encode(context)
        if not self.shape:
            return np.asarray(unit * self._step_scale)
        parts, start = [], 0
        for axis, block in zip(self.axes, self._level_units, strict=True):
            part = unit[start : start + axis.width]
            start += axis.width
            if isinstance(axis, Categorical):
                parts.append(part)
            else:
                parts.append(np.interp(part, block[:, 0], np.arange(len(block))))
        return np.hstack(parts)

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
    def _rounding(self) -> Array:
        """(D,) distances in the unit cube at which two values are one in single precision."""
        return np.repeat([a.rounding for a in self.axes], [a.width for a in self.axes])

    @cached_property
    def _levels(self) -> list[list[Value]]:
        """Per axis, its distinct values in grid order."""
        assert self.shape is not None
        strides = [int(np.prod(self.shape[q + 1 :])) for q in range(self.d)]
        return [
            [column[j * stride] for j in range(n)]
            for column, stride, n in zip(self._columns, strides, self.shape, strict=True)
        ]

    @cached_property
    def _level_units(self) -> list[Array]:
        return [a.encode(v) for a, v in zip(self.axes, self._levels, strict=True)]

    @property
    def _step_scale(self) -> Array:
        """Columns of a point list: as many steps per axis as a grid of N points would have."""
        per_axis = max(round(self.n ** (1.0 / self.d)) - 1, 1)
        parts = [
            np.ones(a.width) if isinstance(a, Categorical) else np.full(1, float(per_axis))
            for a in self.axes
        ]
        return np.hstack(parts)

    def _scaled_steps(self) -> Array:
        return np.asarray(self.unit * self._step_scale)

    def _grid_steps(self) -> Array:
        assert self.shape is not None
        positions = np.indices(self.shape).reshape(self.d, -1)
        parts, start = [], 0
        for axis, position in zip(self.axes, positions, strict=True):
            if isinstance(axis, Categorical):
                parts.append(self.unit[:, start : start + axis.width])
            else:
                parts.append(position[:, None].astype(np.float64))
            start += axis.width
        return np.hstack(parts)

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


def _from_fraction(axis: Axis, u: float) -> Value:
    """A fraction of the unit interval -> a value, each level of a discrete axis equally likely."""
    if isinstance(axis, Categorical):
        return axis.choices[min(int(u * axis.width), axis.width - 1)]
    if isinstance(axis, Integer):
        return int(axis.low) + min(int(u * (axis.high - axis.low + 1)), int(axis.high - axis.low))
    return axis.decode(np.array([[u]]))[0]


def _check_keys(axes: Sequence[Axis], context: Mapping[str, Value]) -> None:
    if not isinstance(context, Mapping):
        example = {axis.name: "..." for axis in axes}
        raise ContextMismatch(f"a context is a mapping such as {example}, got {context!r}")
    names = [axis.name for axis in axes]
    for key in context:
        if key not in names:
            raise unknown_name("axis", str(key), names)
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
            f"got {array.dtype} of shape {array.shape}"
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
