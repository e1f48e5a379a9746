"""The paper's main table from our transfer matrices, beside the published numbers.

Every value is V at K trainings, mean and standard deviation (with n - 1) over matrix seeds (the
paper: over three trials). Independent trains N policies; the multi-task baselines train one.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

import numpy as np

from mbtl.arrays import Array
from mbtl.benchmark.compare import compare, default_selectors
from mbtl.benchmark.matrix import TransferMatrix
from mbtl.benchmark.multitask import MultiTask, load_multitask
from mbtl.benchmark.oracle import reference
from mbtl.benchmark.shipped import DEFAULT, load_matrix, matrix_id, shipped_matrices
from mbtl.errors import unknown_name
from mbtl.objective import k_star

METHODS = (
    "independent",
    "multitask",
    "random",
    "greedy",
    "mbtl",
    "sequential_oracle",
    "oracle_transfer",
)
"""Columns in the paper's order; the last one is ours (all N policies, no selection)."""

OWN = ("ppo", "trpo", "dqn")
"""Multi-task baselines that stand in the paper's column: a CMDP has the one of its algorithm."""

SEARCHED = 100
"""Trainings until which k* is looked for, all of most CMDPs: beyond, MBTL takes minutes."""

_SELECTORS = ("greedy", "mbtl")  # greedy needs one axis


@dataclass(frozen=True)
class Value:
    """Mean and standard deviation over seeds, performance; None of one seed."""

    mean: float
    std: float | None


@dataclass(frozen=True)
class Reproduced:
    """One CMDP: ours and the paper's values by method; a method that is missing is not there.

    Attributes:
        cmdp: CMDP id.
        variant: set of matrices.
        n: contexts N.
        n_seeds: matrix seeds S.
        ours: from our matrices.
        published: of the paper, K = 15.
        multitask: every multi-task baseline we have, by name.
        k_star: per seed, trainings until MBTL reaches max(Independent, Multi-task); None: more than
            were searched.
        k_star_searched: trainings until which it was looked for.
        published_k_star: the paper's mean.
        references: of the reference rows, by name; see `mbtl.benchmark.references`.
        caveat: what must be said beside these values.
    """

    cmdp: str
    variant: str
    n: int
    n_seeds: int
    ours: Mapping[str, Value]
    published: Mapping[str, Value]
    multitask: Mapping[str, Value]
    k_star: tuple[int | None, ...]
    k_star_searched: int
    published_k_star: float | None
    references: Mapping[str, Value]
    caveat: str | None


def published(path: Path | None = None) -> dict[str, tuple[dict[str, Value], float]]:
    """The paper's values by CMDP: (method -> value, mean k*)."""
    file = path or Path(str(resources.files("mbtl.benchmark") / "data")) / "published.csv"
    table = {}
    with file.open(newline="", encoding="utf-8") as lines:
        for row in csv.DictReader(lines):
            values = {
                method: Value(float(row[f"{method}_mean"]), float(row[f"{method}_std"]))
                for method in METHODS
                if f"{method}_mean" in row
            }
            table[row["cmdp"]] = values, float(row["k_star_mean"])
    return table


def reproduce(
    cmdps: Sequence[str] | None = None,
    budget: int = 15,
    variant: str = DEFAULT,
    *,
    folder: str | Path | None = None,
) -> list[Reproduced]:
    """The table for CMDPs of which there are matrices.

    Args:
        cmdps: ids; None: all that the paper has and there are matrices of.
        budget: trainings K.
        variant: set of matrices.
        folder: of the matrices, instead of the package data.

    Raises:
        UnknownName: there is no matrix of a CMDP that was asked for.
    """
    paper = published()
    there = set(shipped_matrices(folder))
    if cmdps is None:
        cmdps = [id for id in paper if matrix_id(id, variant) in there]
    rows = []
    for id in cmdps:
        if matrix_id(id, variant) not in there:
            raise unknown_name("transfer matrix", matrix_id(id, variant), sorted(there))
        values, stars = paper.get(id, ({}, math.nan))
        matrix = load_matrix(id, variant, folder=folder)
        rows.append(_reproduced(id, variant, matrix, budget, values, stars, folder))
    return rows


def _reproduced(
    id: str,
    variant: str,
    matrix: TransferMatrix,
    budget: int,
    values: Mapping[str, Value],
    stars: float,
    folder: str | Path | None,
) -> Reproduced:
    seeds = range(matrix.n_seeds)
    known = [reference(matrix, seed, budget) for seed in seeds]
    baselines = load_multitask(id, folder=None if folder is None else Path(folder) / "multitask")
    multitask = {
        name: matrix.bounds.normalise(found.returns) @ matrix.problem(1).weights
        for name, found in baselines.items()
        if _same_problem(found, matrix, variant)
    }
    able = default_selectors([matrix])
    curves = {
        name: np.stack([run.performance for run in compare([name], [matrix], budget, 1).results])
        for name in _SELECTORS
        if name in able
    }
    per_seed: dict[str, Array] = {
        "independent": np.array([k.levels.independent for k in known]),
        "random": np.array([k.random[-1] for k in known]),
        **{name: curve[:, -1] for name, curve in curves.items()},
        "sequential_oracle": np.array([k.oracle.curve[-1] for k in known]),
        "oracle_transfer": np.array([k.levels.oracle_transfer for k in known]),
    }
    own = next((multitask[method] for method in OWN if method in multitask), None)
    if own is not None:
        per_seed["multitask"] = own
    level = max(
        float(per_seed["independent"].mean()),
        -math.inf if own is None else float(own.mean()),
    )
    stars_found, searched = _k_star(matrix, curves["mbtl"], level)
    return Reproduced(
        id,
        variant,
        matrix.n,
        matrix.n_seeds,
        {method: _value(per_seed[method]) for method in METHODS if method in per_seed},
        values,
        {name: _value(found) for name, found in sorted(multitask.items())},
        stars_found,
        searched,
        None if math.isnan(stars) else stars,
        {name: _value(np.array([k.rows[name] for k in known])) for name in known[0].rows},
        matrix.caveat,
    )


def _k_star(
    matrix: TransferMatrix, curves: Array, level: float
) -> tuple[tuple[int | None, ...], int]:
    """Per seed, and until where it was looked for: farther than K where K is not enough."""
    found = tuple(k_star(curve, level) for curve in curves)
    searched, farther = curves.shape[1], min(matrix.n, SEARCHED)
    if None not in found or farther <= searched:
        return found, searched
    runs = compare(["mbtl"], [matrix], farther, 1).results
    return tuple(k_star(run.performance, level) for run in runs), farther


def _same_problem(baseline: MultiTask, matrix: TransferMatrix, variant: str) -> bool:
    """Whether both were trained with the same switches, wherever they were simulated.

    Where policies see no context by default, one for all contexts is told which one it is in.
    """
    records = (baseline.provenance[0], matrix.provenance["seeds"][0])
    one, other = (record.get("switches") for record in records)
    if one is None or other is None:
        return True
    free = {"engine"}
    if other.get("visibility") == "hidden" and "hidden" not in variant:
        free |= {"visibility"}
    return {k: v for k, v in one.items() if k not in free} == {
        k: v for k, v in other.items() if k not in free
    }


def _value(seeds: Array) -> Value:
    return Value(float(seeds.mean()), float(seeds.std(ddof=1)) if len(seeds) > 1 else None)
