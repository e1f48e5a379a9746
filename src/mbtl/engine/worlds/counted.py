"""Steps of episodes: known beforehand, by the return, or counted in an environment of their own.

Notation (shapes): T contexts, E episodes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbtl.arrays import Array
from mbtl.contexts import Context

Problem = Callable[[Sequence[Context]], tuple[Any, Any]]
"""contexts -> world and parameters."""


def decisions_of(world: Any, params: Any) -> int:
    """Decisions of an episode in one context; of the longest where a world ends when it ends."""
    length = world.decisions(params)
    return int(getattr(length, "decisions", length))


def each_of(problem: Problem, contexts: Sequence[Context]) -> NDArray[np.int64]:
    """(T,) `decisions_of` each context."""
    return np.array([decisions_of(*problem([one])) for one in contexts])


def known_steps(problem: Problem, contexts: Sequence[Context], returns: Array) -> Array | None:
    """(T, E) steps of the episodes that had these returns; None: they must be counted.

    A world of several agents says how long its episodes are.
    """
    world, _ = problem(list(contexts))
    if not hasattr(world, "env"):
        return each_of(problem, contexts)[:, None] + np.zeros_like(returns)
    lasts = getattr(world.env, "lasts", None)
    if lasts == "return":
        return returns.copy()
    return np.full(returns.shape, float(world.env.horizon)) if lasts == "horizon" else None


@dataclass(frozen=True)
class Counting:
    """A problem in which a return is a number of steps."""

    problem: Problem

    def __call__(self, contexts: Sequence[Context]) -> tuple[Any, Any]:
        """The same contexts."""
        world, params = self.problem(contexts)
        return replace(world, env=Counted(world.env)), params


@dataclass(frozen=True)
class Counted:
    """An environment whose every step is worth 1, so that a return is a number of steps."""

    env: Any

    def __getattr__(self, name: str) -> Any:
        if name == "env" or name.startswith("__"):
            raise AttributeError(name)
        return getattr(self.env, name)

    def step(self, state: Any, action: Any, params: Any) -> Any:
        """One step of the environment."""
        moved = self.env.step(state, action, params)
        return moved._replace(reward=moved.reward * 0.0 + 1.0)
