"""One simulation of a world of one agent as a Gymnasium environment."""

from __future__ import annotations

from typing import Any

import jax
import numpy as np
from gymnasium import Env, spaces

from mbtl.engine.worlds.environments import Discrete
from mbtl.engine.worlds.world import Solo

_start, _step, _observe = (
    jax.jit(method, static_argnums=0) for method in (Solo.start, Solo.step, Solo.observe)
)


class OneSimulation(Env):  # type: ignore[misc]  # gymnasium is untyped for our checker
    """A world of one agent as a Gymnasium environment, with the episodes of its evaluations."""

    def __init__(self, world: Solo, params: Any) -> None:
        """`params` are of one context, leading axis."""
        self._world, self._params, action = world, params, world.action
        width = (world.n_features + params.visible.shape[1],)
        self.observation_space = spaces.Box(-np.inf, np.inf, width)
        if isinstance(action, Discrete):
            self.action_space = spaces.Discrete(action.n)
        else:
            self.action_space = spaces.Box(*np.array([action.low, action.high], np.float32))

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        """First observation."""
        super().reset(seed=seed)
        drawn = self.np_random.random((1, self._world.env.n_noise)).astype(np.float32)
        self._state, self._left = _start(self._world, drawn, self._params), self._world.env.horizon
        return self._seen(), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """One step."""
        acts = np.reshape(action, (1, 1, *self.action_space.shape))
        moved = _step(self._world, self._state, acts, self._params)
        self._state, self._left = moved.state, self._left - 1
        return self._seen(), moved.reward.item(), moved.done.item(), self._left <= 0, {}

    def _seen(self) -> Any:
        return np.asarray(_observe(self._world, self._state, self._params).obs[0, 0])
