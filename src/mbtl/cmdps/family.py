"""Records of the table of our CMDPs: a simulator family, its engines, and one axis that varies."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from decimal import Decimal
from typing import Any

from mbtl.cmdps.cmdp import Preset


@dataclass(frozen=True)
class JaxFamily:
    """A family in the jax engine.

    Attributes:
        environment: name of the class in `mbtl.training.jax`.
        presets: recipes by name, the first is the default.
    """

    environment: str
    presets: Mapping[str, Preset]


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
        theta: slope of the linear gap, performance per grid step (spec, 2.2).
        presets: recipes of Stable-Baselines3 by name, the first is the default.
        jax: the same in the jax engine, if it is there.
        switches: options of the environment beside visibility and time limit.
        simulator: the engine of `entry_point`, "gymnasium" or "sumo".
        visibility: what of the context the policy sees unless told otherwise.
        check_steps: environment steps of a rollout of `mbtl check`; fewer where steps are long.
    """

    entry_point: str
    horizon: int
    bounds: tuple[float, float]
    theta: float
    presets: Mapping[str, Preset]
    jax: JaxFamily | TwinFamily | None = None
    switches: tuple[str, ...] = ()
    simulator: str = "gymnasium"
    visibility: str = "multiplier"
    check_steps: int | None = None


@dataclass(frozen=True)
class Variant:
    """One CMDP: the axis that varies.

    Attributes:
        family: name of the family.
        axis: feature of the environment that varies.
        axis_unit: its physical unit.
        step: grid step, a decimal; the grid is step, 2 step, ..., N step.
        nominal: value of the axis while another one varies.
        n: number of contexts N.
        unit_index: grid index of multiplier 1, not the middle.
        paper_step: grid step by the paper's text where it differs from the released scripts.
        version: raised when results could change.
        description: one line for people.
    """

    family: str
    axis: str
    axis_unit: str
    step: str
    nominal: float
    n: int = 100
    unit_index: int = 9
    paper_step: str | None = None
    version: int = 0
    description: str = ""

    def values(self, grid: str) -> list[float]:
        """(N,) grid values; exact decimals, so that contexts print as they are meant."""
        step = Decimal(self.paper_step or self.step) if grid == "paper" else Decimal(self.step)
        return [float(step * k) for k in range(1, self.n + 1)]
