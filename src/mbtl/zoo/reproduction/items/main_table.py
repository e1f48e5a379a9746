"""Item 1: the paper's two tables, V at K of every method on every CMDP, and what they add up to."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from mbtl.plot.style import new_figure
from mbtl.report.reference import REFERENCE_NAMES
from mbtl.zoo.reproduction.bench import Bench, Case
from mbtl.zoo.reproduction.item import (
    COLOURS,
    Item,
    Measured,
    Numbers,
    Table,
    absent,
    named_variant,
)
from mbtl.zoo.reproduction.paper import (
    HEADS,
    METHODS,
    TRIALS,
    Published,
    Value,
    domain_of,
    marked,
    marked_in_pairs,
    pooled,
    pooled_mean,
    probability_of_improvement,
)

DOMAINS = ("traffic", "control")
MARKS = (
    "Bold: the best of the first five columns, and those behind it by no more than the standard "
    "error of the differences, seed by seed; of the paper, whose seeds are not told, those whose "
    "standard errors overlap. Multi-task: as many steps as one other training, whose end is known, "
    "at the best of its evaluations; K units: a training that may always go on, of as many steps "
    "as K of them, or as said below; not where it has another score than the matrix."
)
"""What the tables of V mean."""


def compute(bench: Bench) -> Numbers:
    """Per CMDP ours and the paper's; averages per table; the aggregate over all runs."""
    cases = bench.cases()
    lines = [_line(id, cases.get(id), bench.paper.get(id)) for id in bench.ids]
    return {
        "budget": bench.setting.budget,
        "rows": lines,
        "averages": {domain: _averages(lines, domain) for domain in DOMAINS},
        "aggregate": _aggregate(cases),
        "marks_agree": _marks_agree(bench.paper),
        "missing": absent(bench) + [_no_rival(case) for case in cases.values() if case.own is None],
    }


def _no_rival(case: Case) -> str:
    more = named_variant(case.variant)
    return (
        f"{case.cmdp}: no policy for all contexts of the matrix's simulator and version{more}; "
        f"make it with: mbtl matrix multitask {case.cmdp}, and the matrix's --preset and --engine"
    )


def _line(id: str, case: Case | None, paper: Published | None) -> dict[str, Any]:
    line: dict[str, Any] = {"cmdp": id, "domain": domain_of(id), "ours": None, "published": None}
    if paper is not None:
        line["published"] = _plain(paper.values)
        line["paper_marked"] = sorted(paper.marked)
        line["published_marked"] = sorted(marked(paper.values, TRIALS))
    if case is not None:
        values = case.values
        line |= {
            "ours": _plain({m: values[m] for m in METHODS if m in values}),
            "marked": sorted(marked_in_pairs(case.per_seed)),
            "one_policy_units": max(case.one_policy, default=None),
            "n": case.n,
            "n_sources": case.n_sources,
            "n_seeds": case.n_seeds,
            "multitask": _plain({n: Value.of(v) for n, v in case.multitask.items()}),
            "references": _plain({n: Value.of(v) for n, v in case.references.items()}),
            "specialists": Value.of(case.curves["specialists"][:, -1]).to_json(),
            "apart": case.apart,
            "caveat": case.caveat,
        }
    return line


def _plain(values: Mapping[str, Value]) -> dict[str, dict[str, float | None]]:
    return {name: value.to_json() for name, value in values.items()}


def _averages(lines: list[dict[str, Any]], domain: str) -> dict[str, Any]:
    """Means over the CMDPs of a table: all of the paper's, and both where we have a matrix."""
    there = [x for x in lines if x["domain"] == domain]
    ours = [x for x in there if x["ours"] is not None]

    def mean(group: list[dict[str, Any]], key: str) -> dict[str, float]:
        return {
            m: float(np.mean([x[key][m]["mean"] for x in group]))
            for m in METHODS
            if group and all(x[key] is not None and m in x[key] for x in group)
        }

    return {
        "cmdps": [x["cmdp"] for x in ours],
        "ours": mean(ours, "ours"),
        "published": mean(ours, "published"),
        "published_all": mean(there, "published"),
    }


def _aggregate(cases: Mapping[str, Case]) -> dict[str, Any]:
    """Over all runs: V itself, and the share of the way from one random policy to all policies."""
    if not cases:
        return {}
    found: dict[str, Any] = {}
    every = {**{m: m for m in METHODS}, "specialists": "specialists"}
    mbtl = [case.per_seed["mbtl"] for case in cases.values()]
    for method in every:
        scores = [_scores(case, method) for case in cases.values()]
        if any(s is None for s in scores):
            continue
        there = [s for s in scores if s is not None]
        shares = [
            case.share(s) if len(s) == case.n_seeds else case.share(np.full(case.n_seeds, s.mean()))
            for case, s in zip(cases.values(), there, strict=True)
        ]
        found[method] = {
            "mean": pooled_mean(there).to_json(),
            "iqm": pooled(there).to_json(),
            "share_iqm": pooled(shares).to_json(),
            "mbtl_better": probability_of_improvement(mbtl, there),
        }
    return found


def _scores(case: Case, method: str) -> Any:
    return (
        case.curves["specialists"][:, -1] if method == "specialists" else case.per_seed.get(method)
    )


def _marks_agree(paper: Mapping[str, Published]) -> int:
    """Lines of the paper where our rule marks just what the paper marks."""
    return sum(marked(line.values, TRIALS) == line.marked for line in paper.values())


# ---- tables and figures --------------------------------------------------------------------------


def tables(numbers: Numbers) -> dict[str, Table]:
    """One table per domain, one of reference rows, one of the aggregate."""
    found = {d: _domain_table(numbers, d) for d in DOMAINS if _of(numbers, d)}
    found["references"] = _references(numbers)
    if numbers["aggregate"]:
        found["aggregate"] = _aggregate_table(numbers)
    return found


def _of(numbers: Numbers, domain: str) -> list[dict[str, Any]]:
    return [row for row in numbers["rows"] if row["domain"] == domain]


def _domain_table(numbers: Numbers, domain: str) -> Table:
    rows = []
    for line in _of(numbers, domain):
        for who, key, marks in (
            ("ours", "ours", "marked"),
            ("paper", "published", "published_marked"),
        ):
            values = line[key]
            if values is None and who == "paper":
                continue
            cells = [Measured.of((values or {}).get(m), m in line.get(marks, ())) for m in METHODS]
            rows.append((line["cmdp"] if who == "ours" else "", who, *cells))
    average = numbers["averages"][domain]
    ours, every = len(average["cmdps"]), len(_of(numbers, domain))
    for label, key in (
        (f"mean of {ours}", "ours"),
        (f"mean of these {ours}", "published"),
        (f"mean of all {every}", "published_all"),
    ):
        values = average[key]
        if values and not (key == "published" and ours == every):
            cells = [Measured(values[m]) if m in values else None for m in METHODS]
            rows.append((label, "ours" if key == "ours" else "paper", *cells))
    notes = [MARKS, *_notes(_of(numbers, domain), numbers["budget"])]
    caption = (
        f"{domain.capitalize()}: V after K = {numbers['budget']} trainings, mean (standard "
        "deviation) over seeds."
    )
    return Table(caption, ("CMDP", "", *(HEADS[m] for m in METHODS)), tuple(rows), tuple(notes))


def _notes(lines: list[dict[str, Any]], budget: int) -> list[str]:
    missing = [line["cmdp"] for line in lines if line["ours"] is None]
    older = [line["cmdp"] for line in lines if line["ours"] and not line["apart"]]
    units = {x["cmdp"]: x["one_policy_units"] for x in lines if x["ours"] is not None}
    shorter = [f"{id} {u:g}" for id, u in units.items() if u is not None and u < budget]
    notes = []
    if shorter:
        notes.append(f"One policy for all has fewer units on: {', '.join(shorter)}.")
    if missing:
        notes.append(f"No matrix yet: {', '.join(missing)}.")
    if older:
        notes.append(
            f"Selection and report used the same episodes on {', '.join(older)}, so values there "
            "are too high where episodes differ by luck."
        )
    return notes


def _references(numbers: Numbers) -> Table:
    rows = []
    for line in numbers["rows"]:
        if line["ours"] is None:
            continue
        cells = [line["references"].get(name) for name in REFERENCE_NAMES]
        cells += [line["ours"]["mbtl"], line["specialists"]]
        rows.append((line["cmdp"], *map(Measured.of, cells)))
    return Table(
        "What stands without any selection: V of reference rows, beside MBTL and `specialists` "
        f"after K = {numbers['budget']} trainings.",
        ("CMDP", *REFERENCE_NAMES.values(), "MBTL", "specialists"),
        tuple(rows),
        ("unguided: the system without a controller. nominal policy: of the nominal context.",),
    )


def _aggregate_table(numbers: Numbers) -> Table:
    def said(x: dict[str, float | None]) -> str:
        if x["low"] is None or x["high"] is None:
            return f"{x['value']:.3f}"
        return f"{x['value']:.3f} ({x['low']:.3f} to {x['high']:.3f})"

    rows = tuple(
        (
            HEADS.get(method, method),
            said(found["mean"]),
            said(found["iqm"]),
            said(found["share_iqm"]),
            "" if method == "mbtl" else f"{found['mbtl_better']:.2f}",
        )
        for method, found in numbers["aggregate"].items()
    )
    count = sum(row["ours"] is not None for row in numbers["rows"])
    return Table(
        f"All runs on {count} CMDPs together, with 95 % bootstrap intervals over seeds.",
        ("method", "mean of V", "interquartile mean of V", "interquartile mean of the share",
         "P(MBTL better)"),
        rows,
        ("share: 0 is one random policy, 1 is all N policies. P(MBTL better): chance that a run of "
         "MBTL is above a run of the method on the same CMDP and seed; 0.5 is level.",),
    )  # fmt: skip


def figures(numbers: Numbers) -> dict[str, Any]:
    """Aggregate intervals, and ours against the paper's values."""
    found = {"agreement": _agreement(numbers)}
    if numbers["aggregate"]:
        found["aggregate"] = _intervals(numbers)
    return found


def _intervals(numbers: Numbers) -> Any:
    figure = new_figure(5.2, 2.6)
    ax = figure.subplots()
    names = list(numbers["aggregate"])
    for y, name in enumerate(reversed(names)):
        one = numbers["aggregate"][name]["share_iqm"]
        colour = COLOURS.get(name, "#333333")
        if one["low"] is not None:
            ax.plot([one["low"], one["high"]], [y, y], color=colour, lw=6, alpha=0.35,
                    solid_capstyle="butt")  # fmt: skip
        ax.plot(one["value"], y, "o", color=colour, ms=5)
    ax.set_yticks(range(len(names)), [HEADS.get(n, n) for n in reversed(names)])
    ax.set_xlabel("share of the way from one random policy (0) to all N policies (1)")
    count = sum(row["ours"] is not None for row in numbers["rows"])
    ax.set_title(f"Interquartile mean over {count} CMDPs, K = {numbers['budget']}, 95 % intervals")
    return figure


def _agreement(numbers: Numbers) -> Any:
    both = [row for row in numbers["rows"] if row["ours"] and row["published"]]
    figure = new_figure(6.8, 4.4)
    grid = figure.subplots(2, 3, sharex=True, sharey=True)
    low, high = 0.0, 1.3
    for ax, method in zip(grid.ravel(), METHODS[:6], strict=True):
        ax.plot([low, high], [low, high], color="#999999", lw=0.8)
        for domain, mark, colour in (("traffic", "s", "#D55E00"), ("control", "o", "#0072B2")):
            points = [
                (row["published"][method]["mean"], row["ours"][method]["mean"])
                for row in both
                if row["domain"] == domain and method in row["ours"]
            ]
            if points:
                ax.plot(*np.array(points).T, mark, ms=4, color=colour, label=domain, alpha=0.85)
        ax.set_title(HEADS[method])
        ax.set_xlim(low, high)
        ax.set_ylim(low, high)
    if both:
        grid[0, 0].legend(loc="upper left")
    figure.supxlabel("V in the paper", fontsize=9)
    figure.supylabel("V here", fontsize=9)
    return figure


ITEM = Item(1, "main-table", "The paper's tables: every method on every CMDP", compute, tables,
            figures)  # fmt: skip
