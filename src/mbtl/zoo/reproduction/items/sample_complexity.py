"""Item 2: trainings until MBTL is as good as training on every context, or as one for all.

Beside it stand Random (its mean curve) and Greedy, which know nothing of the returns.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mbtl.plot.style import new_figure
from mbtl.zoo.reproduction.bench import Bench, Case
from mbtl.zoo.reproduction.item import Item, Numbers, Table, absent
from mbtl.zoo.reproduction.paper import domain_of


def compute(bench: Bench) -> Numbers:
    """Per CMDP k* of each seed and N over its mean, beside the paper's."""
    rows = []
    cases = bench.cases()
    for id in bench.ids:
        paper = bench.paper.get(id)
        row: dict[str, Any] = {"cmdp": id, "domain": domain_of(id), "ours": None, "published": None}
        if paper is not None:
            row["published"] = {
                "k_star": list(paper.k_star),
                "mean": paper.mean_k_star,
                "efficiency": paper.efficiency,
            }
        if id in cases:
            row["ours"] = _ours(cases[id])
        rows.append(row)
    return {"rows": rows, "best": _best(rows), "missing": absent(bench)}


def _ours(case: Case) -> dict[str, Any]:
    stars = case.k_star
    reached = all(k is not None for k in stars)
    mean = float(np.mean([k for k in stars if k is not None])) if reached else None
    independent = float(case.levels["independent"].mean())
    own = None if case.own is None else float(case.own.mean())
    return {
        "level": float(case.target_levels.mean()),
        "set_by": "independent" if own is None or independent >= own else "multitask",
        "has_multitask": own is not None,
        "within_reach": bool((case.target_levels <= case.levels["oracle_transfer"]).all()),
        "oracle_transfer": float(case.levels["oracle_transfer"].mean()),
        "k_star": list(stars),
        "searched": case.far.shape[1],
        "n": case.n,
        "mean": mean,
        "efficiency": None if mean is None else case.n_sources / mean,
        "control": _control(case),
    }


def _control(case: Case) -> float | None:
    """M / k* of the better of Random and Greedy, within K trainings; None if neither is there."""
    means = []
    for name in {"random", "greedy"} & case.curves.keys():
        stars = case.stars_of(case.curves[name])
        if None not in stars:
            means.append(float(np.mean([k for k in stars if k is not None])))
    return case.n_sources / min(means) if means else None


def _best(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """The largest M / k* of each domain, ours and the control's, and the paper's own N / k*."""
    found: dict[str, Any] = {}
    for domain in ("traffic", "control"):
        for name, who, key in (
            ("ours", "ours", "efficiency"),
            ("control", "ours", "control"),
            ("published", "published", "efficiency"),
        ):
            some = [
                (row[who][key], row["cmdp"])
                for row in rows
                if row["domain"] == domain and row[who] and row[who][key] is not None
            ]
            best = max(some, default=None)
            found[f"{domain}_{name}"] = None if best is None else {"of": best[1], "value": best[0]}
    return found


def tables(numbers: Numbers) -> dict[str, Table]:
    """k* per seed, its mean, and N over it."""
    rows = []
    for row in numbers["rows"]:
        ours, paper = row["ours"], row["published"]
        level = {"independent": "Independent", "multitask": "Multi-task"}
        rows.append(
            (
                row["cmdp"],
                None if ours is None else float(ours["level"]),
                "" if ours is None else level[ours["set_by"]],
                "" if ours is None else _stars(ours),
                None if ours is None or ours["mean"] is None else f"{ours['mean']:.2f}",
                None if ours is None or ours["efficiency"] is None else f"{ours['efficiency']:.1f}",
                None if ours is None or ours["control"] is None else f"{ours['control']:.1f}",
                "" if paper is None else ", ".join(map(str, paper["k_star"])),
                None if paper is None else f"{paper['mean']:.2f}",
                None if paper is None else f"{paper['efficiency']:.1f}",
            )
        )
    return {
        "": Table(
            "Trainings k* until MBTL reaches the better of Independent and Multi-task, per seed; "
            "M sources (the paper's N) over their mean.",
            ("CMDP", "mean level", "set by", "k* here", "mean", "M/k*", "M/k* of the control",
             "k* paper", "mean (paper)", "N/k* (paper)"),
            tuple(rows),
            ("Control: the better of Random and Greedy, within K trainings. > n: not within n.",),
        )
    }  # fmt: skip


def _stars(ours: dict[str, Any]) -> str:
    return ", ".join(f"> {ours['searched']}" if k is None else str(k) for k in ours["k_star"])


def figures(numbers: Numbers) -> dict[str, Any]:
    """N / k* of every CMDP, ours beside the paper's, on a logarithmic axis."""
    rows = numbers["rows"]
    figure = new_figure(5.2, 0.6 + 0.2 * len(rows))
    ax = figure.subplots()
    for y, row in enumerate(reversed(rows)):
        ends = []
        for who, mark, colour in (("published", "D", "#777777"), ("ours", "o", "#0072B2")):
            value = row[who] and row[who]["efficiency"]
            if value:
                ends.append(value)
                ax.plot(value, y, mark, color=colour, ms=5, zorder=3)
        if len(ends) == 2:
            ax.plot(ends, [y, y], color="#BBBBBB", lw=1, zorder=1)
        if row["ours"] and not row["ours"]["efficiency"]:
            ax.text(1.0, y, "not reached", fontsize=6, va="center", color="#0072B2")
    for who, mark, colour in (("here", "o", "#0072B2"), ("paper", "D", "#777777")):
        ax.plot([], [], mark, color=colour, label=who)
    ax.set_xscale("log")
    ax.set_xticks([1, 2, 5, 10, 20, 50, 100], ["1", "2", "5", "10", "20", "50", "100"])
    ax.minorticks_off()
    ax.set_yticks(range(len(rows)), [row["cmdp"] for row in reversed(rows)], fontsize=7)
    ax.set_xlabel("M / k*: times fewer trainings than one per context")
    ax.legend(loc="best")
    return {"": figure}


ITEM = Item(2, "sample-complexity", "How many trainings MBTL needs (k*)", compute, tables, figures)
