"""The tables of a comparison: what `mbtl bench` prints, and how a `Comparison` shows itself."""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from mbtl.report.reference import REFERENCE_NAMES

if TYPE_CHECKING:
    from mbtl.zoo.benchmark.comparison import (
        Comparison,
        Difference,
        Estimate,
        Lead,
        MatrixSummary,
        SelectorSummary,
        Trainings,
    )


WIDE = 90
"""Columns of a terminal from which all numbers are shown."""
_WIDE_ONLY = ("mean V", "k95")


def comparison_text(comparison: Comparison) -> str:
    """The same as text, with all numbers."""
    return _text(lambda screen: show_comparison(screen, comparison))


def difference_text(difference: Difference) -> str:
    """A difference as text: a line per matrix, and the means."""
    rows = dict(difference.matrices)
    if len(rows) > 1:
        rows["pooled, over their seeds"] = difference.pooled
        rows["pooled, over matrices"] = difference.over_matrices
    title = f"{difference.selector} less {difference.against}, on the same seeds"
    return _text(lambda screen: screen.print(_lead_table(title, "matrix", rows)))


def _text(show: Callable[[Console], None]) -> str:
    screen = Console(file=io.StringIO(), width=WIDE, color_system=None, force_jupyter=False)
    show(screen)
    assert isinstance(screen.file, io.StringIO)
    return "\n".join(line.rstrip() for line in screen.file.getvalue().splitlines())


def show_comparison(screen: Console, comparison: Comparison, against: str | None = None) -> None:
    """Print one table per matrix, and the pooled one when there are several.

    Args:
        screen: to print on; below `WIDE` columns some are left out.
        comparison: what to show.
        against: selector whose differences to all others are shown, too.
    """
    summary, wide = comparison.summary, screen.width >= WIDE
    others = [name for name in summary.pooled if name != against]
    leads = [comparison.difference(name, against) for name in others] if against else []
    for name, one in summary.matrices.items():
        seeds = f"{one.n_seeds} seed" + ("s" if one.n_seeds > 1 else "")
        title = f"{name} ({seeds}), K = {summary.budget}"
        table = _table(title, one.selectors, summary.budget, wide)
        table.caption = "\n".join(captions(one))
        table.caption_justify = "left"
        screen.print(table)
        if leads:
            rows = {lead.selector: lead.matrices[name] for lead in leads}
            title = f"less {against}, on the same seeds"
            screen.print(_lead_table(title, "selector", rows, wide))
    if len(summary.matrices) > 1:
        title = f"pooled over {len(summary.matrices)} matrices, K = {summary.budget}"
        screen.print(_table(title, summary.pooled, summary.budget, wide))
        if leads:
            known = all(lead.over_matrices.V_mean.low is not None for lead in leads)
            rows = {lead.selector: lead.over_matrices if known else lead.pooled for lead in leads}
            over = "matrices" if known else "their seeds"
            title = f"pooled: less {against}, intervals over {over}"
            screen.print(_lead_table(title, "selector", rows, wide))
    notes = [
        "[..] 95 % bootstrap interval over matrix seeds (none with one seed).",
        "k*: trainings to reach Independent; k90: 90 % of the way from the grand mean to Oracle "
        "Transfer; geometric means over seeds.",
        f"> is a lower bound: a seed that did not get there within K = {summary.budget} counts as "
        f"{summary.budget + 1}, so >{summary.budget + 0.7:.1f} can stand there; a larger --budget "
        "says more.",
        "random policy: one policy trained on a random context, the grand mean of the matrix.",
        "closed: share of the distance from Random to the Sequential Oracle.",
    ]
    if not wide:
        notes.append(f"A terminal of {WIDE} columns also shows mean V and k95.")
    if leads:
        notes.append(
            "less ...: paired differences, > 0 is better; where the interval holds 0, it may be "
            "chance. ahead: matrix seeds with a higher mean V."
        )
    if "random" in summary.pooled:
        notes.append("random: exact expectation over all orders.")
    if "specialists" in summary.pooled:
        notes.append(
            "specialists: its prior has not seen the family of a matrix, where provenance names it."
        )
    screen.print("\n".join(notes), style="dim", markup=False, highlight=False)


def captions(one: MatrixSummary) -> list[str]:
    """What stands under a table of selectors: levels, and what must be said of them."""
    rows = [f"{REFERENCE_NAMES.get(key, key)} {v:.4f}" for key, v in one.references.items()]
    levels = f"Independent {one.independent:.4f}, Oracle Transfer {one.oracle_transfer:.4f}"
    return [", ".join(rows), levels, *([] if one.caveat is None else [f"Note: {one.caveat}."])]


def _table(title: str, selectors: Mapping[str, SelectorSummary], budget: int, wide: bool) -> Table:
    heads = ("V_K", "mean V", "k*", "k90", "k95", "k99", "closed\nat K", "closed,\ncurve")
    table = _empty(title, "selector", [head for head in heads if wide or head not in _WIDE_ONLY])
    for name, one in selectors.items():
        cells = {
            "V_K": _number(one.V_K, 4) + _interval(one.V_K, 3),
            "mean V": _number(one.V_mean, 4),
            "k*": _count(one.k_star, budget),
            "k90": _count(one.k90, budget),
            "k95": _count(one.k95, budget),
            "k99": _count(one.k99, budget),
            "closed at K": _number(one.closed_at_K, 2) + _interval(one.closed_at_K, 2),
            "curve": _number(one.closed_under_curve, 2) + _interval(one.closed_under_curve, 2),
        }
        table.add_row(
            name, *(cell for head, cell in cells.items() if wide or head not in _WIDE_ONLY)
        )
    return table


def _lead_table(title: str, first: str, rows: Mapping[str, Lead], wide: bool = True) -> Table:
    heads = ("V_K", "mean V", "closed\nat K", "closed,\ncurve", "ahead")
    table = _empty(title, first, heads if wide else heads[2:])
    for name, lead in rows.items():
        cells = [
            *(_signed(one, 4) for one in (lead.V_K, lead.V_mean)),
            *(_signed(one, 2) for one in (lead.closed_at_K, lead.closed_under_curve)),
            f"{lead.ahead} of {len(lead.per_seed)}",
        ]
        table.add_row(Text(name), *(cells if wide else cells[2:]))
    return table


def _empty(title: str, first: str, heads: Sequence[str]) -> Table:
    table = Table(title=Text(title), box=box.SIMPLE, padding=0, show_edge=False)
    table.add_column(first, no_wrap=True)
    for head in heads:
        table.add_column(head, justify="right", no_wrap=True)
    return table


def _signed(estimate: Estimate, digits: int) -> str:
    if estimate.value is None:
        return "-"
    return f"{estimate.value:+.{digits}f}" + _interval(estimate, min(digits, 3), "+")


def _number(estimate: Estimate, digits: int) -> str:
    return "-" if estimate.value is None else f"{estimate.value:.{digits}f}"


def _interval(estimate: Estimate, digits: int, sign: str = "") -> str:
    """On a line of its own, so that the table fits 80 columns."""
    if estimate.low is None or estimate.high is None or estimate.low == estimate.high:
        return ""
    low, high = (f"{end:{sign}.{digits}f}" for end in (estimate.low, estimate.high))
    return f"\n\\[{low}, {high}]"


def _count(trainings: Trainings, budget: int) -> str:
    value = trainings.estimate.value
    if value is None:
        return f">{budget}"
    return f"{'>' if trainings.censored else ''}{value:.1f}"
