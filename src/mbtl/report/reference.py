"""What goes without a choice of trainings: its names, and curves on a shipped transfer matrix.

Curves are shown only when the matrix was trained by the recipe of the study.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from mbtl.arrays import Array
from mbtl.provider import laboratory
from mbtl.study import Study

REFERENCE_NAMES: Mapping[str, str] = {
    "random_actions": "random actions",
    "unguided": "unguided",
    "fixed_time": "fixed time",
    "actuated": "actuated",
    "nominal_policy": "nominal policy",
    "random_policy": "random policy",
}
"""In the order of tables."""


@dataclass(frozen=True)
class ReferenceCurves:
    """V after 1..K trainings of other methods, over the seeds of a shipped matrix.

    Attributes:
        matrix: id of the matrix.
        baselines: name for people -> (S, K) V: Random (its exact expectation), Sequential Oracle,
            and where the contexts have one axis Greedy.
        levels: V of what needs no selection, mean over seeds, by name for people: random actions,
            the system without a controller, the nominal context's policy, one random policy.
    """

    matrix: str
    baselines: Mapping[str, Array]
    levels: Mapping[str, float] = field(default_factory=dict)

    @property
    def said(self) -> str:
        """Where they are from, and the levels, in a sentence."""
        values = ", ".join(f"{name} {value:.4f}" for name, value in self.levels.items())
        where = f"On the shipped matrix of {self.matrix!r}, {len(self.baselines['Random'])} seeds"
        return f"{where}: other methods as drawn; without selection {values}."


def reference_curves(study: Study) -> ReferenceCurves | None:
    """Curves of a shipped matrix whose recipe is this study's, where there is one."""
    found: ReferenceCurves | None = laboratory().curves(study)
    return found
