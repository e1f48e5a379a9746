"""Interrupts that are not lost.

Python drops an exception that is raised where nobody can catch it: in a destructor, or in a
callback of its garbage collector, of which jax has one. A Ctrl-C that falls there is sent again.
What destructors raise after an interrupt is nobody's concern: their simulators are gone.
"""

from __future__ import annotations

import _thread
import signal
import sys
import threading
from typing import Any

from mbtl.cli.common import interrupts

_SOON = 0.05
"""Seconds until it is sent again: by then the callback has returned."""


def keep_interrupts() -> None:
    """From now on an interrupt that Python drops is sent to the main thread once more."""
    usual = sys.unraisablehook

    def hook(dropped: Any) -> None:
        if not issubclass(dropped.exc_type, KeyboardInterrupt):
            if not interrupts:  # else a simulator that was cut short in the middle of an answer
                usual(dropped)
            return
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
