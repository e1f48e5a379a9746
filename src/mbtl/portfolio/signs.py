"""What policies show of the context while an episode runs: an observation model.

An episode is cut into parts of so many steps. A part shows a vector: the sum of its rewards, then
the features that the user computes of what was observed and done in it. A policy that takes over in
mid-episode is believed to show, and to earn, what it does in those parts when it plays alone.

Notation (shapes): k policies, N listed contexts, P parts, m entries of a vector; raw units.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from mbtl.arrays import Array
from mbtl.errors import InvalidInput

Step = tuple[Any, Any, float]
"""An observation, the action that followed it, and its reward."""
Features = Callable[[Any, Any], Any]
"""Observations (T, ...), each before its action, and actions (T, ...) of a part -> (m - 1,)."""


@dataclass(frozen=True, eq=False)
class Signs:
    """What each policy shows in each part of an episode, in each listed context.

    Attributes:
        every: steps of a part.
        mean: (k, N, P, m) of the episodes; rewards are 0 once an episode has ended, features NaN
            where no episode reached the part's end.
        deviation: (k, N, P, m) of single episodes.
        features: of a part, beside its rewards.
    """

    every: int
    mean: Array = field(repr=False)
    deviation: Array = field(repr=False)
    features: Features | None = None

    @cached_property
    def to_go(self) -> Array:
        """(k, N, P + 1) mean rewards from the start of a part to the end of the episode."""
        backwards = np.cumsum(self.mean[:, :, ::-1, 0], axis=2)[:, :, ::-1]
        return np.pad(backwards, ((0, 0), (0, 0), (0, 1)))

    @cached_property
    def width(self) -> Array:
        """(m,) between the smallest and the largest mean."""
        low, high = np.nanmin(self.mean, axis=(0, 1, 2)), np.nanmax(self.mean, axis=(0, 1, 2))
        return np.asarray(np.maximum(high - low, 1e-9))


def shown(steps: Sequence[Step], every: int, features: Features | None) -> Array:
    """(m,) the vector of a part; (1,), only its rewards, where the episode's end cut it short."""
    observations, actions, rewards = zip(*steps, strict=True)
    vector = np.array([sum(rewards)])
    if features is not None and len(steps) == every:
        told = features(np.array(observations), np.array(actions))
        vector = np.append(vector, np.asarray(told, dtype=np.float64))
    if not np.isfinite(vector).all():
        raise InvalidInput(
            f"rewards and features of a part must be finite numbers, got {vector.tolist()}; leave "
            "out what cannot be computed of every part"
        )
    return vector


def played(env: Any, policy: Any, seed: int, every: int, features: Features | None) -> list[Array]:
    """The vectors of an episode's parts."""
    steps, over = list[Step](), False
    observation, _ = env.reset(seed=seed)
    while not over:
        action, _ = policy.predict(observation, deterministic=True)
        seen, reward, terminated, truncated, _ = env.step(action)
        steps.append((np.array(observation), action, float(reward)))
        observation, over = seen, terminated or truncated
    starts = range(0, len(steps), every)
    return [shown(steps[t : t + every], every, features) for t in starts]


def stacked(episodes: Sequence[Sequence[Array]]) -> Array:
    """(E, P, m) of the vectors of each episode's parts; after its end no rewards, no features."""
    entries = {len(vector) for parts in episodes for vector in parts}
    if len(counts := sorted(entries - {1})) > 1:  # of whole parts
        raise InvalidInput(
            f"every part has as many features, got {', '.join(str(n - 1) for n in counts)}"
        )
    found = np.full((len(episodes), max(map(len, episodes)), max(entries)), np.nan)
    found[:, :, 0] = 0.0
    for e, parts in enumerate(episodes):
        for p, vector in enumerate(parts):
            found[e, p, : len(vector)] = vector
    return found
