"""Transfer matrices: returns J[seed, source, target] with their contexts and scale.

Notation (shapes): S seeds, N contexts, d axes.
    returns  (S, N, N)  raw return of the policy trained on `source`, run on `target`
    performance         returns after `bounds`; larger is better, not clipped
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mbtl.arrays import Array
from mbtl.benchmark.base import Levels, levels
from mbtl.benchmark.entries import (
    DIRECTIONS,
    Floats,
    checked_bounds,
    checked_returns,
    keywords,
    space_of,
)
from mbtl.benchmark.npz import read_npz, text_array, write_npz
from mbtl.contexts import Axis, Categorical, ContextSpace
from mbtl.errors import InvalidInput
from mbtl.objective import Bounds, direction_named
from mbtl.selectors.base import SelectionProblem, default_theta


@dataclass(frozen=True, eq=False)
class TransferMatrix:
    """Every policy on every target, for one or more training seeds.

    `TransferMatrix.of` fills in what is missing, `TransferMatrix.load` reads a file.

    Attributes:
        name: what results call it.
        returns: (S, N, N) raw returns, axis order (seed, source, target); read-only.
        space: the N contexts in index order.
        bounds: return -> performance, with the direction.
        theta: slope of the linear gap, performance per grid step.
        std: (S, N, N) standard deviation of the evaluation episodes, in units of return, if known.
        provenance: how it was made; free-form.
    """

    name: str
    returns: Floats
    space: ContextSpace
    bounds: Bounds
    theta: float
    std: Floats | None = None
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "returns", _read_only(checked_returns(self.returns)))
        if self.space.n != self.n:
            raise InvalidInput(
                f"contexts must be one per row of `returns` ({self.n}), got {self.space.n}"
            )
        if self.std is not None:
            if np.shape(self.std) != self.returns.shape:
                raise InvalidInput(
                    f"std must have the shape of returns {self.returns.shape}, "
                    f"got {np.shape(self.std)}"
                )
            object.__setattr__(self, "std", _read_only(np.asarray(self.std)))
        if not (np.isfinite(self.theta) and self.theta >= 0):
            raise InvalidInput(f"theta must be a finite number >= 0, got {self.theta!r}")

    # ---- constructors ------------------------------------------------------------------------

    @classmethod
    def of(
        cls,
        returns: ArrayLike,
        *,
        contexts: ArrayLike | None = None,
        axes: Sequence[str] | None = None,
        space: ContextSpace | None = None,
        bounds: ArrayLike | None = None,
        theta: float | None = None,
        direction: str = "max",
        std: Floats | None = None,
        provenance: Mapping[str, Any] | None = None,
        name: str = "matrix",
    ) -> TransferMatrix:
        """Build a matrix from arrays; the keywords are the keys of a `.npz` file.

        Args:
            returns: (S, N, N) raw returns, finite.
            contexts: (N, d) context values; one axis of indices 0..N-1 when missing.
            axes: d axis names.
            space: the context space itself, instead of `contexts` and `axes`.
            bounds: (2,) returns that become performance 0 and 1 (1 and 0 when minimised); the
                smallest and largest return over all seeds when missing.
            theta: performance per grid step; 0.005 for N <= 100, else 0.5 / (N - 1), when missing.
            direction: "max" or "min" (or the long names), which returns are good.
            std: (S, N, N) standard deviation over episodes.
            provenance: how it was made.
            name: what results call it.

        Raises:
            InvalidInput: anything breaks a rule above; the message names the key.
        """
        array = checked_returns(returns)
        n = array.shape[1]
        return cls(
            name=name,
            returns=array,
            space=space_of(contexts, axes, n) if space is None else space,
            bounds=checked_bounds(bounds, array, direction_named(direction)),
            theta=default_theta(n) if theta is None else float(theta),
            std=std,
            provenance=dict(provenance or {}),
        )

    @classmethod
    def load(cls, path: str | Path, *, name: str | None = None) -> TransferMatrix:
        """Read a `.npz` file: `returns`, and optionally the keywords of `of`.

        Raises:
            InvalidInput: the file cannot be read or breaks a rule; the message names file and rule.
        """
        file = Path(path)
        arrays = read_npz(file)
        if "returns" not in arrays:
            raise InvalidInput(
                f"{file}: needs `returns` of shape (seed, source, target), got {sorted(arrays)}"
            )
        try:
            return cls.of(name=name or str(path), **keywords(arrays))
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
        }
        if not any(isinstance(axis, Categorical) for axis in self.space.axes):
            entries["contexts"] = self.contexts
        if self.std is not None:
            entries["std"] = self.std
        return entries

    # ---- reading -----------------------------------------------------------------------------

    @property
    def n(self) -> int:
        """Number of contexts N."""
        return int(self.returns.shape[1])

    @property
    def n_seeds(self) -> int:
        """Number of seeds S."""
        return int(self.returns.shape[0])

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
        for axis in self.axes:
            if isinstance(axis, Categorical):
                raise InvalidInput(
                    f"axis {axis.name!r} is categorical and has no numbers; use space.contexts"
                )
        columns = [self.space.values(axis.name) for axis in self.axes]
        return np.array(columns, dtype=np.float64).T

    def problem(self, budget: int) -> SelectionProblem:
        """What a selector may know of it beforehand."""
        return SelectionProblem.of(self.space, budget=budget, theta=self.theta)

    def rows(self, seed: int, sources: ArrayLike) -> Array:
        """(m, N) performance of the policies trained on `sources` (m,)."""
        return self.bounds.normalise(self.returns[seed, np.asarray(sources, dtype=np.intp)])

    def performance(self, seed: int) -> Array:
        """(N, N) performance of one seed, axis order (source, target)."""
        return self.bounds.normalise(self.returns[seed])

    @property
    def independent(self) -> Array:
        """(S,) one policy per context, each used at home."""
        return np.array([level.independent for level in self._levels()])

    @property
    def oracle_transfer(self) -> Array:
        """(S,) all N policies, the best per target: the upper bound of any selection."""
        return np.array([level.oracle_transfer for level in self._levels()])

    @property
    def grand_mean(self) -> Array:
        """(S,) one policy trained on a random context."""
        return np.array([level.grand_mean for level in self._levels()])

    def _levels(self) -> list[Levels]:
        return [levels(self, seed) for seed in range(self.n_seeds)]


def _read_only(array: Floats) -> Floats:
    view = array.view()
    view.flags.writeable = False
    return view
