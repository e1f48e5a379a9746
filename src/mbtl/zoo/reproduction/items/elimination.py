"""Item 11: how fast MBTL shrinks the search space, beside the rates of the paper's corollaries.

The search space X_k is the targets that the k-th policy may improve,

    X_k = { x' : J(pi_1:k-1, x') <= Jhat(pi_xk, x_k) - theta |x_k - x'| }

with the training performance measured afterwards for Jhat. The paper prints Jhat(pi_xk, x'), which
is Jhat(pi_xk, x_k) less the gap already, so the printed set subtracts the gap twice. Its
corollaries suppose |X_k| / N = 1 / sqrt(k), and 2^-floor(log2 k).
"""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np

from mbtl.arrays import Array
from mbtl.objective import regret
from mbtl.plot.style import new_figure
from mbtl.zoo.benchmark.matrix import TransferMatrix
from mbtl.zoo.reproduction.bench import Bench
from mbtl.zoo.reproduction.item import Item, Numbers, Table, absent
from mbtl.zoo.reproduction.paper import domain_of


def compute(bench: Bench) -> Numbers:
    """Per CMDP the longest run of X_k over N, mean over seeds; meant and as printed."""
    found = {}
    for id, case in bench.cases().items():
        matrix = bench.matrix(id)
        picks = case.picks["mbtl"]
        meant = np.array([rates(matrix, s, picks[s]) for s in range(case.n_seeds)])
        printed = np.array([rates(matrix, s, picks[s], gaps=2) for s in range(case.n_seeds)])
        found[id] = {
            "domain": domain_of(id),
            "rate": meant.mean(axis=0).tolist(),
            "printed": printed.mean(axis=0).tolist(),
            "regret": _regrets(matrix, picks),
        }
        if "greedy" in case.picks:
            even = case.picks["greedy"]
            rows = [rates(matrix, s, even[s]) for s in range(case.n_seeds)]
            found[id] |= {
                "control_rate": np.mean(rows, axis=0).tolist(),
                "control_regret": _regrets(matrix, even),
            }
    budget = bench.setting.budget
    return {
        "cmdps": found,
        "sqrt": (1.0 / np.sqrt(np.arange(1.0, budget + 1))).tolist(),
        "halving": [2.0 ** (1 - k.bit_length()) for k in range(1, budget + 1)],
        "missing": absent(bench),
    }


def _regrets(matrix: TransferMatrix, picks: list[list[int]]) -> list[float]:
    """(K,) what each training adds less than the best source would have, mean over seeds."""
    sources = matrix.problem(1).sources
    each = [
        regret(
            matrix.rows(seed, sources), np.searchsorted(sources, some), matrix.problem(1).weights
        )
        for seed, some in enumerate(picks)
    ]
    return [float(x) for x in np.mean(each, axis=0)]


def rates(matrix: TransferMatrix, seed: int, picks: list[int], gaps: int = 1) -> Array:
    """(K,) longest run of the targets that the k-th policy may improve, over N.

    Args:
        matrix: of one axis.
        seed: of the matrix.
        picks: K sources in order.
        gaps: how often the gap is subtracted; 2 as printed.
    """
    rows, at = matrix.rows(seed, picks), np.arange(matrix.n)
    best, found = np.full(matrix.n, -np.inf), []
    for row, pick in zip(rows, picks, strict=True):
        gap = matrix.theta * np.abs(at - pick)
        found.append(longest_run(best <= row[pick] - gaps * gap) / matrix.n)
        best = np.maximum(best, row)
    return np.array(found)


def longest_run(mask: Array) -> int:
    """Length of the longest run of consecutive True entries; 0 if there is none."""
    return max((len(list(run)) for is_in, run in itertools.groupby(mask) if is_in), default=0)


def tables(numbers: Numbers) -> dict[str, Table]:
    """The rate after 2, 5, 10 and all trainings."""
    shown = [k for k in (2, 5, 10, len(numbers["sqrt"])) if k <= len(numbers["sqrt"])]
    shown = sorted(set(shown))

    def cells(values: list[float]) -> list[float | None]:
        return [values[k - 1] if k <= len(values) else None for k in shown]

    rows = [(id, *cells(one["rate"])) for id, one in numbers["cmdps"].items()]
    rows.append(("1/sqrt(k), first corollary", *cells(numbers["sqrt"])))
    rows.append(("halving, second corollary", *cells(numbers["halving"])))
    return {
        "": Table(
            "Search space that is left at the k-th training: longest run of contexts that it may "
            "improve, as a share of all; mean over seeds.",
            ("CMDP", *(f"k = {k}" for k in shown)),
            tuple(rows),
            ("The search space is the meant one; the printed one subtracts the gap twice (in the "
             "numbers).",),
        )
    }  # fmt: skip


def figures(numbers: Numbers) -> dict[str, Any]:
    """Thin: every CMDP. Thick: their mean. Dashed: the corollaries."""
    some = numbers["cmdps"]
    figure = new_figure(6.8, 2.8)
    grid = figure.subplots(1, 2, sharey=True)
    for ax, domain in zip(grid, ("traffic", "control"), strict=True):
        rows = [one["rate"] for one in some.values() if one["domain"] == domain]
        for row in rows:
            ax.plot(np.arange(1, len(row) + 1), row, color="#0072B2", lw=0.7, alpha=0.45)
        if rows:
            shortest = min(map(len, rows))
            mean = np.mean([row[:shortest] for row in rows], axis=0)
            ax.plot(np.arange(1, shortest + 1), mean, color="#0072B2", lw=2.2,
                    label=f"MBTL, mean of {len(rows)}")  # fmt: skip
        k = np.arange(1, len(numbers["sqrt"]) + 1)
        ax.plot(k, numbers["sqrt"], "--", color="#333333", label="1/sqrt(k)")
        ax.plot(k, numbers["halving"], ":", color="#D55E00", label="halving", drawstyle="steps-mid")
        ax.set_title(domain.capitalize())
        ax.set_xlabel("trainings k")
        ax.legend(loc="upper right")
    grid[0].set_ylabel("search space left, share of N")
    return {"": figure}


ITEM = Item(11, "elimination", "How fast the search space shrinks", compute, tables, figures)
