"""What every command shares: output on the right stream, errors in one line, exit codes.

With `--json` standard output carries exactly one JSON document; everything else goes to standard
error.
"""

from __future__ import annotations

import json
import os
import shutil
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext, redirect_stdout
from functools import wraps
from pathlib import Path
from typing import IO, Annotated, Any, TextIO, cast

import typer
from rich.console import Console, ConsoleOptions
from rich.segment import Segment
from typer.core import TyperCommand

from mbtl.arrays import plain
from mbtl.errors import Notice, cannot_write
from mbtl.faults import harmless, traceback_of, writable
from mbtl.files import from_home


class _Stream:
    """A standard stream that takes any text.

    Args:
        stream: as it is at the moment of writing.
        is_forgiving: what cannot be written is forgotten; else it is an error.
    """

    def __init__(self, stream: TextIO, *, is_forgiving: bool) -> None:
        self._stream, self._is_forgiving = stream, is_forgiving

    def write(self, text: str) -> int:
        with self._trouble():
            self._stream.write(writable(text, self._stream))
        return len(text)

    def flush(self) -> None:
        with self._trouble():
            self._stream.flush()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    @contextmanager
    def _trouble(self) -> Iterator[None]:
        try:
            yield
        except BrokenPipeError:
            if not self._is_forgiving:
                raise
        except OSError as error:
            if not self._is_forgiving:
                raise cannot_write("standard output", error) from error


class Screen(Console):
    """A console for texts of whatever origin, of whatever width and on whatever stream.

    What is for standard error is never worth the work itself.
    """

    def __init__(self, *, stderr: bool = False) -> None:
        super().__init__(stderr=stderr)
        if self.width < 1:  # COLUMNS=0
            self.width = max(shutil.get_terminal_size().columns, 1)

    @property
    def file(self) -> IO[str]:
        """The stream of this moment: a live display puts its own there."""
        return cast(IO[str], _Stream(cast(TextIO, super().file), is_forgiving=self.stderr))

    @file.setter
    def file(self, new: IO[str]) -> None:
        self._file = new

    def render(self, renderable: Any, options: ConsoleOptions | None = None) -> Iterator[Segment]:
        """All that is printed comes by here: escape sequences are rich's own, or are shown."""
        for segment in super().render(renderable, options):
            yield segment if segment.control else segment._replace(text=harmless(segment.text))

    def say(self, text: str, style: str | None = None) -> None:
        """Print a text as it is, however long its lines."""
        self.print(text, style=style, markup=False, highlight=False, soft_wrap=True)

    def on_broken_pipe(self) -> None:
        """The reader of a pipe has had enough: `main` ends quietly."""
        raise


console = Screen(stderr=True)
"""Progress, notes and errors."""

SILENCE = 60.0
"""Seconds after which a log, where there is no terminal, is told that long work goes on."""


def option(panel: str | None, help: str, *names: str, metavar: str | None = None) -> Any:
    """An option under a heading of the help; `names` where its own is not that of its argument."""
    return typer.Option(*names, help=help, rich_help_panel=panel, metavar=metavar)


JsonFlag = Annotated[
    bool, typer.Option("--json", help="Print one JSON document on standard output.")
]


class Grouped(TyperCommand):
    """A command whose plain help shows options without a panel first, then each panel."""

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write a section per `rich_help_panel`."""
        groups: dict[str, list[tuple[str, str]]] = {"Arguments": [], "Options": []}
        for one in self.get_params(ctx):
            if (record := one.get_help_record(ctx)) is not None:
                panel = getattr(one, "rich_help_panel", None) or "Options"
                panel = "Arguments" if one.param_type_name == "argument" else panel
                groups.setdefault(panel, []).append(record)
        for name, records in groups.items():
            if records:
                with formatter.section(name):
                    formatter.write_dl(records, col_max=32)


INTERRUPTED = 130
"""Exit code after an interrupt."""
interrupts: list[str] = []
"""Commands of this process that were interrupted."""


def interruptible(command: Callable[..., None]) -> Callable[..., None]:
    """Say how to go on, and exit with 130; the command-line library would print nothing."""

    @wraps(command)
    def wrapped(*args: Any, **kwargs: Any) -> None:
        for name, given in kwargs.items():  # `--study=~/x` is no affair of most shells
            if isinstance(given, Path):
                kwargs[name] = from_home(given)
        try:
            with plain_warnings(), json_alone() if kwargs.get("as_json") else nullcontext():
                command(*args, **kwargs)
        except KeyboardInterrupt:
            console.print("interrupted: run the same command again to go on")
            interrupts.append(command.__name__)
            raise typer.Exit(INTERRUPTED) from None

    return wrapped


_documents: list[TextIO] = []
"""Where JSON documents go while `json_alone` holds standard output."""


@contextmanager
def json_alone() -> Iterator[None]:
    """In the block, what simulators and libraries print goes to standard error.

    So it does below Python, where SUMO writes, and in the processes that are started meanwhile.
    """
    usual = sys.stdout
    usual.flush()
    try:
        number = usual.fileno()
        kept = os.dup(number)
    except (OSError, ValueError):  # no file, as in tests and notebooks
        number, kept = -1, -1
    document = usual if kept < 0 else open(kept, "w", encoding=usual.encoding)  # noqa: SIM115
    _documents.append(document)
    try:
        if kept >= 0:
            os.dup2(sys.stderr.fileno(), number)
        with redirect_stdout(sys.stderr):
            yield
    finally:
        _documents.remove(document)
        if kept >= 0:
            os.dup2(kept, number)
            document.close()


@contextmanager
def plain_warnings() -> Iterator[None]:
    """In the block, what a user should know at once is a line and not a place in our code.

    Others are shown as ever, by the console, since their texts may be of anybody.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("always", Notice)

        def show(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> None:
            if issubclass(category, Notice):
                console.say(f"warning: {message}", "yellow")
            else:
                said = warnings.formatwarning(message, category, *where[:2])
                console.print(said, markup=False, highlight=False, soft_wrap=True, end="")

        warnings.showwarning = show
        yield


def print_origin(error: BaseException) -> None:
    """Print the traceback of what an error was raised from, if it was."""
    cause = error.__cause__
    lines = getattr(error, "__notes__", [])  # of another process
    if cause is not None:
        lines = [traceback_of(cause)]
    if lines:
        console.say("".join(lines).rstrip(), "dim")


class LongWork:
    """Tells a log, where there is no terminal with bars, now and then that long work goes on."""

    def __init__(self, to: Console) -> None:
        self._console, self._spoke = to, time.monotonic()

    def say(self, line: str) -> None:
        """Print the line if nothing was said for `SILENCE`."""
        if self._console.is_terminal or time.monotonic() - self._spoke <= SILENCE:
            return
        self._spoke = time.monotonic()
        self._console.print(line, markup=False, highlight=False, soft_wrap=True)


def printer() -> Screen:
    """Console for the human-readable result on standard output."""
    return Screen()


def print_json(document: Any) -> None:
    """Write one JSON document to standard output; NaN and infinity become null."""
    to = _documents[-1] if _documents else Screen().file
    to.write(json.dumps(plain(document), indent=2, allow_nan=False) + "\n")
    to.flush()
