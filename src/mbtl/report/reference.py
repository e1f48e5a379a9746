"""Reference curves beside a study: Random, Greedy and the Oracle on a shipped transfer matrix.

They are shown only when the matrix was trained by the recipe of the study.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from mbtl.arrays import Array
from mbtl.benchmark import compare, load_matrix, reference, reference_levels, shipped_matrices
from mbtl.benchmark.oracle import NAMES
from mbtl.study import Study

_SAME = ("recipe", "version", "switches")
"""What a matrix's provenance and a study's settings must agree on to be compared."""


@dataclass(frozen=True)
class ReferenceCurves:
    """V after 1..K trainings of other methods, over the seeds of a shipped matrix.

    Attributes:
        matrix: id of the matrix.
        random: (S, K) Random, exact expectation.
        greedy: (S, K) Greedy; empty where the contexts have more than one axis.
        oracle: (S, K) Sequential Oracle.
        levels: V of what needs no selection, mean over seeds, by name for people: random actions,
            the system without a controller, the nominal context's policy, one random policy.
    """

    matrix: str
    random: Array
    greedy: Array
    oracle: Array
    levels: Mapping[str, float] = field(default_factory=dict)

    @property
    def baselines(self) -> dict[str, Array]:
        """The curves by name for people, (S, K) each; those there are."""
        named = {"Random": self.random, "Greedy": self.greedy, "Sequential Oracle": self.oracle}
        return {name: curves for name, curves in named.items() if len(curves)}

    @property
    def said(self) -> str:
        """Where they are from, and the levels, in a sentence."""
        values = ", ".join(f"{name} {value:.4f}" for name, value in self.levels.items())
        where = f"On the shipped matrix of {self.matrix!r}, {len(self.random)} seeds"
        return f"{where}: other methods as drawn; without selection {values}."


def reference_curves(study: Study) -> ReferenceCurves | None:
    """Curves of a shipped matrix whose recipe is this study's, where there is one."""
    name, settings = study.spec.problem, study.spec.settings
    if name not in shipped_matrices():
        return None
    matrix = load_matrix(name)
    same = [
        all(record.get(key) == settings.get(key) for key in _SAME)
        for record in matrix.provenance["seeds"]
    ]
    if not all(same) or matrix.space != study.space or study.spec.risk < 1.0:
        return None  # its V would be of something else
    budget, seeds = min(study.spec.budget, matrix.n), range(matrix.n_seeds)
    known = [reference(matrix, seed, budget) for seed in seeds]
    greedy: Array = np.empty((0, budget))
    if study.problem.is_line:
        runs = compare(["greedy"], [matrix], budget, 1).results
        greedy = np.array([run.performance for run in runs])
    levels = [reference_levels(matrix, seed) for seed in seeds]
    return ReferenceCurves(
        name,
        np.array([k.random for k in known]),
        greedy,
        np.array([k.oracle.curve for k in known]),
        {NAMES.get(n, n): float(np.mean([one[n] for one in levels])) for n in levels[0]},
    )
