"""Transfer matrices: returns J[seed, source, target] with their contexts and scale.

The evaluation episodes of every entry are two disjoint halves: `returns` is of the one that a
selector may see, `fresh_returns` of the other, of which every number shown to people is.

Trainings may have been on some of the contexts only; targets are all of them.

Notation (shapes): S seeds, N contexts, M sources (N unless said otherwise), d axes, E episodes,
H halves (2; 1 without a fresh one).
    returns  (S, M, N)  raw return of the policy trained on `source`, run on `target`
    performance         returns after `bounds`; larger is better, not clipped
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mbtl.arrays import Array, Indices, unwritable
from mbtl.contexts import Axis, Categorical, ContextSpace, Integer, Linear
from mbtl.errors import InvalidInput
from mbtl.files import MALFORMED
from mbtl.objective import Bounds, Direction, direction_named
from mbtl.plain import LARGEST, array_of, refused, short
from mbtl.seeds import seeds_in
from mbtl.selectors.base import SelectionProblem, default_theta
from mbtl.zoo.benchmark.base import Levels, checked_seed, levels
from mbtl.zoo.benchmark.npz import read_npz, read_text, text_array, write_npz

# Entries of a matrix file: the rules each must keep, and what stands in for a missing one
#
# Every error names the entry; `TransferMatrix.load` puts the file before it.


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


def checked_sources(sources: ArrayLike | None, returns: Floats) -> Indices | None:
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


def same_sources(one: Indices | None, other: Indices | None) -> bool:
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
            f"got shape {values.shape} and dtype {values.dtype}; for axes of categories give "
            "TransferMatrix.of a ContextSpace as space="
        )
    values = values.astype(np.float64)
    d = values.shape[1]
    names = list(axes) if axes is not None else [f"x{q}" for q in range(d)] if d > 1 else ["x"]
    if len(names) != d:
        raise InvalidInput(f"axes must be {d} names, one per column of contexts, got {names}")
    if not np.isfinite(values).all():
        raise InvalidInput("contexts must be finite, got NaN or infinite values")
    lines = [_axis_through(name, column) for name, column in zip(names, values.T, strict=True)]
    levels = [np.unique(column).tolist() for column in values.T]
    if math.prod(map(len, levels)) == len(values) and [*product(*levels)] == [*map(tuple, values)]:
        return ContextSpace.grid(dict(zip(lines, levels, strict=True)))
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


# ---- the whole -------------------------------------------------------------------------------


_MEANT: Mapping[str, type] = {"problem": str, "recipe": dict, "nominal": dict, "seed": int}
"""What entries of a provenance are, where they mean something here."""


def context_values(space: ContextSpace) -> Array:
    """(N, d) values of the contexts.

    Raises:
        InvalidInput: an axis is categorical and has no numbers.
    """
    for axis in space.axes:
        if isinstance(axis, Categorical):
            raise InvalidInput(
                f"axis {axis.name!r} is categorical and has no numbers; use space.contexts"
            )
    return np.array([space.values(axis.name) for axis in space.axes], dtype=np.float64).T


def _agreed(space: ContextSpace, contexts: ArrayLike | None) -> ContextSpace:
    """The space; contexts that a file has beside it are for other programs, and are the same.

    Raises:
        InvalidInput: they are others.
    """
    if contexts is not None:
        given, own = array_of("contexts", contexts), context_values(space)
        near = 1e-6 * np.ptp(own, axis=0)
        if given.shape != own.shape or not (np.abs(given - own) <= near).all():
            raise InvalidInput(
                f"contexts and space say the same, got {short(given.tolist())} where the space has "
                f"{short(own.tolist())}; leave one of them out (of a file, the entry `space` where "
                "you changed its contexts)"
            )
    return space


@dataclass(frozen=True, eq=False, repr=False)
class TransferMatrix:
    """Every policy on every target, for one or more training seeds.

    `TransferMatrix.of` fills in what is missing, `TransferMatrix.load` reads a file.

    Attributes:
        name: what results call it.
        returns: (S, M, N) raw returns, axis order (seed, source, target): means over the episodes
            that a selector may see; read-only.
        space: the N contexts in index order.
        bounds: return -> performance, with the direction.
        theta: slope of the linear gap, performance per grid step.
        std: (S, M, N) standard deviation over all evaluation episodes, in units of return, with
            n - 1; None where it is not known.
        provenance: how it was made; free-form.
        fresh_returns: (S, M, N) means over the other episodes; None where all were seen.
        episodes: (H,) episodes behind an entry of `returns` and of `fresh_returns`, if known.
        references: (S, H, N) raw returns without any of these policies, by name, e.g.
            "random_actions", or "unguided": the system without a controller.
        sources: (M,) contexts that were trained on, rising; None: all N.
    """

    name: str
    returns: Floats
    space: ContextSpace
    bounds: Bounds
    theta: float
    std: Floats | None = None
    provenance: Mapping[str, Any] = field(default_factory=dict)
    fresh_returns: Floats | None = None
    episodes: tuple[int, ...] | None = None
    references: Mapping[str, Floats] = field(default_factory=dict)
    sources: Indices | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.name, str):
            raise InvalidInput(f"the name of a matrix is a text, got {short(self.name)}")
        returns = checked_returns(self.returns, square=self.sources is None)
        object.__setattr__(self, "returns", unwritable(returns))
        object.__setattr__(self, "sources", checked_sources(self.sources, returns))
        if self.space.n != self.n:
            raise InvalidInput(
                f"contexts must be one per target of `returns` ({self.n}), got {self.space.n}"
            )
        if self.std is not None:
            object.__setattr__(self, "std", unwritable(checked_deviations(self.returns, self.std)))
        if self.fresh_returns is not None:
            fresh = checked_like(self.returns, self.fresh_returns, "fresh_returns")
            fresh = checked_returns(fresh, "fresh_returns", square=self.sources is None)
            object.__setattr__(self, "fresh_returns", unwritable(fresh))
        n_halves = 1 if self.fresh_returns is None else 2
        object.__setattr__(self, "episodes", checked_episodes(self.episodes, n_halves))
        shape = (self.n_seeds, n_halves, self.n)
        rows = checked_references(self.references, shape)
        object.__setattr__(self, "references", {k: unwritable(row) for k, row in rows.items()})
        if not (np.isfinite(self.theta) and self.theta >= 0):
            raise InvalidInput(f"theta must be a finite number >= 0, got {self.theta!r}")

    def __repr__(self) -> str:
        seeds, m, n = self.returns.shape
        size = f"{seeds} seed{'s' * (seeds > 1)}, {m} sources x {n} targets"
        return f"TransferMatrix({self.name!r}: {size}; {self.space!r})"

    # ---- constructors ------------------------------------------------------------------------

    @classmethod
    def of(
        cls,
        returns: ArrayLike,
        *,
        contexts: ArrayLike | None = None,
        axes: Sequence[str] | None = None,
        space: ContextSpace | None = None,
        bounds: ArrayLike | Bounds | None = None,
        theta: float | None = None,
        direction: str = "max",
        std: Floats | None = None,
        provenance: Mapping[str, Any] | None = None,
        fresh_returns: ArrayLike | None = None,
        episodes: Sequence[int] | None = None,
        references: Mapping[str, ArrayLike] | None = None,
        floor: float | None = None,
        sources: ArrayLike | None = None,
        name: str = "matrix",
    ) -> TransferMatrix:
        """Build a matrix from arrays; the keywords are the keys of a `.npz` file.

        Args:
            returns: (S, M, N) raw returns, finite; of the episodes that a selector may see.
            contexts: (N, d) context values; one axis of indices 0..N-1 when missing.
            axes: d axis names.
            space: the context space itself, which says more than `contexts` and `axes`.
            bounds: (2,) returns that become performance 0 and 1 (1 and 0 when minimised), or
                `Bounds`; the smallest and largest return over all seeds when missing.
            theta: performance per grid step; 0.005 for N <= 100, else 0.5 / (N - 1), when missing.
            direction: "max" or "min" (or the long names), which returns are good.
            std: (S, M, N) standard deviation over episodes, with n - 1.
            provenance: how it was made.
            fresh_returns: (S, M, N) raw returns of other episodes, which are those reported.
            episodes: (H,) episodes behind `returns` and `fresh_returns`.
            references: (S, H, N) returns without these policies, by name.
            floor: return below which none is worse in performance; what is stored stays.
            sources: (M,) indices of the contexts trained on, rising; all when missing.
            name: what results call it.

        Raises:
            InvalidInput: anything breaks a rule above; the message names the key.
        """
        array = checked_returns(returns, square=sources is None)
        n = array.shape[2]
        return cls(
            name=name,
            returns=array,
            space=space_of(contexts, axes, n) if space is None else _agreed(space, contexts),
            bounds=checked_bounds(bounds, array, direction_named(direction), floor),
            theta=default_theta(n) if theta is None else float(theta),
            std=std,
            provenance=dict(provenance or {}),
            fresh_returns=None
            if fresh_returns is None
            else array_of("fresh_returns", fresh_returns),
            episodes=None if episodes is None else tuple(episodes),
            references={key: array_of(key, row) for key, row in (references or {}).items()},
            sources=None if sources is None else array_of("sources", sources),
        )

    @classmethod
    def of_episodes(
        cls, returns: Floats, *, references: Mapping[str, Floats] | None = None, **entries: Any
    ) -> TransferMatrix:
        """Build a matrix from single episodes, the same ones for every policy.

        The first half of them becomes `returns`, the rest `fresh_returns`; of one episode there is
        no fresh half and no deviation.

        Args:
            returns: (S, M, N, E) raw return of every episode.
            references: (S, N, E) likewise without these policies, by name.
            **entries: further arguments of `of`.
        """
        if np.ndim(returns) != 4 or np.shape(returns)[3] < 1:
            raise InvalidInput(
                f"episodes must have shape (seed, source, target, episode), got {np.shape(returns)}"
            )
        total = np.shape(returns)[3]
        means, count = halves(returns)
        some = {}
        for key, row in (references or {}).items():
            if np.shape(row)[-1] != total:
                raise InvalidInput(
                    f"reference {key!r} must have as many episodes as the policies ({total}), got "
                    f"{np.shape(row)[-1]}"
                )
            some[key] = np.stack(halves(row)[0], axis=1)
        return cls.of(
            means[0],
            fresh_returns=means[1] if len(means) > 1 else None,
            std=returns.std(axis=3, ddof=1, dtype=np.float64) if total > 1 else None,
            episodes=count,
            references=some,
            **entries,
        )

    @classmethod
    def load(cls, path: str | Path, *, name: str | None = None) -> TransferMatrix:
        """Read a `.npz` file: `returns`, and optionally the keywords of `of`.

        Args:
            path: of the file.
            name: what results call it; None: the name it was saved with, else its path.

        Raises:
            InvalidInput: the file cannot be read or breaks a rule; the message names file and rule.
        """
        file = Path(path)
        others = set[str]()

        def wanted(name: str) -> bool:
            others.add(name)
            return is_entry(name)

        arrays = read_npz(file, wanted)
        meant = {name.rstrip("s"): name for name in _ENTRIES}
        for other in sorted(others - arrays.keys()):
            if (entry := meant.get(other.lower().rstrip("s"))) is not None:
                raise InvalidInput(
                    f"{file}: holds {other!r}, which is no entry of a matrix; write it {entry!r}, "
                    "or rename what is your own"
                )
        if "returns" not in arrays:
            kinds = "; trainings of every kind are read by mbtl.load_transfers(id, folder=...)"
            raise InvalidInput(
                f"{file}: needs `returns` of shape (seed, source, target), got {sorted(arrays)}"
                + kinds * ("episodes" in arrays)
            )
        try:
            words = keywords(arrays)
            stored = words.pop("name", str(path))
            return cls.of(name=name or stored, **words)
        except InvalidInput as error:
            raise InvalidInput(f"{file}: {error}") from error

    def save(self, path: str | Path) -> None:
        """Write a `.npz` file that `load` reads back to an equal matrix.

        Raises:
            StorageError: the place cannot be written.
        """
        write_npz(Path(path), self.arrays())

    def arrays(self) -> dict[str, NDArray[Any]]:
        """The entries of its `.npz` file."""
        directions = {long: short for short, long in DIRECTIONS.items()}
        entries: dict[str, NDArray[Any]] = {
            "returns": self.returns,
            "axes": np.array([axis.name for axis in self.space.axes]),
            "bounds": np.array([self.bounds.low, self.bounds.high]),
            "direction": np.array(directions[self.bounds.direction]),
            "theta": np.array(self.theta),
            "space": text_array(self.space.to_json()),
            "provenance": text_array(self.provenance),
            "name": np.array(self.name),
        }
        if not any(isinstance(axis, Categorical) for axis in self.space.axes):
            entries["contexts"] = self.contexts
        if self.bounds.floor is not None:
            entries["floor"] = np.array(self.bounds.floor)
        for key in ("std", "fresh_returns"):
            if getattr(self, key) is not None:
                entries[key] = getattr(self, key)
        if self.sources is not None:
            entries["sources"] = self.sources
        if self.episodes is not None:
            entries["episodes"] = np.array(self.episodes)
        entries |= {f"{REFERENCE}{name}": row for name, row in self.references.items()}
        return entries

    # ---- reading -----------------------------------------------------------------------------

    @property
    def n(self) -> int:
        """Number of contexts N."""
        return int(self.returns.shape[2])

    @property
    def n_seeds(self) -> int:
        """Number of seeds S."""
        return int(self.returns.shape[0])

    @property
    def trained(self) -> Indices:
        """(M,) contexts that were trained on, rising."""
        return np.arange(self.n) if self.sources is None else self.sources

    @property
    def axes(self) -> tuple[Axis, ...]:
        """The d axes, with units."""
        return self.space.axes

    @property
    def contexts(self) -> Array:
        """(N, d) context values; `space.contexts` gives them as mappings.

        Raises:
            InvalidInput: an axis is categorical and has no numbers.
        """
        return context_values(self.space)

    def problem(self, budget: int) -> SelectionProblem:
        """What a selector may know of it beforehand."""
        trainable = None
        if self.sources is not None:
            trainable = np.isin(np.arange(self.n), self.sources)
        return SelectionProblem.of(self.space, budget=budget, theta=self.theta, trainable=trainable)

    def rows(self, seed: int, sources: ArrayLike) -> Array:
        """(m, N) performance of the policies trained on `sources` (m,), as a selector sees it."""
        return self.bounds.normalise(self._of(seed, self.returns)[self._places(sources)])

    def fresh_rows(self, seed: int, sources: ArrayLike) -> Array:
        """(m, N) performance of the same policies on the other episodes, if there are any."""
        reported = self.returns if self.fresh_returns is None else self.fresh_returns
        return self.bounds.normalise(self._of(seed, reported)[self._places(sources)])

    def _of(self, seed: int, returns: Floats) -> Floats:
        """(M, N) returns of one seed."""
        return np.asarray(returns[checked_seed(seed, self.n_seeds)])

    def _places(self, sources: ArrayLike) -> Indices:
        """Rows of some sources."""
        wanted = np.asarray(sources)
        if wanted.size and (wanted.dtype.kind not in "iu" or not wanted.min() >= 0):
            raise InvalidInput(
                f"sources are indices of contexts, from 0 to {self.n - 1}, got {short(sources)}"
            )
        if self.sources is None and (not wanted.size or wanted.max() < self.n):
            return wanted.astype(np.intp)
        places = np.searchsorted(self.trained, wanted).clip(max=len(self.trained) - 1)
        missing = wanted[self.trained[places] != wanted]
        if missing.size:
            raise InvalidInput(
                f"{self.name} has no training on context {missing.flat[0]}; those it has are in "
                "`sources`"
            )
        return np.asarray(places)

    @property
    def normalisation(self) -> Bounds:
        """`bounds`, by the name that a CMDP has for them."""
        return self.bounds

    @property
    def records(self) -> list[Mapping[str, Any]]:
        """The provenance of each seed, without entries that are not what their name means."""
        seeds = self.provenance.get("seeds")
        told = seeds if isinstance(seeds, Sequence) else []
        if len(told) != self.n_seeds or not all(isinstance(record, Mapping) for record in told):
            told = [self.provenance] * self.n_seeds
        return [
            {key: fact for key, fact in record.items() if isinstance(fact, _MEANT.get(key, object))}
            for record in told
        ]

    @property
    def cmdp(self) -> str:
        """Id of its CMDP, as its provenance tells; empty if it does not."""
        return str(self.records[0].get("problem", ""))

    @property
    def evaluation_seeds(self) -> str | None:
        """Whether evaluation seeds are "per target" or "common to all targets"; None: unknown.

        Common luck does not average out in V, not even over many targets.
        """
        return seeds_in(self.records)

    @property
    def measures_apart(self) -> bool:
        """Whether there are episodes for the report that selectors do not see."""
        return self.fresh_returns is not None

    @property
    def caveat(self) -> str | None:
        """What must be said beside every number of it; None where there is nothing to say."""
        said = []
        if self.sources is not None:
            said.append(
                f"trained on {len(self.sources)} of the {self.n} contexts; Independent is the mean "
                "over those, so k* compares different contexts"
            )
        record = self.records[0] if self.records else {}
        if dict(record.get("switches") or {}).get("score") == "paper":
            said.append(
                f"returns are the paper's score of {record.get('problem')} (--score paper, version "
                f"{record.get('version')}), not the one that is the default today"
            )
        if not self.measures_apart:
            said.append(
                "selection and report used the same evaluation episodes, so V is too high where "
                "episodes differ by luck (`fresh_returns`, or TransferMatrix.of_episodes, keeps "
                "them apart)"
            )
        return "; ".join(said) or None

    def shown(self, seed: int | None = None) -> Array:
        """(M, N) performance on the episodes that chose nothing, where there are such episodes.

        Args:
            seed: matrix seed; None: the mean over all.
        """
        reported = self.returns if self.fresh_returns is None else self.fresh_returns
        if seed is None:
            return self.bounds.normalise(reported.mean(axis=0, dtype=np.float64))
        return self.bounds.normalise(self._of(seed, reported))

    def performance(self, seed: int) -> Array:
        """(M, N) performance of one seed as a selector sees it, axis order (source, target)."""
        return self.bounds.normalise(self._of(seed, self.returns))

    @property
    def independent(self) -> Array:
        """(S,) one policy per source, each used at home."""
        return np.array([level.independent for level in self._levels()])

    @property
    def oracle_transfer(self) -> Array:
        """(S,) all M policies, each target served by the best one that was seen."""
        return np.array([level.oracle_transfer for level in self._levels()])

    @property
    def grand_mean(self) -> Array:
        """(S,) one policy trained on a random source."""
        return np.array([level.grand_mean for level in self._levels()])

    def _levels(self) -> list[Levels]:
        return [levels(self, seed) for seed in range(self.n_seeds)]
