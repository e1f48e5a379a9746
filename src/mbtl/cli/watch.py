"""`mbtl watch`: a study in the terminal while workers run it."""

from __future__ import annotations

import time
from typing import Annotated

import typer
from rich.console import Group
from rich.live import Live
from rich.text import Text

from mbtl.cli.common import printer
from mbtl.cli.study import any_study
from mbtl.errors import InvalidInput
from mbtl.report import summarise_study
from mbtl.report.step_text import step_lines, step_table
from mbtl.report.text import lines, table
from mbtl.study import Study
from mbtl.study.steps.study import StepStudy


def watch(
    study: Annotated[
        str, typer.Argument(metavar="STUDY", help="Folder of the study, its file, or a URL.")
    ],
    every: Annotated[float, typer.Option(help="Seconds between looks.")] = 2.0,
    name: Annotated[
        str | None, typer.Option(help="Name of the study, where its database holds several.")
    ] = None,
) -> None:
    """Show a study live while others train: picks, V, what to train next; ends with the study.

    It only reads. Where there is no terminal, the last state is printed once.

    Example: mbtl watch runs/cartpole-length-full-seed0
    """
    if every <= 0:
        raise InvalidInput(f"--every must be > 0 seconds, got {every:g}")
    opened, screen_of = any_study(study, name), printer()
    with Live(view(opened), console=screen_of, auto_refresh=False) as screen:
        while screen_of.is_terminal and not opened.is_finished:
            time.sleep(every)
            before = opened.state.seq
            if opened.refresh().seq != before:
                screen.update(view(opened), refresh=True)


def view(study: Study | StepStudy) -> Group:
    """The table and the sentences under it, as `mbtl study show` prints them."""
    if isinstance(study, StepStudy):
        paid = study.summary()
        return Group(step_table(paid, study.space), *map(Text, step_lines(paid)))
    summary = summarise_study(study)
    said = lines(summary, study.space)
    if summary.finished is None:
        spent, budget = len(study.state.picks), study.spec.budget
        said.append(f"{spent} of {budget} trainings asked for; Ctrl-C ends this view only.")
    return Group(table(summary, study.space), *map(Text, said))
