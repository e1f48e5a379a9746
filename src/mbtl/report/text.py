"""The summary in a terminal, at most 80 columns wide."""

from __future__ import annotations

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from mbtl.contexts import ContextSpace
from mbtl.report.reference import REFERENCE_NAMES
from mbtl.report.summary import StudySummary
from mbtl.study.budget import counted

_NOTHING = 5e-5
"""What prints as 0."""


def show_summary(screen: Console, summary: StudySummary, space: ContextSpace) -> None:
    """Print the summary: the picks, V, the verdict."""
    screen.print(table(summary, space))
    for line in lines(summary, space):
        screen.print(line, markup=False, highlight=False)


def table(summary: StudySummary, space: ContextSpace) -> Table:
    """The picks, a row each."""
    budget = f"K = {summary.budget}" if summary.steps is None else f"{counted(summary.steps)} steps"
    size = f"{budget}, N = {summary.n_contexts}"
    title = f"{summary.problem or 'study'}: {summary.strategy}, {size}"
    found = Table(title=title, box=box.SIMPLE, padding=(0, 1), show_edge=False)
    for head in ("pick", "trained on", "V", "minutes"):
        found.add_column(head, justify="left" if head == "trained on" else "right", no_wrap=True)
    found.add_column("why")
    for pick in summary.picks:
        found.add_row(
            "-" if pick.number is None else str(pick.number + 1),
            Text(pick.trained_on(space, "\n")),
            _number(pick.value),
            "-" if pick.seconds is None else f"{pick.seconds / 60:.1f}",
            Text(pick.reason if pick.status in ("told", "evaluated") else pick.status),
        )
    return found


def show_causes(screen: Console, summary: StudySummary, space: ContextSpace) -> None:
    """Print where each failure came from, once for all picks that failed the same way."""
    places: dict[str, list[str]] = {}
    for pick in summary.picks:
        if pick.traceback and pick.number is not None:
            where = f"pick {pick.number + 1} ({pick.trained_on(space)})"
            places.setdefault(pick.traceback, []).append(where)
    for trace, picks in places.items():
        screen.print(f"\n{', '.join(picks)}:", markup=False, highlight=False)
        screen.print(trace.rstrip(), markup=False, highlight=False, soft_wrap=True)


def lines(summary: StudySummary, space: ContextSpace) -> list[str]:
    """The sentences under the table."""
    worst, best = summary.bounds
    first = [summary.worth_it] if summary.worth_it else []
    name, unit = summary.score
    what = f"{worst:g} {unit}".rstrip()
    out = [f"Scores are scaled: a {name} of {what} counts as 0, one of {best:g} as 1."]
    if summary.episodes is not None and summary.evaluated is not None:
        out[0] += f" {_evaluated(summary)}."
    if summary.automatic_bounds:
        out.append(
            "You gave no bounds, so the scale changes as results arrive; set bounds=(low, high)."
        )
    if summary.fresh_value is not None:
        out.append(
            f"V = {_with_margin(summary.fresh_value, summary.fresh_margin)} on {_fresh(summary)}."
        )
    elif summary.value is not None and summary.measured is not None:
        out.append(
            f"V = {_with_margin(summary.value, summary.value_margin)}, estimated from the episodes "
            f"that chose the policies{_extrapolated(summary.measured)}."
        )
    if summary.worst_tenth is not None:
        sentence = f"The worst-served tenth of the contexts is at {summary.worst_tenth:.4f}"
        if summary.worst_context is not None and summary.worst_context_value is not None:
            where = space.describe(space.context(summary.worst_context))
            sentence += f"; the worst context, {where}, at {summary.worst_context_value:.4f}"
        out.append(f"{sentence}.")
    out.append(summary.verdict)
    out += _compared(summary, space)
    out += [_same(group) for group in summary.alike]
    if summary.bill is not None and summary.steps is not None:
        parts = {
            "trainings": summary.bill["training"],
            "going on": summary.bill["extension"],
            "evaluation": summary.bill["evaluation"],
            "failed trainings": summary.bill["failed"],
            "what is under way": summary.bill["under_way"],
        }
        said = ", ".join(f"{counted(steps)} on {what}" for what, steps in parts.items() if steps)
        out.append(f"Spent: {summary.spent}{f': {said}' if said else ''}.")
    elif summary.units != len([pick for pick in summary.picks if pick.number is not None]):
        out.append(f"Spent: {summary.spent}.")
    if summary.finished:
        out.append(f"The study is finished: {summary.finished}.")
    return first + out


def _compared(summary: StudySummary, space: ContextSpace) -> list[str]:
    """V and metrics of the policies and of each baseline, a line each; and where one is ahead."""
    if not (summary.baselines or summary.metrics) or summary.fresh_value is None:
        return []
    values = {"policies": summary.fresh_value} | {b.name: b.value for b in summary.baselines}
    said = []
    for who, v in values.items():
        told = summary.metrics.get(who, {})
        rest = [
            f"{name} {mean:.4g} {summary.metric_units[name]}".rstrip()
            for name, mean in told.items()
        ]
        name = REFERENCE_NAMES.get(who, who)
        said.append(f"{name}: " + ", ".join([f"V {v:.4f}", summary.returned(v), *rest]))
    if summary.behind:
        where, who = summary.behind[0]
        said.append(
            f"A baseline did better in {len(summary.behind)} of {summary.fresh_contexts} contexts, "
            f"most at {space.describe(space.context(where))} ({REFERENCE_NAMES.get(who, who)})."
        )
    return said


def _evaluated(summary: StudySummary) -> str:
    assert summary.evaluated is not None
    assert summary.episodes is not None
    least, most = summary.evaluated
    on = "every context"
    if least < summary.n_contexts:
        on = f"{_range(summary.evaluated)} of {summary.n_contexts} contexts"
    who = "Every policy was" if least == most else "Policies were"
    one = summary.episodes == (1, 1)
    often = "one episode" if one else f"{_range(summary.episodes)} episodes"
    return f"{who} evaluated on {on} in {often}"


def _range(both: tuple[int, int]) -> str:
    return str(both[0]) if both[0] == both[1] else f"{both[0]} to {both[1]}"


def _same(group: tuple[int, ...]) -> str:
    """That policies are one and the same, as far as anybody can see."""
    names = [str(i + 1) for i in group]
    return (
        f"Policies {', '.join(names[:-1])} and {names[-1]} returned the same in every episode: "
        "these trainings came to the same behaviour, or collapsed."
    )


def _fresh(summary: StudySummary) -> str:
    count, played = summary.fresh_episodes or 0, summary.fresh_contexts or 0
    where = "per context"
    if played < summary.n_contexts:
        where = f"in each of {played} of the {summary.n_contexts} contexts"
    return f"{count} fresh episode{'s' * (count > 1)} {where}, which chose nothing"


def _with_margin(value: float, margin: float | None) -> str:
    if margin is None:
        return f"{value:.4f} (one episode each, so its error is unknown)"
    return f"{value:.4f} +- {margin:.4f}" if margin >= _NOTHING else f"{value:.4f}"


def _extrapolated(measured: float) -> str:
    if measured > 1.0 - 1e-9:
        return ""
    return f"; {measured:.0%} of it is measured, the rest predicted by the transfer model"


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.4f}"
