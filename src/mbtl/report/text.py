"""The summary in a terminal, at most 80 columns wide."""

from __future__ import annotations

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from mbtl.contexts import ContextSpace
from mbtl.report.next_training import NOTHING
from mbtl.report.summary import StudySummary


def show_summary(screen: Console, summary: StudySummary, space: ContextSpace) -> None:
    """Print the summary: the picks, V, the verdict, what one more pick would bring."""
    screen.print(table(summary, space))
    for line in lines(summary, space):
        screen.print(line, markup=False, highlight=False)


def table(summary: StudySummary, space: ContextSpace) -> Table:
    """The picks, a row each."""
    size = f"K = {summary.budget}, N = {summary.n_contexts}"
    title = f"{summary.problem or 'study'}: {summary.selector}, {size}"
    found = Table(title=title, box=box.SIMPLE, padding=(0, 1), show_edge=False)
    for head in ("pick", "trained on", "V", "V fresh", "min"):
        found.add_column(head, justify="left" if head == "trained on" else "right", no_wrap=True)
    found.add_column("why")
    for pick in summary.picks:
        found.add_row(
            "-" if pick.number is None else str(pick.number + 1),
            Text(space.describe(pick.context, "\n")),
            _number(pick.value),
            _number(pick.fresh_value),
            "-" if pick.seconds is None else f"{pick.seconds / 60:.1f}",
            Text(pick.reason if pick.status == "told" else pick.status),
        )
    return found


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
    out = [f"Scores are scaled: a return of {worst:g} counts as 0, one of {best:g} as 1."]
    if summary.episodes:
        out[0] += f" Every context was evaluated in {_episodes(summary.episodes)}."
    if summary.automatic_bounds:
        out.append(
            "You gave no bounds, so the scale changes as results arrive; set bounds=(low, high)."
        )
    if summary.fresh_value is not None:
        out.append(
            f"V = {_with_margin(summary.fresh_value, summary.fresh_margin)} on {_fresh(summary)}."
        )
    if summary.value is not None and summary.measured is not None:
        out.append(
            f"V = {_with_margin(summary.value, summary.value_margin)} on the episodes that chose "
            f"the policies{_extrapolated(summary.measured)}."
        )
    if summary.worst_tenth is not None:
        by = "those that chose" if summary.fresh_value is None else "the fresh ones"
        sentence = (
            f"The worst-served tenth of the contexts is at {summary.worst_tenth:.4f}, on {by}"
        )
        if summary.worst_context is not None and summary.worst_context_value is not None:
            where = space.describe(space.context(summary.worst_context))
            sentence += f"; the worst context, {where}, at {summary.worst_context_value:.4f}"
        out.append(f"{sentence}.")
    out.append(summary.verdict)
    if summary.next_source is not None and summary.next_gain is not None:
        where = space.describe(space.context(summary.next_source))
        out.append(
            f"One more training, at {where}, is predicted to add {summary.next_gain:.4f} to V."
            if summary.next_gain > NOTHING
            else "One more training is predicted to add nothing to V."
        )
    if summary.finished:
        out.append(f"The study is finished: {summary.finished}.")
    return out


def _episodes(count: int) -> str:
    return "one episode" if count == 1 else f"{count} episodes"


def _fresh(summary: StudySummary) -> str:
    if summary.fresh_episodes is None:
        return "fresh episodes, which chose nothing"
    count = summary.fresh_episodes
    return f"{count} fresh episode{'s' * (count > 1)} per context, which chose nothing"


def _with_margin(value: float, margin: float | None) -> str:
    if margin is None:
        return f"{value:.4f} (one episode each, so its error is unknown)"
    return f"{value:.4f} +- {margin:.4f}" if margin >= NOTHING else f"{value:.4f}"


def _extrapolated(measured: float) -> str:
    if measured > 1.0 - 1e-9:
        return ""
    return f"; {measured:.0%} of it is measured, the rest predicted by the transfer model"


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.4f}"
