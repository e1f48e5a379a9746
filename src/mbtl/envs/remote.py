"""An environment in a process of its own, for simulators that live once per process.

A process serves one environment at a time. When that is closed, the process waits for the next one:
starting anew would cost seconds. What the environment says is asked for there, name by name, so
Gymnasium's and PettingZoo's look from here as they are.
"""

from __future__ import annotations

import os
import pickle
from collections.abc import Callable
from concurrent.futures import BrokenExecutor
from functools import partial
from typing import Any

import gymnasium

from mbtl.contexts import Context
from mbtl.errors import InvalidInput, SimulationFailed
from mbtl.processes import SeparateWorkers

_idle: dict[int, list[SeparateWorkers]] = {}
"""Processes that serve nobody now, by the process that has started them."""
_serving: Any = None
"""In such a process: its environment."""


def remote(make_env: Callable[[Context], Any], context: Context) -> Any:
    """An environment that `make_env` makes, in a process of its own.

    Raises:
        InvalidInput: `make_env` cannot be sent there.
        SimulationFailed: the process ends before it has an environment.
    """
    import cloudpickle

    try:
        frozen = cloudpickle.dumps(make_env)
    except Exception as error:  # of whatever a user's function holds
        raise InvalidInput(
            "its simulator lives once per process, so every environment needs a process of its "
            f"own and make_env must be sent there, got {type(error).__name__}: {error}; make it a "
            "function of a module"
        ) from error
    idle = _idle.get(os.getpid())
    worker = idle.pop() if idle else SeparateWorkers(1)
    try:
        is_team = worker.submit(_open, frozen, dict(context)).result()
    except BrokenExecutor as error:
        raise SimulationFailed(
            "an environment needs a process of its own, got one that ended as it began; a script "
            "that starts it must be guarded by if __name__ == '__main__'"
        ) from error
    except BaseException:
        worker.end()
        raise
    return (RemoteTeam if is_team else RemoteEnv)(worker)


class _Remote:
    """Asks the environment in the other process."""

    def __init__(self, worker: SeparateWorkers) -> None:
        self._worker: SeparateWorkers | None = worker
        self._asked: Any = None

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        calls, value = self._ask(_look, name)
        return partial(self._ask, _call, name) if calls else value

    def reset(self, **given: Any) -> Any:
        """Of the environment."""
        return self._ask(_call, "reset", **given)

    def step(self, action: Any) -> Any:
        """Of the environment."""
        return self._ask(_call, "step", action)

    def render(self) -> Any:
        """Of the environment."""
        return self._ask(_call, "render")

    def close(self) -> None:
        """Close it, and let the process serve another; one in the middle of something is ended."""
        worker, self._worker = self._worker, None
        if worker is None:
            return
        if self._asked is not None and not self._asked.done():  # an interrupt came between
            worker.end()
            return
        try:
            worker.submit(_call, "close").result()
        except BaseException:
            worker.end()
            raise
        _idle.setdefault(os.getpid(), []).append(worker)

    def _ask(self, function: Callable[..., Any], *given: Any, **named: Any) -> Any:
        if self._worker is None:
            raise InvalidInput("this environment is closed; make another")
        self._asked = self._worker.submit(function, *given, **named)
        try:
            return self._asked.result()
        except BrokenExecutor as error:
            raise SimulationFailed(
                "an environment lives in a process of its own, which has ended; it has written "
                "its own reason"
            ) from error


class RemoteEnv(_Remote, gymnasium.Env):  # type: ignore[misc]  # gymnasium is untyped for our checker
    """A Gymnasium environment in another process."""

    def __init__(self, worker: SeparateWorkers) -> None:
        """Its spaces are those of the environment."""
        super().__init__(worker)
        for name in ("observation_space", "action_space", "metadata", "render_mode"):
            setattr(self, name, self._ask(_look, name)[1])


class RemoteTeam(_Remote):
    """A PettingZoo parallel environment in another process."""


# ---- in the other process ------------------------------------------------------------------------


def _open(frozen: bytes, context: Context) -> bool:
    global _serving
    _serving = _told(lambda: pickle.loads(frozen)(context))
    return hasattr(_serving, "possible_agents")


def _look(name: str) -> tuple[bool, Any]:
    """Whether a name is a function; what it is, if not."""
    value = _found(name)
    calls = callable(value)
    return calls, None if calls else value


def _call(name: str, *given: Any, **named: Any) -> Any:
    return _told(partial(_found(name), *given, **named))


def _found(name: str) -> Any:
    if hasattr(_serving, name) or not hasattr(_serving, "get_wrapper_attr"):
        return getattr(_serving, name)
    return _serving.get_wrapper_attr(name)


def _told(do: Callable[[], Any]) -> Any:
    """What it gives; an error that cannot travel is told by its text."""
    try:
        return do()
    except Exception as error:
        try:
            pickle.loads(pickle.dumps(error))
        except Exception:
            raise SimulationFailed(f"{type(error).__name__}: {error}") from None
        raise
