"""Any Gymnasium environment with its context in what a policy sees.

    env = ShowContext(make_env(context), context, space)
    problem = CMDP.from_env("mine", space, make_env=make_env, show_context=True, timesteps=100_000)

Shown are the coordinates of the context in the unit cube, as models see it: 0..1 per number, evenly
where an axis is logarithmic, one number per level of a categorical one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box

from mbtl.contexts import Context, ContextSpace
from mbtl.errors import InvalidInput


class ShowContext(gymnasium.ObservationWrapper):  # type: ignore[misc]  # gymnasium is untyped
    """Observations that end with the coordinates of the context.

    Args:
        env: observations are vectors, a `Box` of one axis.
        context: that of `env`.
        space: with the axes of the context.

    Raises:
        InvalidInput: observations are no vectors.
        ContextMismatch: the context does not lie within the axes.
    """

    def __init__(self, env: Any, context: Context, space: ContextSpace) -> None:
        super().__init__(env)
        seen = env.observation_space
        if not (isinstance(seen, Box) and len(seen.shape) == 1):
            raise InvalidInput(
                f"a context is shown beside observations that are vectors, got {seen}; wrap the "
                "environment in gymnasium.wrappers.FlattenObservation first"
            )
        self.coordinates = space.encode(context).astype(seen.dtype)
        ends = np.zeros_like(self.coordinates), np.ones_like(self.coordinates)
        low, high = (np.append(a, b) for a, b in zip((seen.low, seen.high), ends, strict=True))
        self.observation_space = Box(low, high, dtype=seen.dtype.type)

    def observation(self, observation: Any) -> Any:
        """What the environment shows, and the coordinates."""
        return np.append(observation, self.coordinates)

    def __getattr__(self, name: str) -> Any:
        """How the environment goes on by itself (`mbtl.envs.references`), where it does."""
        if name not in ("ways", "drive", "follow"):
            raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")
        own = getattr(self.env, name)
        return own if name == "ways" else partial(self._shown, own)

    def _shown(self, own: Callable[..., Any], *way: str) -> tuple[Any, ...]:
        seen, *rest = own(*way)
        return self.observation(seen), *rest


@dataclass(frozen=True)
class Showing:
    """context -> environment that shows it; can be sent to another process if `make_env` can.

    Attributes:
        make_env: context -> environment.
        space: the contexts.
    """

    make_env: Callable[..., Any]
    space: ContextSpace

    def __call__(self, context: Context, **options: Any) -> ShowContext:
        """A new environment."""
        return ShowContext(self.make_env(context, **options), context, self.space)
