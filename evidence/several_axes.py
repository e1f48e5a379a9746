"""`auto` with several axes, beside other selectors.

Worlds of transfer with a known structure: a policy serves a plateau around its context that ends in
a cliff, three times as far on one side as on the other; every training has luck of its own, one in
twenty fails. What differs is how many axes there are and how many of them matter, on grids, on
lists of points, and on mixed axes (linear, logarithmic, whole numbers, categories). `hard` axes
change how hard a target is but not what serves it.

Printed: the share of the distance from Random to the Sequential Oracle that is closed (under the
curve, and at K), and trainings to 90 % and 95 % of the way to Oracle Transfer.

example: python evidence/several_axes.py --seeds 3 --budget 15
"""

from __future__ import annotations

import measure  # first: threads

from collections.abc import Mapping  # isort: skip
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from measure import digits, note
from numpy.typing import ArrayLike

from mbtl.arrays import Array
from mbtl.contexts import Axis, Categorical, ContextSpace, Integer, Linear, Log
from mbtl.selectors import SelectionProblem
from mbtl.zoo.benchmark import compare

SELECTORS = ("random", "kmeans", "mbtl", "m-mbtl", "sd-mbtl", "specialists", "oracle")


@dataclass(frozen=True, eq=False)
class World:
    """A `RowSource` of policies with a reach.

    Attributes:
        name: what results call it.
        space: the contexts.
        reach: of a policy along each axis that matters, in unit coordinates, towards smaller
            targets; three times as far towards larger ones is as good. Categories differ by 1.
        hard: performance lost from one end of an axis to the other, whatever the source.
        n_seeds: number of matrices.
        luck, failing, noise: standard deviation of a training's level, share of trainings that
            keep a third of theirs, and standard deviation of every entry.
    """

    name: str
    space: ContextSpace
    reach: Mapping[str, float]
    hard: Mapping[str, float] = field(default_factory=dict)
    n_seeds: int = 3
    luck: float = 0.03
    failing: float = 0.05
    noise: float = 0.01

    @property
    def n(self) -> int:
        """Number of contexts."""
        return self.space.n

    def problem(self, budget: int) -> SelectionProblem:
        """What a selector may know."""
        return SelectionProblem.of(self.space, budget=budget)

    def rows(self, seed: int, sources: ArrayLike) -> Array:
        """(m, N) performance."""
        return np.stack([self._row(seed, int(source)) for source in np.atleast_1d(sources)])

    def fresh_rows(self, seed: int, sources: ArrayLike) -> Array:
        """The same rows."""
        return self.rows(seed, sources)

    @property
    def measures_apart(self) -> bool:
        """Whether selection and report use other episodes."""
        return False

    def _row(self, seed: int, source: int) -> Array:
        far, level = np.zeros(self.n), np.full(self.n, 0.9)
        for name, column in self._blocks.items():
            if name in self.reach:
                away = column - column[source]
                if column.shape[1] == 1:
                    away = np.where(away > 0.0, away / 3.0, away)
                far += np.square(away).sum(axis=1) / self.reach[name] ** 2
            level -= self.hard.get(name, 0.0) * column[:, 0]
        rng = np.random.default_rng([seed, source])
        luck = 1.0 - abs(self.luck * rng.standard_normal())
        luck *= 1.0 / 3.0 if rng.random() < self.failing else 1.0
        noise = self.noise * rng.standard_normal(self.n)
        return np.asarray(luck * level / (1.0 + np.square(far)) + noise)

    @cached_property
    def _blocks(self) -> dict[str, Array]:
        """Unit columns by axis."""
        ends = np.cumsum([axis.width for axis in self.space.axes])[:-1]
        parts = np.split(self.space.unit, ends, axis=1)
        return {axis.name: part for axis, part in zip(self.space.axes, parts, strict=True)}


def worlds(n_seeds: int) -> list[World]:
    """Half of them with axes that do not matter."""
    grid = ContextSpace.grid({Linear(name, 0, 1): 8 for name in "abc"})
    five = ContextSpace.sample([Linear(name, 0, 1) for name in "abcde"], 400, seed=1)
    axes: list[Axis] = [Linear("a", -1, 1), Log("b", 0.1, 10), Integer("c", 1, 6)]
    mixed = ContextSpace.sample([*axes, Categorical("d", ("p", "q", "r"))], 400, seed=2)
    return [
        World("3 axes, 1 matters", grid, {"a": 0.1}, n_seeds=n_seeds),
        World("3 axes, 2 matter, 1 hard", grid, {"a": 0.2, "b": 0.2}, {"c": 0.5}, n_seeds),
        World("3 axes, 3 matter", grid, dict.fromkeys("abc", 0.4), n_seeds=n_seeds),
        World("5 axes, 2 matter (points)", five, {"a": 0.2, "b": 0.2}, n_seeds=n_seeds),
        World("5 axes, 5 matter (points)", five, dict.fromkeys("abcde", 0.6), n_seeds=n_seeds),
        World("mixed, log and categories matter", mixed, {"b": 0.15, "d": 0.7}, n_seeds=n_seeds),
        World("mixed, 4 matter", mixed, {"a": 0.5, "b": 0.4, "c": 0.5, "d": 0.7}, n_seeds=n_seeds),
    ]


def main() -> None:
    """Measure and print."""
    parser = measure.parser(__doc__)
    parser.add_argument("--seeds", type=int, default=3, help="matrices of every world")
    parser.add_argument("--budget", type=int, default=15)
    parser.add_argument("--selectors", default=",".join(SELECTORS))
    parser.add_argument("--only", default="", help="part of the name of a world")
    args = parser.parse_args()
    chosen = [world for world in worlds(args.seeds) if args.only in world.name]
    entrants = args.selectors.split(",")
    summary = compare(
        entrants, chosen, args.budget, 1, on_step=lambda step: note(step.doing)
    ).summary
    lines: list[str] = []
    document: dict[str, Any] = {"budget": args.budget, "seeds": args.seeds, "worlds": {}}
    tables = {**{name: found.selectors for name, found in summary.matrices.items()}}
    for name, table in {**tables, "all": summary.pooled}.items():
        lines += [name, f"  {'':18s}{'curve':>8s}{'at K':>8s}{'k90':>8s}{'k95':>8s}"]
        document["worlds"][name] = {}
        for label, one in table.items():
            figures = [one.closed_under_curve.value, one.closed_at_K.value]
            cells = ["-" if v is None else f"{v:.2f}" for v in figures]
            for level in (one.k90, one.k95):
                value = level.estimate.value
                mark = ">" if level.censored else ""
                cells.append("-" if value is None else f"{mark}{value:.1f}")
                figures.append(value)
            lines.append(f"  {label:18s}" + "".join(f"{cell:>8s}" for cell in cells))
            document["worlds"][name][label] = [v if v is None else digits(v) for v in figures]
    document["machine"] = measure.machine()
    measure.show(document, lines, as_json=args.json)


if __name__ == "__main__":
    main()
