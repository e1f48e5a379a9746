"""Between an environment's spaces and an algorithm's.

Algorithms count choices from 0, and give real numbers where a box wants whole ones. An `Adapter`
makes an action of the algorithm one of the environment, and an observation of the environment one
of the algorithm.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Adapter:
    """Between the spaces of an environment and those that algorithms take.

    Attributes:
        observed_from: first choice of discrete observations, by key; "" where there are no keys.
        acted_from: first choice of discrete actions, a number or a list; None: from 0.
        whole: integer type of a box of whole actions; "": it is none.
    """

    observed_from: Mapping[str, Any] = field(default_factory=dict)
    acted_from: Any = None
    whole: str = ""

    @classmethod
    def of(cls, observation_space: Any, action_space: Any) -> Adapter:
        """What these spaces need."""
        from gymnasium import spaces

        keyed = isinstance(observation_space, spaces.Dict)
        parts = observation_space.spaces if keyed else {"": observation_space}
        starts = {str(key): start for key, part in parts.items() if (start := _start(part))}
        box = isinstance(action_space, spaces.Box)
        whole = box and np.issubdtype(action_space.dtype, np.integer)
        return cls(starts, _start(action_space), action_space.dtype.name if whole else "")

    @property
    def changes(self) -> bool:
        """Whether anything differs."""
        return bool(self.observed_from) or self.acted_from is not None or bool(self.whole)

    def observation(self, seen: Any) -> Any:
        """One of the algorithm, or a batch, from the environment's."""
        if not self.observed_from:
            return seen
        if isinstance(seen, Mapping):
            numbered = {*seen} & {*self.observed_from}
            starts = {key: np.asarray(self.observed_from[key]) for key in numbered}
            return {**seen, **{key: np.asarray(seen[key]) - starts[key] for key in numbered}}
        return np.asarray(seen) - np.asarray(self.observed_from[""])

    def action(self, told: Any) -> Any:
        """One of the environment, or a batch, from the algorithm's."""
        if self.acted_from is not None:
            return np.asarray(told) + np.asarray(self.acted_from)
        return np.rint(told).astype(self.whole) if self.whole else told

    def spaces(self, observation_space: Any, action_space: Any) -> tuple[Any, Any]:
        """What the algorithm is shown instead of the environment's own."""
        from gymnasium import spaces

        if self.whole:
            low, high = (b.astype(np.float32) for b in (action_space.low, action_space.high))
            action_space = spaces.Box(low, high, dtype=np.float32)
        elif self.acted_from is not None:
            action_space = _from_zero(action_space)
        if isinstance(observation_space, spaces.Dict):
            parts = {k: _from_zero(part) for k, part in observation_space.spaces.items()}
            observation_space = spaces.Dict(parts)
        else:
            observation_space = _from_zero(observation_space)
        return observation_space, action_space


def _start(space: Any) -> Any:
    """First choice, JSON-able; None where it is 0 or there are no choices."""
    start = np.asarray(getattr(space, "start", 0))
    return start.tolist() if start.any() else None


def _from_zero(space: Any) -> Any:
    if _start(space) is None:
        return space
    from gymnasium import spaces

    if isinstance(space, spaces.Discrete):
        return spaces.Discrete(int(space.n))
    return spaces.MultiDiscrete(space.nvec)
