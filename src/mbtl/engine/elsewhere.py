"""An object that lives in a process of its own and is asked by the names of its methods.

    scene = Elsewhere(make_scene)
    scene.ask("start", context, seed)               # many can be asked before one is waited for
    sight = scene.answer()

The process begins at the first question and ends with this one. One that has died is replaced at
the next question, by an object that knows nothing of the past.
"""

from __future__ import annotations

import atexit
import contextlib
import os
import pickle
import signal
import subprocess
import sys
from collections.abc import Callable
from typing import Any

from mbtl.errors import MbtlError, SimulationFailed


class Elsewhere:
    """One object in one process."""

    def __init__(self, make: Callable[[], Any]) -> None:
        """Nothing is started yet.

        Args:
            make: makes the object there; a function of a module, or a `functools.partial` of one.
        """
        self._make = make
        self._process: subprocess.Popen[bytes] | None = None
        atexit.register(self.close)

    def ask(self, method: str, *args: Any) -> None:
        """Begin with a method; the answer is to be fetched before the next question."""
        words: list[Any] = [(method, args)]
        if self._process is None:
            command = [sys.executable, "-m", __name__]
            self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
            words.insert(0, self._make)
        with contextlib.suppress(OSError):  # it has died: there will be no answer
            assert self._process.stdin is not None
            for word in words:
                pickle.dump(word, self._process.stdin, pickle.HIGHEST_PROTOCOL)
            self._process.stdin.flush()

    def answer(self) -> Any:
        """What the method gave.

        Raises:
            SimulationFailed: the process has ended.
            MbtlError: the method raised it.
        """
        assert self._process is not None
        assert self._process.stdout is not None
        try:
            found = pickle.load(self._process.stdout)
        except (EOFError, OSError, pickle.UnpicklingError):
            raise SimulationFailed(
                "a process with simulations must not end before them, got exit code "
                f"{self.close()}; what was in it is lost, start that again"
            ) from None
        if isinstance(found, MbtlError):
            raise found
        return found

    def close(self) -> int | None:
        """End the process; its exit code."""
        process, self._process = self._process, None
        if process is None:
            return None
        process.kill()
        with contextlib.suppress(OSError):  # what nobody reads any more
            process.communicate()
        return process.returncode


def _serve() -> None:
    """Answer until nobody asks any more; Ctrl-C is the asking process's business."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    asked = sys.stdin.buffer
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # nothing else may get among the answers, nor what native code prints
    sys.stdout = sys.stderr
    try:
        make, known = pickle.load(asked), None
        while True:
            method, args = pickle.load(asked)
            try:
                known = make() if known is None else known
                found = getattr(known, method)(*args)
            except MbtlError as error:
                found = error
            pickle.dump(found, answers, pickle.HIGHEST_PROTOCOL)
            answers.flush()
    except EOFError:
        return


if __name__ == "__main__":
    _serve()
