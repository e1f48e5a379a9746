"""What commands of long work share: their options, how one is repeated, and its signs of life."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Container, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from mbtl.cli.common import LongWork, console

Preset = Annotated[
    str | None,
    typer.Option("--preset", "--tier", help="Training recipe; `mbtl cmdps CMDP` lists them."),
]
Visibility = Annotated[str | None, typer.Option(help="What of the context the policy sees.")]
Engine = Annotated[
    str | None, typer.Option(help="jax, gymnasium or sumo; default: that of the CMDP.")
]
Score = Annotated[
    str | None, typer.Option(help="What an episode of traffic is worth: paper, or the CMDP's own.")
]
Timesteps = Annotated[int | None, typer.Option(help="Environment steps per training.")]
Episodes = Annotated[
    int | None, typer.Option(help="Episodes per training, where those are counted.")
]
EvalEpisodes = Annotated[int | None, typer.Option(help="Episodes per policy and context.")]
FirstSeed = Annotated[int, typer.Option(help="Seed of the first.")]
Out = Annotated[Path, typer.Option(help="Folder of the finished files.")]
Work = Annotated[Path, typer.Option(help="Folder of what is not finished.")]
Bounds = Annotated[
    str | None,
    typer.Option(
        help="LOW,HIGH: returns of performance 0 and 1 instead of a matrix's own; or `seen`: its "
        "smallest and largest."
    ),
]


def repeated(context: typer.Context, without: Container[str], **instead: Any) -> str:
    """The command line that does the same again; options at their defaults need no word.

    Args:
        context: of the running command.
        without: names of options that do not matter to it: folders, processes, seeds.
        **instead: other values for some.
    """
    names: list[str] = []
    above: Any = context
    while above.parent is not None:  # not the program's own, which depends on how it was started
        names.append(str(above.info_name))
        above = above.parent
    words = ["mbtl", *reversed(names)]
    for one in context.command.params:
        name = str(one.name)
        value = instead.get(name, context.params.get(name))
        if one.param_type_name == "argument":
            words.append(str(value))
        elif name not in without and value not in (None, one.default):
            for each in value if isinstance(value, list | tuple) else [value]:
                words += [one.opts[0], str(each)]
    return shlex.join(words)


@contextmanager
def bar(label: str, total: int | None = None) -> Iterator[Callable[[int, int | None, str], None]]:
    """A bar on a terminal and lines in a log, told (done, total, a note) in the block."""
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(bar_width=30),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console, transient=True) as shown:
        task, log = shown.add_task(label, total=total), LongWork(console)

        def tell(done: int, total: int | None, note: str) -> None:
            words = " ".join(filter(None, (label, note)))
            shown.update(task, description=words, completed=done, total=total)
            log.say(f"{words}: {done:,} of {'?' if total is None else f'{total:,}'}")

        yield tell
