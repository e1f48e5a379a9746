"""Synthetic worlds: transfer matrices with known structure, of any size, one row at a time.

    J(x, y) = offset + f(x) + g(y) - sum_q loss_q(x_q - y_q) + noise Z(x, y)
    loss_q(D) = left_q min(D, 0) + right_q max(D, 0),    Z ~ N(0, 1), independent

f is source quality, g target difficulty; left = -right makes the loss a distance, left > 0 makes
return rise while the source lies below the target, which no distance does. Z is keyed by (name,
seed, source): a row is the same in whatever order rows are asked for, no matrix is ever stored, and
worlds of other names have other noise.

Notation (shapes): N contexts on a grid of d axes with n_q levels (C order, last axis fastest).
Source: SD-MBTL (AAAI 2026), section on synthetic data; the linear-gap world is MBTL's assumption.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from mbtl.arrays import Array
from mbtl.contexts import ContextSpace, Integer
from mbtl.errors import InvalidInput
from mbtl.objective import Bounds
from mbtl.plain import finite, floats, short, whole
from mbtl.selectors.base import SelectionProblem, default_theta
from mbtl.zoo.benchmark.base import BLOCK_BYTES, checked_seed


@dataclass(frozen=True, eq=False)
class SyntheticWorld:
    """A family member: a `RowSource` whose matrices follow the formula above.

    Attributes:
        name: what results call it, and where its noise comes from; "@" and what follows counts
            seeds (`synthetic_world`) and has no part in that.
        shape: (d,) levels per axis; N is their product.
        quality: f, (N,) or a number, in units of return.
        difficulty: g, (N,) or a number, in units of return.
        left: (d,) slope of the loss where the source lies below the target, return per grid step.
        right: (d,) slope of the loss where it lies above.
        offset: constant, in units of return.
        noise: standard deviation of Z's term, in units of return.
        n_seeds: number of matrices S; a world without noise has one.
        scale: bounds given, or computed over all S matrices ("all") or for each alone ("each").
        theta: slope handed to selectors, performance per grid step; the default rule when None.
    """

    name: str
    shape: tuple[int, ...]
    quality: ArrayLike
    difficulty: ArrayLike
    left: tuple[float, ...]
    right: tuple[float, ...]
    offset: float = 0.0
    noise: float = 0.0
    n_seeds: int = 1
    scale: Bounds | str = "all"
    theta: float | None = None
    _scales: dict[int, Bounds] = field(default_factory=dict, init=False, repr=False)

    def __post_init__(self) -> None:
        if not isinstance(self.name, str):
            raise InvalidInput(f"name is a text, got {short(self.name)}")
        whole("n_seeds", self.n_seeds)
        for levels in self.shape:
            whole("a level count", levels)
        for slope in (*self.left, *self.right, self.offset, self.noise, self.theta or 0.0):
            finite("a slope, offset or noise", np.nan if slope is None else slope)
        d = len(self.shape)
        if d < 1 or min(self.shape) < 1 or len(self.left) != d or len(self.right) != d:
            raise InvalidInput(
                f"a world needs one level count, left and right slope per axis, got shape "
                f"{self.shape}, left {self.left} and right {self.right}"
            )
        if self.noise < 0.0:
            raise InvalidInput(f"noise is 0 or more, got {self.noise:g}")
        if self.n_seeds < 1 or (self.n_seeds > 1 and self.noise == 0):
            raise InvalidInput(
                f"a world has at least one seed, and just one without noise, where all are equal; "
                f"got {self.n_seeds} seeds with noise {self.noise:g}"
            )
        if not isinstance(self.scale, Bounds) and self.scale not in ("all", "each"):
            raise InvalidInput(f"scale must be Bounds, 'all' or 'each', got {self.scale!r}")
        for label, term in (("quality", self.quality), ("difficulty", self.difficulty)):
            try:
                known = np.isfinite(floats(term))
            except (TypeError, ValueError):
                known = np.array(False)
            if known.shape not in ((), (self.n,)) or not known.all():
                raise InvalidInput(
                    f"{label} must be a finite number or {self.n} of them, got {short(term)}"
                )

    @property
    def n(self) -> int:
        """Number of contexts N."""
        return int(np.prod(self.shape))

    @cached_property
    def space(self) -> ContextSpace:
        """The grid, in steps."""
        names = ["x"] if len(self.shape) == 1 else [f"x{q}" for q in range(len(self.shape))]
        return ContextSpace.grid(
            {
                Integer(name, 0, max(levels - 1, 1)): list(range(levels))
                for name, levels in zip(names, self.shape, strict=True)
            }
        )

    def problem(self, budget: int) -> SelectionProblem:
        """What a selector may know of it beforehand."""
        theta = default_theta(self.n) if self.theta is None else self.theta
        return SelectionProblem.of(self.space, budget=budget, theta=theta)

    def returns(self, seed: int, sources: ArrayLike) -> Array:
        """(m, N) returns of the policies trained on `sources` (m,)."""
        index, seed = np.asarray(sources, dtype=np.intp), checked_seed(seed, self.n_seeds)
        total = np.full((len(index),) + (1,) * len(self.shape), self.offset)
        for q, level in enumerate(np.unravel_index(index, self.shape)):
            ones = [1] * len(self.shape)
            ones[q] = self.shape[q]
            total = total - self._losses[q][level].reshape(len(index), *ones)
        rows = total.reshape(len(index), self.n)
        rows += np.broadcast_to(self.quality, self.n)[index, None]
        rows += np.asarray(self.difficulty)
        if self.noise:
            for row, source in zip(rows, index.tolist(), strict=True):
                row += self.noise * _row_noise(self._key, seed, source, self.n)
        return rows

    def rows(self, seed: int, sources: ArrayLike) -> Array:
        """(m, N) performance of the policies trained on `sources` (m,)."""
        return self.bounds(seed).normalise(self.returns(seed, sources))

    def fresh_rows(self, seed: int, sources: ArrayLike) -> Array:
        """The same rows: nothing is evaluated here, so there is no luck of episodes."""
        return self.rows(seed, sources)

    @property
    def measures_apart(self) -> bool:
        """False, see `fresh_rows`."""
        return False

    def bounds(self, seed: int) -> Bounds:
        """Return -> performance for one matrix seed; exact extremes, found by reading all rows."""
        if isinstance(self.scale, Bounds):
            return self.scale
        if seed not in self._scales:
            group = range(self.n_seeds) if self.scale == "all" else [seed]
            extremes = [self._extremes(s) for s in group]
            lows, highs = zip(*extremes, strict=True)
            self._scales.update(dict.fromkeys(group, Bounds.of([min(lows), max(highs)])))
        return self._scales[seed]

    @cached_property
    def _key(self) -> int:
        """32 bits of the name."""
        return zlib.crc32(self.name.partition("@")[0].encode())

    @cached_property
    def _losses(self) -> list[Array]:
        """Per axis (n_q, n_q): loss from a source level to a target level."""
        tables = []
        for levels, left, right in zip(self.shape, self.left, self.right, strict=True):
            difference = np.arange(levels)[:, None] - np.arange(levels)[None, :]
            tables.append(left * np.minimum(difference, 0) + right * np.maximum(difference, 0))
        return tables

    def _extremes(self, seed: int) -> tuple[float, float]:
        low, high = np.inf, -np.inf
        size = max(1, BLOCK_BYTES // (32 * self.n))
        for start in range(0, self.n, size):
            block = self.returns(seed, np.arange(start, min(start + size, self.n)))
            low, high = min(low, float(block.min())), max(high, float(block.max()))
        return low, high


def _row_noise(world: int, seed: int, source: int, n: int) -> Array:
    """(n,) standard normals of one row; counter-based, so that rows need no common stream."""
    key = np.array([world << 32 | seed, source], dtype=np.uint64)
    return np.random.Generator(np.random.Philox(key=key)).standard_normal(n)


def linear_gap_world(
    n: int = 100,
    *,
    level: ArrayLike = 0.9,
    slope: float = 0.005,
    noise: float = 0.0,
    n_seeds: int | None = None,
    name: str = "synthetic:linear-gap",
) -> SyntheticWorld:
    """J(i, j) = level_i - slope |i - j| + noise Z, already a performance: MBTL's assumption holds.

    Args:
        n: number of contexts on one axis.
        level: training performance, a number or (N,).
        slope: loss per grid step, >= 0; also the theta that selectors are told.
        noise: standard deviation of every entry.
        n_seeds: 3 when missing, or 1 without noise.
        name: what results call it.

    Raises:
        InvalidInput: a negative slope, or numbers that make no world.
    """
    finite("slope", slope, 0.0)
    return SyntheticWorld(
        name=name,
        shape=(n,),
        quality=level,
        difficulty=0.0,
        left=(-slope,),
        right=(slope,),
        noise=noise,
        n_seeds=n_seeds if n_seeds is not None else 3 if noise else 1,
        scale=Bounds(0.0, 1.0),
        theta=slope,
    )
