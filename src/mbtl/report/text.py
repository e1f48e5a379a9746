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
_ENOUGH = 0.3
"""Share of V measured below which a V of the worst contexts is too high: with a sixth of sixty
contexts a third of the intervals held, with a third of them all."""


def show_summary(screen: Console, summary: StudySummary, space: ContextSpace) -> None:
    """Print the summary: the picks, V, the verdict."""
    screen.print(table(summary, space))
    for line in lines(summary, space):
        screen.print(line, markup=False, highlight=False)


def table(summary: StudySummary, space: ContextSpace) -> Table:
    """The picks, a row each; with the numbers of their policies, where those are others."""
    size = f"{summary.size}, N = {summary.n_contexts}"
    title = f"{summary.problem or 'study'}: {summary.strategy}, {size}"
    found = Table(title=title, box=box.SIMPLE, padding=(0, 1), show_edge=False)
    # sentences speak of policies, which are counted in the order in which they were told
    apart = any(pick.place not in (None, pick.number) for pick in summary.picks)
    longest = max((pick.seconds or 0.0 for pick in summary.picks), default=0.0)
    time, unit = ("minutes", 60.0) if longest >= 60.0 else ("seconds", 1.0)
    for head in ("pick", *["policy"] * apart, "trained on", "V", time):
        found.add_column(head, justify="left" if head == "trained on" else "right", no_wrap=True)
    found.add_column("why")
    for pick in summary.picks:
        found.add_row(
            "-" if pick.number is None else str(pick.number + 1),
            *["-" if pick.place is None else str(pick.place + 1)] * apart,
            Text(pick.trained_on(space, "\n")),
            _number(pick.value),
            "-" if pick.seconds is None else f"{pick.seconds / unit:.1f}",
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
    concluded = conclusions(summary, space)
    first = int(bool(summary.worth_it))
    known = [*scale(summary), *estimate(summary)]
    return [*concluded[:first], *known, *concluded[first:], *beside(summary), *paid(summary)]


def conclusions(summary: StudySummary, space: ContextSpace) -> list[str]:
    """Whether training was worth it, whether one policy would do, and where little is reached."""
    out = [summary.worth_it] if summary.worth_it else []
    out.append(summary.verdict)
    if summary.worst_tenth is not None:
        assert summary.worst_context is not None
        where = space.describe(space.context(summary.worst_context))
        tenth, worst = f"{summary.worst_tenth:.4f}", f"{summary.worst_context_value:.4f}"
        if summary.risk < 1.0:  # V is of the worst ones, whichever they are
            out.append(f"Served worst, as far as is known: {where}, at {worst}.")
        elif summary.fresh_value is not None:  # by luck some others may be below
            out.append(
                f"Of the contexts{_played(summary)}, the tenth that seemed worst before the fresh "
                f"episodes is at {tenth}; {where}, which seemed worst of all, is at {worst}."
            )
        else:
            out.append(
                f"The worst-served tenth of the contexts{_played(summary)} is at {tenth}; the "
                f"worst context, {where}, at {worst}."
            )
    if summary.behind:
        place, who = summary.behind[0]
        out.append(
            f"A baseline did better in {len(summary.behind)} of {summary.fresh_contexts} contexts, "
            f"most at {space.describe(space.context(place))} ({REFERENCE_NAMES.get(who, who)})."
        )
    return out + [_same(group) for group in summary.alike]


def scale(summary: StudySummary) -> list[str]:
    """What performance 0 and 1 are, and how much was played."""
    worst, best = summary.bounds
    name, unit = summary.score
    what = f"{worst:.4g} {unit}".rstrip()
    said = f"Scores are scaled: {name} {what} counts as 0, {best:.4g} as 1."
    if summary.episodes is not None and summary.evaluated is not None:
        said += f" {_evaluated(summary)}."
    bounds = "You gave no bounds, so the scale changes as results arrive; set bounds=(low, high)."
    return [said, bounds] if summary.automatic_bounds else [said]


def estimate(summary: StudySummary) -> list[str]:
    """V, and by which episodes."""
    if summary.fresh_value is not None:
        v = _with_margin(summary.fresh_value, summary.fresh_margin)
        return [f"V = {v} on {fresh_episodes(summary)}."]
    if summary.value is None or summary.measured is None:
        return []
    v = _with_margin(summary.value, summary.value_margin)
    how = f"estimated from the episodes that chose the policies{_extrapolated(summary.measured)}"
    if summary.risk < 1.0:
        how = f"the mean over {summary.over}, {how}"
        if summary.measured < _ENOUGH:
            how += "; the worst may be far worse than predicted: evaluate on more targets"
    return [f"V = {v}, {how}."]


def beside(summary: StudySummary) -> list[str]:
    """V and metrics of the policies and of each baseline, a line each."""
    if not (summary.baselines or summary.metrics) or summary.fresh_value is None:
        return []
    said = []
    for who, v in _values(summary).items():
        told = [f"V {v:.4f}", summary.returned(v)]
        rest = [
            f"{name} {mean:.4g} {summary.metric_units[name]}".rstrip()
            for name, mean in summary.metrics.get(who, {}).items()
        ]
        if rest and _played(summary):  # V and the score are of all contexts
            rest[0] = f"mean of the {summary.fresh_contexts} contexts played: {rest[0]}"
        name = REFERENCE_NAMES.get(who, who)
        said.append(f"{name}: " + ", ".join([*told, *rest]))
    return said


def beside_table(summary: StudySummary) -> list[list[str]]:
    """The same as cells, the heads first; empty where there is nothing to compare with."""
    if not summary.baselines or summary.fresh_value is None:
        return []
    names = list(dict.fromkeys(name for told in summary.metrics.values() for name in told))
    heads = [summary.score, *((name, summary.metric_units[name]) for name in names)]
    first, *others = (f"{name} [{unit}]" if unit else name for name, unit in heads)
    where = f", {summary.fresh_contexts} contexts" * bool(_played(summary))
    rows = [["", "V", first, *(head + where for head in others)]]
    for who, v in _values(summary).items():
        own = summary.metrics.get(who, {})
        told = [f"{own[name]:.4g}" if name in own else "–" for name in names]
        score = f"{summary.score_of(v):.4g}"
        rows.append([REFERENCE_NAMES.get(who, who), f"{v:.4f}", score, *told])
    return rows


def _played(summary: StudySummary) -> str:
    """What is to be said of contexts where not all of them were."""
    if summary.fresh_value is not None:
        return " played" * (summary.fresh_contexts != summary.n_contexts)
    return " played" * ((summary.measured or 0.0) < 1.0 - 1e-9)


def _values(summary: StudySummary) -> dict[str, float]:
    assert summary.fresh_value is not None
    return {"policies": summary.fresh_value} | {one.name: one.value for one in summary.baselines}


def paid(summary: StudySummary) -> list[str]:
    """What was spent, and why it ended."""
    out, picks = [], summary.picks
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
    elif summary.cost is not None or summary.units != sum(p.number is not None for p in picks):
        out.append(f"Spent: {summary.spent}.")
    if summary.finished:
        out.append(f"The study is finished: {summary.finished}.")
    return out


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


def fresh_episodes(summary: StudySummary) -> str:
    """How many there were."""
    count, played = summary.fresh_episodes or 0, summary.fresh_contexts or 0
    where = "per context"
    if played < summary.n_contexts:
        where = f"in each of {played} of the {summary.n_contexts} contexts"
        where += f" ({summary.fresh_lost} more gave none)" * bool(summary.fresh_lost)
    often = _range((summary.fresh_fewest or count, count))
    lost = "; contexts that gave none count as estimated" * bool(summary.fresh_lost)
    return f"{often} fresh episode{'s' * (count > 1)} {where}, which chose nothing{lost}"


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
