"""Records of the table of our CMDPs: a simulator family, its engines, and the axes that vary."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from decimal import Decimal
from typing import Any

from mbtl.contexts import Axis, Context, ContextSpace, Linear
from mbtl.errors import unknown_name
from mbtl.problems.cmdp import Preset
from mbtl.score import Score


@dataclass(frozen=True)
class JaxFamily:
    """A family in the jax engine.

    Attributes:
        environment: "module:Class" of a `mbtl.engine.worlds.Environment` or, `on_host`, of a batch.
        presets: recipes by name, the first is the default.
        on_host: a native simulator steps whole batches of it (`mbtl.engine.worlds.hosted`).
    """

    environment: str
    presets: Mapping[str, Preset]
    on_host: bool = False


@dataclass(frozen=True)
class TwinFamily:
    """A traffic family that has a twin in the jax engine.

    Attributes:
        problem: "module:Class" of a record that maps contexts to twin and parameters.
        presets: recipes by name, the first is the default.
        options: of the record.
    """

    problem: str
    presets: Mapping[str, Preset]
    options: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Family:
    """What the CMDPs of one simulator share.

    Attributes:
        entry_point: "module:Class" of the environment.
        horizon: longest episode, environment steps.
        bounds: returns at which performance is 0 and 1 (spec, 2.2).
        paper_bounds: those of the paper, where policies of ours need to be seen by both.
        theta: slope of the linear gap, performance per grid step (spec, 2.2).
        presets: recipes of Stable-Baselines3 by name, the first is the default.
        jax: the same in the jax engine, if it is there.
        in_processes: recipes of the jax engine's learners in the simulator, each simulation in a
            process of its own; empty: they cannot.
        switches: options of the environment beside visibility and time limit.
        simulator: the engine of `entry_point`, "gymnasium" or "sumo".
        visibility: what of the context the policy sees unless told otherwise.
        visibility_on_all: likewise, of one policy for all contexts.
        preset_on_all: whose steps one policy for all contexts has, unless told otherwise.
        check_steps: environment steps of a rollout of `mbtl check`; fewer where steps are long.
        floor: return below which none is worse in performance.
        best_return: the largest return there is; None: not known.
        metrics: what stands beside a score: unit by name of a measure.
        scores: what an episode can be worth, where there is a choice; the first is the default. By
            name what of the fields above is different then. Bounds and floor are of that score.
        score: what an episode is worth; None: the sum of its rewards.
    """

    entry_point: str
    horizon: int
    bounds: tuple[float, float]
    theta: float
    presets: Mapping[str, Preset]
    jax: JaxFamily | TwinFamily | None = None
    in_processes: Mapping[str, Preset] = field(default_factory=dict)
    switches: tuple[str, ...] = ()
    simulator: str = "gymnasium"
    visibility: str = "multiplier"
    visibility_on_all: str = "multiplier"
    preset_on_all: str = "paper"
    paper_bounds: tuple[float, float] | None = None
    check_steps: int | None = None
    floor: float | None = None
    best_return: float | None = None
    metrics: Mapping[str, str] = field(default_factory=dict)
    scores: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    score: Score | None = None

    def scored(self, name: str | None) -> Family:
        """The family by one of its scores; None: the default one.

        Raises:
            UnknownName: it has no such score.
        """
        if name is None:
            return self
        if name not in self.scores:
            only = "" if self.scores else "It has one score; leave the choice out."
            raise unknown_name("score", name, self.scores, hint=only)
        return replace(self, **self.scores[name])


@dataclass(frozen=True)
class GridAxis:
    """One feature of the environment that varies, in equal steps.

    Attributes:
        name: the feature.
        unit: its physical unit.
        step: grid step, a decimal; the grid is k step for k = first, ..., first + n - 1.
        nominal: value of the feature in the context that a user would train on without help.
        n: number of values.
        first: multiple of the step at which the grid begins.
        unit_index: grid index of multiplier 1, not the middle.
        paper_step: grid step by the paper's text where it differs from the released scripts.
    """

    name: str
    unit: str
    step: str
    nominal: float
    n: int = 100
    first: int = 1
    unit_index: int = 9
    paper_step: str | None = None

    def values(self, grid: str) -> list[float]:
        """(n,) grid values; exact decimals, so that contexts print as they are meant."""
        step = Decimal(self.paper_step or self.step) if grid == "paper" else Decimal(self.step)
        return [float(step * k) for k in range(self.first, self.first + self.n)]


@dataclass(frozen=True)
class Variant:
    """One CMDP: what of a family varies, as the full grid over its axes.

    Attributes:
        family: name of the family.
        axes: the features that vary, the last one fastest.
        theta: slope of the linear gap where it is not the family's, performance per grid step.
        version: raised when what a policy is worth, or sees, could change.
        visibility: what of the context the policy sees where it is not the family's.
        description: one line for people.
    """

    family: str
    axes: tuple[GridAxis, ...]
    theta: float | None = None
    version: int = 0
    visibility: str | None = None
    description: str = ""

    @property
    def nominal(self) -> Context:
        """The context that a user would train on without help."""
        return {axis.name: axis.nominal for axis in self.axes}

    def unit(self, grid: str) -> Context:
        """The context at multiplier 1."""
        return {axis.name: axis.values(grid)[axis.unit_index] for axis in self.axes}

    def levels(self, grid: str) -> dict[Axis, list[float]]:
        """The axes, and the grid values of each."""
        each = [(axis, axis.values(grid)) for axis in self.axes]
        return {Linear(a.name, values[0], values[-1], a.unit): values for a, values in each}

    def space(self, grid: str) -> ContextSpace:
        """All contexts."""
        return ContextSpace.grid(self.levels(grid))


def line(
    family: str,
    axis: str,
    unit: str,
    step: str,
    nominal: float,
    *,
    n: int = 100,
    unit_index: int = 9,
    paper_step: str | None = None,
    **record: Any,
) -> Variant:
    """A CMDP with one axis, on the grid step, 2 step, ..., n step.

    The arguments are those of `GridAxis`; `record` has further fields of `Variant`.
    """
    varies = GridAxis(axis, unit, step, nominal, n, unit_index=unit_index, paper_step=paper_step)
    return Variant(family, (varies,), **record)
