"""Reference curves beside a study: Random, Greedy and the Oracle on a shipped transfer matrix.

They are shown only when the matrix was trained by the recipe of the study.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbtl.arrays import Array
from mbtl.benchmark import compare, load_matrix, reference, shipped_matrices
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
    """

    matrix: str
    random: Array
    greedy: Array
    oracle: Array


def reference_curves(study: Study) -> tuple[ReferenceCurves | None, str]:
    """Curves of a shipped matrix whose recipe is this study's, and a sentence on what was found."""
    name, settings = study.spec.problem, study.spec.settings
    if name not in shipped_matrices():
        return None, f"no reference curves: no transfer matrix of {name!r} is shipped"
    matrix = load_matrix(name)
    same = [
        all(record.get(key) == settings.get(key) for key in _SAME)
        for record in matrix.provenance["seeds"]
    ]
    if not all(same) or matrix.space != study.space:
        return (
            None,
            f"no reference curves: the shipped matrix of {name!r} was trained by another recipe",
        )
    if study.spec.risk < 1.0:
        return None, "no reference curves: they are of the mean, this study's V is not"
    budget, seeds = min(study.spec.budget, matrix.n), range(matrix.n_seeds)
    known = [reference(matrix, seed, budget) for seed in seeds]
    greedy: Array = np.empty((0, budget))
    if study.problem.is_line:
        runs = compare(["greedy"], [matrix], budget, 1).results
        greedy = np.array([run.performance for run in runs])
    curves = ReferenceCurves(
        name, np.array([k.random for k in known]), greedy, np.array([k.oracle.curve for k in known])
    )
    return curves, f"reference curves: the shipped matrix of {name!r}, {matrix.n_seeds} seeds"
