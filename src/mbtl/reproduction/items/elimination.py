"""Item 11: how fast MBTL shrinks the search space, beside the rates of the paper's corollaries."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbtl.arrays import Array
from mbtl.benchmark.matrix import TransferMatrix
from mbtl.plot.style import new_figure
from mbtl.reproduction.bench import Bench
from mbtl.reproduction.item import Item, Numbers, absent
from mbtl.reproduction.paper import domain_of
from mbtl.reproduction.table import Table
from mbtl.theory import elimination_rate, halving_fractions, sqrt_fractions
from mbtl.theory.elimination import Form


def compute(bench: Bench) -> Numbers:
    """Per CMDP the longest run of X_k over N, mean over seeds; meant and as printed."""
    found = {}
    for id, case in bench.cases().items():
        matrix = bench.matrix(id)
        picks = case.picks["mbtl"]
        meant = np.array([rates(matrix, s, picks[s]) for s in range(case.n_seeds)])
        printed = np.array(
            [rates(matrix, s, picks[s], form="printed") for s in range(case.n_seeds)]
        )
        found[id] = {
            "domain": domain_of(id),
            "rate": meant.mean(axis=0).tolist(),
            "printed": printed.mean(axis=0).tolist(),
        }
    budget = bench.setting.budget
    return {
        "cmdps": found,
        "sqrt": sqrt_fractions(budget).tolist(),
        "halving": halving_fractions(budget).tolist(),
        "missing": absent(bench),
    }


def rates(matrix: TransferMatrix, seed: int, picks: list[int], form: Form = "corrected") -> Array:
    """(K,) longest run of the targets that the k-th policy may improve, over N."""
    square = np.zeros((matrix.n, matrix.n))
    square[picks] = matrix.rows(seed, picks)  # no other row is looked at
    return elimination_rate(square, picks, theta=matrix.theta, form=form)


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
