"""Spaces: which of them algorithms take, and what does not lie in its space."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces

from mbtl.envs.adapter import Adapter
from mbtl.envs.rollout import copied
from mbtl.errors import InvalidInput

_TAKEN = (spaces.Box, spaces.Discrete, spaces.MultiDiscrete, spaces.MultiBinary)
_ROUNDING = 1e-5
"""Of a bound: float32 and float64 disagree by less."""


@dataclass(frozen=True)
class Outside:
    """A value that is not in its space.

    Attributes:
        said: which part, in words.
        far: it cannot be meant: another kind or shape, a choice that there is not, or further
            beyond a bound than the box is wide.
    """

    said: str
    far: bool


def outside(space: Any, value: Any) -> Outside | None:
    """How a value misses its space; None where it lies in it, up to rounding."""
    if isinstance(space, spaces.Dict):
        if not isinstance(value, Mapping) or set(value) != set(space.spaces):
            keys = sorted(map(str, value)) if isinstance(value, Mapping) else type(value).__name__
            return Outside(f"{keys} instead of the keys {sorted(map(str, space.spaces))}", True)
        parts = [(f"{key!r}: ", space[key], value[key]) for key in space.spaces]
    elif isinstance(space, spaces.Tuple):
        if not isinstance(value, (tuple, list)) or len(value) != len(space.spaces):
            return Outside(f"{value!r} instead of {len(space.spaces)} parts", True)
        parts = [
            (f"part {i}: ", *pair) for i, pair in enumerate(zip(space.spaces, value, strict=True))
        ]
    elif isinstance(space, _TAKEN):
        return _numbers_outside(space, value)
    else:
        return None if space.contains(value) else Outside(f"{value!r}", True)
    missed = [(name, outside(part, one)) for name, part, one in parts]
    found = [Outside(name + miss.said, miss.far) for name, miss in missed if miss]
    return next((one for one in found if one.far), found[0] if found else None)


def refuse_outside(space: Any, value: Any, moment: int) -> None:
    """Refuse an observation that is far outside its space.

    Raises:
        InvalidInput: with what it is, and when.
    """
    miss = outside(space, value)
    if miss is not None and miss.far:
        raise InvalidInput(
            f"observations must lie in their space, got {miss.said}, at moment {moment}; mend the "
            "space or the observation"
        )


def _numbers_outside(space: Any, value: Any) -> Outside | None:
    try:
        array = np.asarray(value)
        if array.dtype == object:
            raise TypeError
        numbers = array.astype(np.float64)
    except (TypeError, ValueError):
        return Outside(f"{value!r}, which is no array of numbers", True)
    if array.shape != space.shape:
        return Outside(f"shape {array.shape} instead of {space.shape}", True)
    low, high = _bounds(space)
    whole = np.issubdtype(space.dtype, np.integer) or space.dtype == np.bool_
    if whole and (broken := numbers != np.rint(numbers)).any():
        return Outside(f"{numbers[broken][0]:g} where the space has whole numbers", True)
    with np.errstate(invalid="ignore"):  # NaN and infinity are another matter
        beyond = np.maximum(low - numbers, numbers - high)
        bound = np.minimum(np.abs(low), np.abs(high))  # the finite one, if there is one
        size = np.where(np.isfinite(bound), np.maximum(1.0, bound), 1.0)
        misses = beyond > (0.0 if whole else _ROUNDING * size)
        wide = np.where(np.isfinite(high - low), high - low, size)
    if not misses.any():
        return None
    worst = np.unravel_index(int(np.argmax(np.where(misses, beyond, -1.0))), array.shape)
    at = f" at {', '.join(map(str, worst))}" if worst else ""
    said = f"{numbers[worst]:g}{at}, not within {low[worst]:g} to {high[worst]:g}"
    return Outside(said, bool(whole or (misses & (beyond > wide)).any()))


def told_apart(here: Any, there: Any) -> tuple[str, str]:
    """Two spaces that differ: of long vectors, the first place where their bounds do."""
    vectors = isinstance(here, spaces.Box) and isinstance(there, spaces.Box)
    if vectors and here.shape == there.shape and here.dtype == there.dtype:
        differ = ~(np.isclose(here.low, there.low) & np.isclose(here.high, there.high))
        at = tuple(np.argwhere(differ)[0].tolist())
        one, other = (f"{box.low[at]:g} to {box.high[at]:g} in place {at}" for box in (here, there))
        return one, other
    return str(here), str(there)


def _bounds(space: Any) -> tuple[Any, Any]:
    """Smallest and largest value, float64 arrays of the space's shape."""
    if isinstance(space, spaces.Box):
        low, high = space.low, space.high
    elif isinstance(space, spaces.MultiBinary):
        low, high = 0, 1
    else:
        counts = space.n if isinstance(space, spaces.Discrete) else space.nvec
        low, high = space.start, space.start + counts - 1
    both = (np.asarray(bound, dtype=np.float64) for bound in (low, high))
    return tuple(np.broadcast_to(bound, space.shape) for bound in both)  # type: ignore[return-value]


def check_taken(observation_space: Any, action_space: Any) -> None:
    """Refuse spaces that no algorithm of Stable-Baselines3 takes.

    Raises:
        InvalidInput: of another kind, or actions without bounds.
    """
    flat = isinstance(observation_space, spaces.Dict)
    parts = list(observation_space.spaces.values()) if flat else [observation_space]
    for part in parts:
        if not isinstance(part, _TAKEN) or getattr(part, "nvec", np.zeros(1)).ndim != 1:
            raise InvalidInput(
                "observations are a Box, Discrete, MultiDiscrete or MultiBinary space, or one Dict "
                f"of those, got {observation_space}; use gymnasium.wrappers.FlattenObservation"
            )
    if not isinstance(action_space, _TAKEN) or getattr(action_space, "nvec", np.zeros(1)).ndim != 1:
        raise InvalidInput(
            "actions are a Box, Discrete, MultiDiscrete or MultiBinary space, got "
            f"{action_space}; make them one vector in the environment"
        )
    if isinstance(action_space, spaces.Box) and not action_space.is_bounded():
        raise InvalidInput(f"actions need finite bounds, got {action_space}; give the space some")


class Plain(gymnasium.Wrapper):  # type: ignore[misc]  # gymnasium is untyped for our checker
    """An environment through its adapter; what it shows is a copy that it cannot change later.

    Attributes:
        adapter: what changes.
    """

    def __init__(self, env: Any) -> None:
        """Of an environment whose spaces are taken.

        Raises:
            InvalidInput: they are not; see `check_taken`.
        """
        super().__init__(env)
        check_taken(env.observation_space, env.action_space)
        self.adapter = Adapter.of(env.observation_space, env.action_space)
        self.observation_space, self.action_space = self.adapter.spaces(
            env.observation_space, env.action_space
        )

    def reset(self, **given: Any) -> tuple[Any, dict[str, Any]]:
        """As the environment's."""
        seen, info = self.env.reset(**given)
        return copied(self.adapter.observation(seen)), info

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """As the environment's."""
        told = self.adapter.action(action)
        if isinstance(self.env.action_space, spaces.Discrete):
            told = int(told) if self.adapter.changes else told
        seen, reward, terminated, truncated, info = self.env.step(told)
        return copied(self.adapter.observation(seen)), reward, terminated, truncated, info
