"""The `mbtl` program: its commands, and what an error or an interrupt prints."""

from __future__ import annotations

import contextlib
import io
import logging
import os
import pkgutil
import sys
from typing import Annotated, Any, TextIO

import typer
from typer.core import TyperGroup
from typer.main import get_group

from mbtl.cli.adapt import adapt
from mbtl.cli.check import check
from mbtl.cli.common import INTERRUPTED, Grouped, console, interruptible, interrupts, print_origin
from mbtl.cli.interrupts import deafen, hear_interrupts, keep_interrupts
from mbtl.cli.report import report
from mbtl.cli.run import run
from mbtl.cli.study import study_app
from mbtl.cli.worker import worker
from mbtl.errors import InvalidInput, MbtlError, TrainingFailed, cannot_write
from mbtl.processes import end_children
from mbtl.provider import laboratory
from mbtl.version import __version__

_PLAIN: dict[str, Any] = {
    "add_completion": False,
    "pretty_exceptions_enable": False,
    "rich_markup_mode": None,
}


class Commands(TyperGroup):
    """The tool's own, and those of the laboratory, which are imported when one is asked for."""

    def list_commands(self, ctx: Any) -> list[str]:
        """All names, in the order of the help."""
        return [*super().list_commands(ctx), *laboratory().commands]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """The command of a name; None where there is none."""
        own = super().get_command(ctx, cmd_name)
        if own is not None or (home := laboratory().commands.get(cmd_name)) is None:
            return own
        found, shell = pkgutil.resolve_name(home), typer.Typer(**_PLAIN)
        shell.callback()(lambda: None)  # with it, one command is a command of a group, too
        if isinstance(found, typer.Typer):
            shell.add_typer(found, name=cmd_name)
        else:
            shell.command(cmd_name, cls=Grouped)(interruptible(found))
        return get_group(shell).commands[cmd_name]


app = typer.Typer(
    cls=Commands,
    help="Choose which tasks to train on: model-based transfer learning for contextual RL.",
    no_args_is_help=True,
    **_PLAIN,
)


for command in (run, worker, report, adapt, check):
    app.command(cls=Grouped)(interruptible(command))
app.add_typer(study_app, name="study")


def _version(wanted: bool) -> None:
    if wanted:
        print(f"mbtl {__version__}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Options of the program itself."""


def program() -> None:
    """What the installed command runs: `main`, and after an interrupt in jax an end without ado.

    XLA's threads go on computing then, and the interpreter, taken down around them, crashes.
    """
    hear_interrupts()
    keep_interrupts()
    code = 0
    try:
        main()
    except KeyboardInterrupt:  # before a command had begun
        console.print("interrupted")
        code = INTERRUPTED
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else int(end.code is not None)
    deafen()
    if interrupts:
        end_children()
    for stream in (sys.stdout, sys.stderr):
        _settle(stream)
    if interrupts and "jax" in sys.modules:
        os._exit(code)
    sys.exit(code)


def _settle(stream: TextIO | None) -> None:
    """What can be written is; what cannot be must not be tried, and shown, at the very end."""
    if stream is None:
        return
    try:
        stream.flush()
    except (OSError, ValueError):
        with contextlib.suppress(OSError, ValueError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def main() -> None:
    """Run the program; errors cost one line, not a page.

    A letter that a console or a pipe cannot show is written as its escape.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    logging.getLogger("mbtl").addHandler(logging.NullHandler())  # callbacks show it all
    try:
        try:
            app()
        finally:
            if sys.stdout is not None:
                sys.stdout.flush()
    except MbtlError as error:
        if isinstance(error, TrainingFailed):  # of the user's own code, as often as not
            print_origin(error)
        console.say(f"error: {error}", "red")
        sys.exit(2 if isinstance(error, InvalidInput) else 1)
    except BrokenPipeError:  # the reader of a pipe has had enough
        sys.exit(1)
    except OSError as error:
        if error.filename is not None:
            raise
        console.print(f"error: {cannot_write('standard output', error)}", style="red")
        sys.exit(1)
