"""Steps of episodes: known beforehand, or by the return.

Notation (shapes): T contexts, E episodes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
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
