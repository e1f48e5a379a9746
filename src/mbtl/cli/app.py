"""The `mbtl` program: its commands, and what an error or an interrupt prints."""

from __future__ import annotations

import io
import logging
import os
import signal
import sys
from typing import Annotated

import typer

from mbtl.cli.bench import bench
from mbtl.cli.check import check
from mbtl.cli.cmdps import cmdps
from mbtl.cli.common import console, interruptible, interrupts, print_origin
from mbtl.cli.interrupts import keep_interrupts
from mbtl.cli.matrix import matrix_app
from mbtl.cli.play import play
from mbtl.cli.report import report
from mbtl.cli.reproduce import reproduce_command
from mbtl.cli.run import run
from mbtl.cli.study import study_app
from mbtl.cli.watch import watch
from mbtl.cli.worker import worker
from mbtl.errors import InvalidInput, MbtlError, TrainingFailed
from mbtl.processes import end_children
from mbtl.version import __version__

app = typer.Typer(
    help="Choose which tasks to train on: model-based transfer learning for contextual RL.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


for command in (run, worker, watch, report, play, cmdps, bench, check):
    app.command()(interruptible(command))
app.command("reproduce")(interruptible(reproduce_command))
app.add_typer(study_app, name="study")
app.add_typer(matrix_app, name="matrix")


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
    A batch system's SIGTERM is an interrupt, too, and so is the end of the terminal. None is lost.
    """
    for name in ("SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)
        if number is not None and signal.getsignal(number) is not signal.SIG_IGN:  # nohup
            signal.signal(number, signal.default_int_handler)
    keep_interrupts()
    try:
        main()
    except SystemExit as end:
        if interrupts:
            end_children()
        if interrupts and "jax" in sys.modules:
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(end.code if isinstance(end.code, int) else bool(end.code))
        raise


def main() -> None:
    """Run the program; errors cost one line, not a page.

    A letter that a console or a pipe cannot show is written as its escape.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    logging.getLogger("mbtl").addHandler(logging.NullHandler())  # callbacks show it all
    try:
        app()
    except MbtlError as error:
        if isinstance(error, TrainingFailed):  # of the user's own code, as often as not
            print_origin(error)
        console.print(f"error: {error}", style="red", markup=False, highlight=False, soft_wrap=True)
        sys.exit(2 if isinstance(error, InvalidInput) else 1)
    except BrokenPipeError:  # the reader of a pipe has had enough
        sys.stderr.close()
        sys.exit(1)
