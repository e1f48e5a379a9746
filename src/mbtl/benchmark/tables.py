"""The tables of a comparison: what `mbtl bench` prints, and how a `Comparison` shows itself."""

from __future__ import annotations

import io
from collections.abc import Mapping
from typing import TYPE_CHECKING

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from mbtl.benchmark.references import NAMES

if TYPE_CHECKING:
    from mbtl.benchmark.records import (
        Comparison,
        Estimate,
        MatrixSummary,
        SelectorSummary,
        Trainings,
    )


def comparison_text(comparison: Comparison) -> str:
    """The same as text of 80 columns."""
    screen = Console(file=io.StringIO(), width=80, color_system=None, force_jupyter=False)
    show_comparison(screen, comparison)
    assert isinstance(screen.file, io.StringIO)
    return "\n".join(line.rstrip() for line in screen.file.getvalue().splitlines())


def show_comparison(screen: Console, comparison: Comparison) -> None:
    """Print one table per matrix, and the pooled one when there are several."""
    summary = comparison.summary
    for name, one in summary.matrices.items():
        seeds = f"{one.n_seeds} seed" + ("s" if one.n_seeds > 1 else "")
        table = _table(f"{name} ({seeds}), K = {summary.budget}", one.selectors, summary.budget)
        table.caption = "\n".join(captions(one))
        table.caption_justify = "left"
        screen.print(table)
    if len(summary.matrices) > 1:
        title = f"pooled over {len(summary.matrices)} matrices, K = {summary.budget}"
        screen.print(_table(title, summary.pooled, summary.budget))
    notes = [
        "[..] 95 % bootstrap interval over matrix seeds (none with one seed).",
        "k*: trainings to reach Independent; k90: 90 % of the way from the grand mean to Oracle "
        "Transfer; geometric means. > is a lower bound: some seeds did not get there within K.",
        "random policy: one policy trained on a random context, the grand mean of the matrix.",
        "closed: share of the distance from Random to the Sequential Oracle.",
    ]
    if "random" in summary.pooled:
        notes.append("random: exact expectation over all orders.")
    if "auto" in summary.pooled:
        notes.append(
            "auto: its prior has not seen the family of a matrix, where provenance names its CMDP."
        )
    screen.print("\n".join(notes), style="dim", markup=False, highlight=False)


def captions(one: MatrixSummary) -> list[str]:
    """What stands under a table of selectors: levels, and what must be said of them."""
    rows = [f"{NAMES.get(key, key)} {v:.4f}" for key, v in one.references.items()]
    levels = f"Independent {one.independent:.4f}, Oracle Transfer {one.oracle_transfer:.4f}"
    return [", ".join(rows), levels, *([] if one.caveat is None else [f"Note: {one.caveat}."])]


def _table(title: str, selectors: Mapping[str, SelectorSummary], budget: int) -> Table:
    table = Table(
        title=Text(title), box=box.SIMPLE, padding=0, show_edge=False
    )  # within 80 columns
    table.add_column("selector", no_wrap=True)
    for head in ("V_K", "mean V", "k*", "k90", "k99", "closed\nat K", "closed,\ncurve"):
        table.add_column(head, justify="right", no_wrap=True)
    for name, one in selectors.items():
        table.add_row(
            name,
            _number(one.V_K, 4) + _interval(one.V_K, 3),
            _number(one.V_mean, 4),
            *(_count(trainings, budget) for trainings in (one.k_star, one.k90, one.k99)),
            _number(one.closed_at_K, 2) + _interval(one.closed_at_K, 2),
            _number(one.closed_under_curve, 2),
        )
    return table


def _number(estimate: Estimate, digits: int) -> str:
    return "-" if estimate.value is None else f"{estimate.value:.{digits}f}"


def _interval(estimate: Estimate, digits: int) -> str:
    """On a line of its own, so that the table fits 80 columns."""
    if estimate.low is None or estimate.high is None:
        return ""
    return f"\n\\[{estimate.low:.{digits}f}, {estimate.high:.{digits}f}]"


def _count(trainings: Trainings, budget: int) -> str:
    value = trainings.estimate.value
    if value is None:
        return f">{budget}"
    return f"{'>' if trainings.censored else ''}{value:.1f}"
