"""A study that is paid in steps in a terminal: its trainings, the bill, V."""

from __future__ import annotations

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from mbtl.contexts import ContextSpace
from mbtl.study.steps.summary import StepSummary, counted

PAID_FOR = {
    "training": "new trainings",
    "extension": "trainings that went on",
    "checks": "checks of trainings on their own context",
    "evaluation": "evaluation on targets",
    "failed": "trainings that failed",
}
"""What steps are paid for, in words."""


def show_steps(screen: Console, summary: StepSummary, space: ContextSpace) -> None:
    """Print the trainings, the price list and V."""
    screen.print(step_table(summary, space))
    for line in step_lines(summary):
        screen.print(line, markup=False, highlight=False, soft_wrap=True)


def step_table(summary: StepSummary, space: ContextSpace) -> Table:
    """Every training: on what, how long, where it serves, and why it stands."""
    table = Table(box=box.SIMPLE, padding=(0, 1), show_edge=False)
    table.title = (
        f"{summary.problem or 'study'}: {summary.strategy}, {counted(summary.budget)} steps, "
        f"N = {space.n}"
    )
    for head in ("training", "trained on", "steps", "policies", "serves"):
        table.add_column(head, justify="left" if head == "trained on" else "right", no_wrap=True)
    table.add_column("state")
    for one in summary.trainings:
        where = Text(one.trained_on.replace(", ", "\n"))
        state = Text(f"{one.state}: {one.why}")
        numbers = counted(one.steps), str(one.policies), str(one.serves)
        table.add_row(str(one.number + 1), where, *numbers, state)
    return table


def step_lines(summary: StepSummary) -> list[str]:
    """The sentences under the table: the bill, then what was found."""
    total = max(summary.spent, 1.0)
    bill = [
        f"  {counted(steps):>6}  {steps / total:4.0%}  {PAID_FOR[name]}"
        for name, steps in summary.prices.items()
        if steps
    ]
    head = f"{counted(summary.spent)} of {counted(summary.budget)} steps were paid, all in:"
    return [head, *bill, *found_lines(summary)]


def found_lines(summary: StepSummary) -> list[str]:
    """V, what the strategy found out, and why the study ended."""
    found = []
    if summary.value is not None:
        found.append(
            f"V = {summary.value:.4f} with {summary.policies} policies, by the episodes that chose "
            "them, so it is optimistic"
        )
    if summary.fresh_value is not None and summary.fresh_steps is not None:
        margin = "" if summary.fresh_margin is None else f" +- {summary.fresh_margin:.4f}"
        found.append(
            f"V = {summary.fresh_value:.4f}{margin} on fresh episodes ("
            f"{counted(summary.fresh_steps)} steps, not charged)"
        )
    if summary.verdict is not None and summary.verdict != summary.finished:
        found.append(summary.verdict)
    return [*found, f"finished: {summary.finished}" if summary.finished else "not finished"]
