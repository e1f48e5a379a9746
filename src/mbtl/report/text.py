"""The summary in a terminal, at most 80 columns wide."""

from __future__ import annotations

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from mbtl.contexts import ContextSpace
from mbtl.report.summary import StudySummary

_NOTHING = 5e-5
"""A gain that prints as 0."""


def show_summary(screen: Console, summary: StudySummary, space: ContextSpace) -> None:
    """Print the summary: the picks, V, the verdict, what one more pick would bring."""
    size = f"K = {summary.budget}, N = {summary.n_contexts}"
    title = f"{summary.problem or 'study'}: {summary.selector}, {size}"
    table = Table(title=title, box=box.SIMPLE, padding=(0, 1), show_edge=False)
    for head in ("pick", "trained on", "V", "V fresh", "minutes"):
        table.add_column(head, justify="left" if head == "trained on" else "right", no_wrap=True)
    table.add_column("why")
    for pick in summary.picks:
        table.add_row(
            "-" if pick.number is None else str(pick.number + 1),
            Text(space.describe(pick.context, "\n")),
            _number(pick.value),
            _number(pick.fresh_value),
            "-" if pick.seconds is None else f"{pick.seconds / 60:.1f}",
            Text(pick.reason if pick.status == "told" else pick.status),
        )
    screen.print(table)
    for line in lines(summary, space):
        screen.print(line, markup=False, highlight=False)


def show_causes(screen: Console, summary: StudySummary, space: ContextSpace) -> None:
    """Print where each failure came from, once for all picks that failed the same way."""
    places: dict[str, list[str]] = {}
    for pick in summary.picks:
        if pick.traceback and pick.number is not None:
            where = f"pick {pick.number + 1} ({space.describe(pick.context)})"
            places.setdefault(pick.traceback, []).append(where)
    for trace, picks in places.items():
        screen.print(f"\n{', '.join(picks)}:", markup=False, highlight=False)
        screen.print(trace.rstrip(), markup=False, highlight=False, soft_wrap=True)


def lines(summary: StudySummary, space: ContextSpace) -> list[str]:
    """The sentences under the table."""
    worst, best = summary.bounds
    out = [
        f"Performance 0 and 1 are returns of {worst:g} and {best:g}; {summary.episodes} episodes a "
        "target."
    ]
    if summary.automatic_bounds:
        out.append(
            "Those are the extremes of the returns told so far, so V moves with them and may leave "
            "0..1 on fresh episodes; give the problem bounds for a fixed scale."
        )
    if summary.fresh_value is not None:
        out.append(
            f"V = {summary.fresh_value:.4f} on fresh episodes "
            f"(selecting episodes: {summary.value:.4f})."
        )
    elif summary.value is not None:
        out.append(
            f"V = {summary.value:.4f} on the selecting episodes, which flatters; "
            "no fresh ones were run."
        )
    if summary.worst_tenth is not None:
        out.append(f"The tenth of the contexts served worst: {summary.worst_tenth:.4f}.")
    out.append(summary.verdict)
    if summary.next_source is not None and summary.next_gain is not None:
        where = space.describe(space.context(summary.next_source))
        out.append(
            f"One more training, at {where}, is predicted to add {summary.next_gain:.4f} to V."
            if summary.next_gain > _NOTHING
            else "One more training is predicted to add nothing to V."
        )
    if summary.finished:
        out.append(f"The study is finished: {summary.finished}.")
    return out


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.4f}"
