"""What a matrix shows on a page: a selector replayed on it, or curves beside a study."""

from __future__ import annotations

import numpy as np

from mbtl.errors import InvalidInput
from mbtl.report.reference import REFERENCE_NAMES, ReferenceCurves
from mbtl.report.subject import Subject
from mbtl.routing import Routing
from mbtl.study import Study, Training
from mbtl.zoo.benchmark.base import measured_curve
from mbtl.zoo.benchmark.compare import compare, selector_of
from mbtl.zoo.benchmark.matrix import TransferMatrix
from mbtl.zoo.benchmark.oracle import reference, reference_levels
from mbtl.zoo.benchmark.replay import replay
from mbtl.zoo.benchmark.shipped import load_matrix, open_matrix, shipped_matrices

_SAME = ("recipe", "version", "switches")
"""What a matrix's provenance and a study's settings must agree on to be compared."""


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
    baselines = {"Random": np.array([k.random for k in known])}
    if study.problem.is_line:
        runs = compare(["greedy"], [matrix], budget, 1).results
        baselines["Greedy"] = np.array([run.performance for run in runs])
    baselines["Sequential Oracle"] = np.array([k.oracle.curve for k in known])
    levels = [reference_levels(matrix, seed) for seed in seeds]
    named = {
        REFERENCE_NAMES.get(n, n): float(np.mean([one[n] for one in levels])) for n in levels[0]
    }
    return ReferenceCurves(name, baselines, named)


def of_file(
    given: str, selector: str = "specialists", *, budget: int = 15, seed: int = 0
) -> Subject:
    """`of_matrix` of a file, or of a shipped matrix by id.

    Raises:
        InvalidInput: the matrix has no such seed, or the file cannot be read.
    """
    matrix = open_matrix(given)
    assert isinstance(matrix, TransferMatrix)
    if not 0 <= seed < matrix.n_seeds:
        raise InvalidInput(
            f"--seed must be from 0 to {matrix.n_seeds - 1} on {matrix.name}, got {seed}"
        )
    return of_matrix(matrix, selector, budget=budget, seed=seed)


def of_matrix(
    matrix: TransferMatrix, selector: str = "specialists", *, budget: int = 15, seed: int = 0
) -> Subject:
    """A selector replayed on a matrix seed, beside others and what the matrix allows."""
    problem = matrix.problem(min(budget, len(matrix.problem(1).sources)))
    rule = selector_of(selector)
    played = replay(rule, problem, lambda i: matrix.rows(seed, [i])[0], trial=seed)
    history = played.history
    space = matrix.space
    picks = [
        Training(
            i,
            p.source,
            space.context(p.source),
            reason=p.reason,
            sources=(p.source,),
            promised=p.acquisition,
            place=i,
        )
        for i, p in enumerate(played.proposals)
    ]
    known = [reference(matrix, s, problem.budget) for s in range(matrix.n_seeds)]
    baselines = {
        "Random": np.array([one.random for one in known]),
        "Sequential Oracle": np.array([one.oracle.curve for one in known]),
    }
    others = [n for n in ("greedy", "mbtl", "specialists") if n != selector]
    others = [name for name in others if name != "greedy" or problem.is_line]
    runs = compare(others, [matrix], problem.budget, 1).results
    for name in others:
        baselines[name] = np.array([run.performance for run in runs if run.selector == name])
    values = measured_curve(matrix, seed, history.sources)
    level = known[seed].levels
    routing = Routing(matrix.space, history.sources, history.rows)
    served = routing.served
    worst = int(served.argmin())
    rows = {REFERENCE_NAMES.get(n, n): v for n, v in known[seed].rows.items()}
    sentences = [
        f"{rule.name} reaches V = {values[-1]:.4f} with {len(values)} trainings on seed {seed}; "
        f"Random is expected to reach {known[seed].random[-1]:.4f}, the Sequential Oracle reaches "
        f"{known[seed].oracle.curve[-1]:.4f}.",
        f"One policy per context gives {level.independent:.4f}, all policies together "
        f"{level.oracle_transfer:.4f}, one policy of a random context {level.grand_mean:.4f}.",
        f"The worst-served context is {matrix.space.describe(matrix.space.context(worst))}, at "
        f"{served[worst]:.4f}.",
        *([f"Note: {matrix.caveat}."] if matrix.caveat else []),
    ]
    return Subject(
        "matrix",
        matrix.name,
        rule.name,
        matrix.space,
        problem,
        history,
        routing,
        values,
        np.arange(1.0, len(values) + 1.0),
        "episodes that chose nothing" if matrix.measures_apart else "the episodes that chose",
        tuple(picks),
        baselines,
        {"Independent": level.independent, "Oracle Transfer": level.oracle_transfer, **rows},
        tuple(sentences),
        matrix.shown(),
        problem.sources,
        {"matrix": matrix.name, "seeds": matrix.records},
    )
