"""Interrupts that are not lost, and that do no harm when they come again.

Python drops an exception that is raised where nobody can catch it: in a destructor, or in a
callback of its garbage collector, of which jax has one. A Ctrl-C that falls there is sent again.
What destructors raise after an interrupt is nobody's concern: their simulators are gone.

The first one ends what goes on, in order: picks are given back, worker processes ended. Those that
follow it would only disturb that; one that comes much later says that it takes too long.
"""

from __future__ import annotations

import _thread
import os
import signal
import sys
import threading
import time
from typing import Any

from mbtl.cli.common import interrupts

_SOON = 0.05
"""Seconds until it is sent again: by then the callback has returned."""
_IMPATIENT = 2.0
"""Seconds after the first Ctrl-C when another one ends the process at once."""
_first: list[float] = []
"""When an interrupt was heard."""


def hear_interrupts() -> None:
    """A batch system's SIGTERM is an interrupt, too, and so is the end of the terminal."""
    for name in ("SIGINT", "SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)
        if number is not None and signal.getsignal(number) is not signal.SIG_IGN:  # nohup
            signal.signal(number, _heard)


def deafen() -> None:
    """After an interrupt the end is near: Python ends with its usual handlers, which kill."""
    for number in (signal.SIGINT, signal.SIGTERM) if _first else ():
        signal.signal(number, signal.SIG_IGN)


def _heard(number: int, frame: Any) -> None:
    now = time.monotonic()
    if not _first:
        _first.append(now)
        raise KeyboardInterrupt
    if number == signal.SIGINT and now - _first[0] > _IMPATIENT:
        os.write(2, b"interrupted again: it ends at once; run the same command again to go on\n")
        os._exit(130)


def keep_interrupts() -> None:
    """From now on an interrupt that Python drops is sent to the main thread once more."""
    usual = sys.unraisablehook

    def hook(dropped: Any) -> None:
        if not issubclass(dropped.exc_type, KeyboardInterrupt):
            if not interrupts:  # else a simulator that was cut short in the middle of an answer
                usual(dropped)
            return
        _first.clear()
        again = threading.Timer(_SOON, interrupt_main)
        again.daemon = True
        again.start()

    sys.unraisablehook = hook


def interrupt_main() -> None:
    """An interrupt of the main thread, as Ctrl-C does it, so that a wait ends, too."""
    main = threading.main_thread().ident
    # a batch system's job may ignore the first, and a program that embeds ours handles no other
    handled = [n for n in (signal.SIGINT, signal.SIGTERM) if callable(signal.getsignal(n))]
    if not handled:
        return
    if hasattr(signal, "pthread_kill") and main is not None:
        signal.pthread_kill(main, handled[0])
    else:
        _thread.interrupt_main(handled[0])
