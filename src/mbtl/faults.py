"""Faults of other people's code: what counts as one, and how its words are shown.

A text of somebody else (the message of an error, a name, a level) may hold anything. `harmless` is
what it passes through before people see it.
"""

from __future__ import annotations

import contextlib
import re
import traceback
from typing import TextIO

from mbtl.errors import TrainingFailed

FAULTS = (Exception, SystemExit)
"""What other people's code raises where it fails: `sys.exit` there must not end our program."""

REASON = 500
"""Characters of a reason that are kept."""
_TRACEBACK = 8000
"""Characters of a traceback that are kept: its end, which says what happened."""

_HARMFUL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069\ud800-\udfff]")
"""What moves a cursor, colours, rings, turns the direction of writing, or is half a character."""


class TookTooLong(TrainingFailed):
    """A training or an evaluation was ended at its time limit."""


def harmless(text: str, most: int | None = None) -> str:
    r"""A text of others as it may be printed: `\x1b[31m` is shown and does not colour anything.

    Args:
        text: of any origin; new lines and tabs stay.
        most: characters that are kept of it, and dots; None: all.
    """
    cut = text if most is None or len(text) <= most else f"{text[: most - 3]}..."
    return _HARMFUL.sub(lambda found: ascii(found[0])[1:-1], cut)


def say(line: str, to: TextIO | None) -> None:
    """Print a line of progress, which is not worth the work that it is about.

    A closed pipe or a full disk takes no line.
    """
    if to is None:  # a process may have no standard error
        return
    with contextlib.suppress(OSError, ValueError):  # of a closed file
        print(writable(harmless(line), to), file=to, flush=True)


def writable(text: str, to: TextIO) -> str:
    """A text in the letters that a file or terminal knows."""
    known = getattr(to, "encoding", None) or "utf-8"
    return text.encode(known, "backslashreplace").decode(known)


def reason_of(error: BaseException) -> str:
    """A fault in words, of which a log keeps no more than `REASON` characters.

    An exit is said to be one, since `SystemExit: 0` looks as if all were well.
    """
    if isinstance(error, SystemExit):
        return harmless(
            f"sys.exit({error.code!r}) was called, where it must return or raise", REASON
        )
    return harmless(f"{type(error).__name__}: {error}", REASON)


def traceback_of(error: BaseException) -> str:
    """As Python prints it, without our own frame at its beginning."""
    below = error.__traceback__.tb_next if error.__traceback__ else None
    text = "".join(traceback.format_exception(type(error), error, below or error.__traceback__))
    return harmless(text if len(text) <= _TRACEBACK else f"...\n{text[-_TRACEBACK:]}")
