"""Entries of a matrix file: the rules each must keep, and what stands in for a missing one.

Every error names the entry; `TransferMatrix.load` puts the file before it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mbtl.arrays import Array
from mbtl.benchmark.npz import read_text
from mbtl.contexts import ContextSpace, Integer, Linear
from mbtl.contexts.space import factorial_shape
from mbtl.errors import InvalidInput
from mbtl.objective import Bounds, Direction
from mbtl.plain import LARGEST, array_of, refused
from mbtl.untrusted import MALFORMED

Floats = NDArray[np.floating[Any]]
DIRECTIONS: dict[str, Direction] = {"max": "maximize", "min": "minimize"}
REFERENCE = "reference_"
"""What the keys of reference rows begin with."""


def checked_returns(returns: ArrayLike, key: str = "returns", *, square: bool = True) -> Floats:
    """Returns as (S, M, N) finite floats, M = N if `square`, or an `InvalidInput`."""
    array = array_of(key, returns)
    if array.dtype.kind not in "fiu":
        raise InvalidInput(f"{key} must be real numbers, got dtype {array.dtype}")
    if array.dtype.kind != "f":
        array = array.astype(np.float64)
    fits = array.ndim == 3 and (array.shape[1] == array.shape[2] or not square)
    if not fits or 0 in array.shape:
        hint = f"; add the seed axis with {key}[None]" if array.ndim == 2 else ""
        if array.ndim == 3 and 0 < array.shape[1] < array.shape[2]:
            hint = "; say which contexts were trained on with `sources`"
        raise InvalidInput(
            f"{key} must have shape (seed, source, target) with as many sources as targets, "
            f"got {array.shape}{hint}"
        )
    bad = np.argwhere(refused(array))
    if len(bad):
        seed, source, target = bad[0].tolist()
        raise InvalidInput(
            f"{key} must be finite and within {LARGEST:g}, got "
            f"{float(array[seed, source, target])!r} at [seed {seed}, source {source}, target "
            f"{target}], the first of {len(bad)} of {array.size}"
        )
    return array


def checked_sources(sources: ArrayLike | None, returns: Floats) -> NDArray[np.intp] | None:
    """(M,) rising indices of contexts; None where they are all N."""
    if sources is None:
        return None
    array, (_, m, n) = array_of("sources", sources), returns.shape
    if (
        array.shape != (m,)
        or array.dtype.kind not in "iu"
        or not (np.diff(array) > 0).all()
        or array[0] < 0
        or array[-1] >= n
    ):
        raise InvalidInput(
            f"sources must be the {m} context indices of the rows of returns, rising, from 0 to "
            f"{n - 1}, got {array.tolist()!r:.80}"
        )
    return None if m == n else array.astype(np.intp)


def same_sources(one: NDArray[np.intp] | None, other: NDArray[np.intp] | None) -> bool:
    """Whether two matrices are of trainings on the same contexts; None: on all."""
    if one is None or other is None:
        return one is other
    return np.array_equal(one, other)


def checked_like(returns: Floats, entry: ArrayLike, key: str) -> Floats:
    """An entry in the shape of `returns`."""
    if np.shape(entry) != returns.shape:
        raise InvalidInput(
            f"{key} must have the shape of returns {returns.shape}, got {np.shape(entry)}"
        )
    return np.asarray(entry)


def checked_deviations(returns: Floats, std: ArrayLike) -> Floats:
    """Deviations of episodes in the shape of `returns`, NaN where unknown."""
    array = checked_like(returns, array_of("std", std), "std")
    if array.dtype.kind not in "fiu" or ((array < 0) | (array > np.float64(2.0 * LARGEST))).any():
        raise InvalidInput(
            f"std must be deviations from 0 to {2.0 * LARGEST:g}, or NaN where unknown, got "
            f"{array.dtype} from {np.nanmin(array):g} to {np.nanmax(array):g}"
        )
    return array


def checked_episodes(episodes: Sequence[int] | None, n_halves: int) -> tuple[int, ...] | None:
    """Episodes of each half, whole numbers >= 1."""
    if episodes is None:
        return None
    counts = np.atleast_1d(array_of("episodes", episodes))
    if counts.shape != (n_halves,) or counts.dtype.kind not in "iu" or (counts < 1).any():
        raise InvalidInput(
            f"episodes must be {n_halves} whole number(s) >= 1, those behind `returns` and "
            f"`fresh_returns`, got {episodes!r}"
        )
    return tuple(counts.tolist())


def checked_references(
    references: Mapping[str, ArrayLike], shape: tuple[int, int, int]
) -> dict[str, Floats]:
    """Reference rows by name, (S, H, N) finite floats each."""
    rows = {}
    for name, given in references.items():
        row = array_of(REFERENCE, given)
        if row.shape != shape or row.dtype.kind != "f" or refused(row).any():
            raise InvalidInput(
                f"{REFERENCE}{name} must be finite, within {LARGEST:g}, of shape (seed, half, "
                f"target) {shape}, got shape {row.shape} and dtype {row.dtype}"
            )
        rows[name] = row
    return rows


def halves(returns: Floats) -> tuple[list[Array], tuple[int, ...]]:
    """Means over the first half of the episodes (last axis) and over the rest, and their numbers.

    An odd episode belongs to the second half; a single one leaves no second half.
    """
    total = returns.shape[-1]
    first = max(total // 2, 1)
    parts = [part for part in (returns[..., :first], returns[..., first:]) if part.shape[-1]]
    means = [np.asarray(part.mean(axis=-1, dtype=np.float64)) for part in parts]
    return means, tuple(part.shape[-1] for part in parts)


def checked_bounds(
    bounds: ArrayLike | Bounds | None,
    returns: Floats,
    direction: Direction,
    floor: float | None = None,
) -> Bounds:
    """Bounds from a pair, or the smallest and largest return over all seeds."""
    if isinstance(bounds, Bounds):
        return bounds
    if bounds is None:
        return replace(Bounds.of(returns, direction), floor=floor)
    pair = array_of("bounds", bounds)
    if pair.shape != (2,) or pair.dtype.kind not in "fiu":
        raise InvalidInput(f"bounds must be two numbers (low, high), got {bounds!r}")
    return Bounds(float(pair[0]), float(pair[1]), direction, floor)


def space_of(contexts: ArrayLike | None, axes: Sequence[str] | None, n: int) -> ContextSpace:
    """Contexts of a user's file; a grid is recognised, so that grid steps mean what they say."""
    if contexts is None:
        if axes is not None and len(axes) != 1:
            raise InvalidInput(f"axes {list(axes)} need `contexts` (N, d), which is missing")
        name = axes[0] if axes is not None else "index"
        return ContextSpace.grid({Integer(name, 0, max(n - 1, 1)): list(range(n))})
    values = array_of("contexts", contexts)
    if (
        values.ndim != 2
        or len(values) != n
        or values.shape[1] < 1
        or values.dtype.kind not in "fiu"
    ):
        raise InvalidInput(
            f"contexts must be numbers of shape (N, d) with N = {n}, "
            f"got shape {values.shape} and dtype {values.dtype}"
        )
    values = values.astype(np.float64)
    d = values.shape[1]
    names = list(axes) if axes is not None else [f"x{q}" for q in range(d)] if d > 1 else ["x"]
    if len(names) != d:
        raise InvalidInput(f"axes must be {d} names, one per column of contexts, got {names}")
    if not np.isfinite(values).all():
        raise InvalidInput("contexts must be finite, got NaN or infinite values")
    lines = [_axis_through(name, column) for name, column in zip(names, values.T, strict=True)]
    if factorial_shape(values):
        return ContextSpace.grid(
            {axis: np.unique(v).tolist() for axis, v in zip(lines, values.T, strict=True)}
        )
    return ContextSpace(lines, [column.tolist() for column in values.T])


def _axis_through(name: str, column: Array) -> Linear:
    low, high = float(column.min()), float(column.max())
    if low == high:  # a column that never varies still is an axis, of arbitrary width
        low, high = low - 0.5, high + 0.5
    return Linear(name, low, high)


_ENTRIES = frozenset(
    (
        *("returns", "contexts", "bounds", "std", "fresh_returns", "episodes", "sources", "axes"),
        *("direction", "theta", "floor", "space", "name", "provenance"),
    )
)


def is_entry(name: str) -> bool:
    """Whether a matrix file means something by this name; others are the user's own."""
    return name in _ENTRIES or name.startswith(REFERENCE)


def keywords(arrays: Mapping[str, NDArray[Any]]) -> dict[str, Any]:
    """Entries of a file as keywords of `TransferMatrix.of`."""
    words: dict[str, Any] = {"returns": arrays["returns"]}
    for key in ("contexts", "bounds", "std", "fresh_returns", "episodes", "sources"):
        if key in arrays:
            words[key] = arrays[key]
    words["references"] = {
        key.removeprefix(REFERENCE): row for key, row in arrays.items() if key.startswith(REFERENCE)
    }
    if "axes" in arrays:
        words["axes"] = [str(name) for name in np.atleast_1d(arrays["axes"])]
    if "direction" in arrays:
        words["direction"] = ", ".join(map(str, arrays["direction"].ravel().tolist()))
    for key in ("theta", "floor"):
        if key in arrays:
            number = arrays[key]
            if number.size != 1 or number.dtype.kind not in "fiu":
                raise InvalidInput(f"{key} must be one number, got {number!r}")
            words[key] = float(number.reshape(-1)[0])
    if "space" in arrays:
        words["space"] = _stored_space(arrays["space"])
    if "name" in arrays:
        if arrays["name"].dtype.kind != "U" or arrays["name"].size != 1:
            raise InvalidInput(f"name must be one text, got {arrays['name']!r:.60}")
        words["name"] = str(arrays["name"].reshape(-1)[0])
    if "provenance" in arrays:
        words["provenance"] = read_text(arrays["provenance"], "provenance")
    return words


def _stored_space(entry: NDArray[Any]) -> ContextSpace:
    record = read_text(entry, "space")
    try:
        return ContextSpace.from_json(record)
    except MALFORMED as error:
        raise InvalidInput(
            f"`space` must be the record that ContextSpace.to_json gives, got one that breaks at "
            f"{error}; leave it out to use `contexts`"
        ) from error
